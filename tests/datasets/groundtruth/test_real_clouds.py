"""Registration of real clouds as ``benchmarks/truth/real_clouds.py`` measures it, and the benchmark's own tools.

The figures that are held here have a margin over what the benchmark prints. Poses of the graphs that come with the
scans are no truth to centimetres: methods that share no code agree with one another and not with them.
"""

from __future__ import annotations

import json
import os
import runpy
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from repository import TRUTH

from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.importers.kitti.recording import REAL_ELEVATION_DEG
from relocbench.errors import DatasetError
from relocbench.geometry import apply, invert, make_transform, rotation_angle, se3_exp, so3_exp

sys.path.insert(0, str(TRUTH))
from real_clouds_figures import register_all, tell_kitti_00, tell_precision, tell_starts
from real_clouds_methods import Candidate, adjusted, allowed, apart, best, methods, turned_identities
from real_clouds_scans import SOURCES, Scans, Source, read_scans, submap

Array = NDArray[np.float64]
FindData = Callable[[str], Path]


def room(count: int, seed: int) -> Array:
    """(N, 3) points on the floor and the uneven walls of a room of 20 m x 12 m x 5 m, noise 5 mm."""
    rng = np.random.default_rng(seed)
    p = rng.uniform([-10, -6, -2], [10, 6, 3], size=(count, 3))
    side = rng.integers(0, 6, size=count)
    for k, (axis, value) in enumerate(((0, -10), (0, 10), (1, -6), (1, 6), (2, -2))):
        p[side == k, axis] = value
    inner = side == 5
    p[inner, 0], p[inner, 1] = 3.0, np.clip(p[inner, 1], 0.0, 6.0)
    return np.asarray(p + 0.005 * rng.normal(size=p.shape))


def posed_scans() -> Scans:
    """Five scans of the room, none with a point of another, each from a pose of its own."""
    twists = [[0.3 * k, -0.1 * k, 0.02 * k, 0.01 * k, -0.02 * k, 0.08 * k] for k in range(5)]
    poses = np.array([se3_exp(t) for t in twists])
    points = tuple(apply(invert(pose), room(12_000, seed)) for seed, pose in enumerate(poses))
    return Scans(Source("room", "room", "", 1), points, tuple(PreparedSubmap(submap(p)) for p in points), poses)


@pytest.mark.slow
def test_every_method_finds_a_known_pose() -> None:
    scans = posed_scans()
    off = make_transform(so3_exp([0.01, -0.01, 0.02]), [0.1, -0.08, 0.05])
    for name, method in methods().items():
        metres, degrees = apart(method(scans, (1, 4), scans.by_graph((1, 4)) @ off), scans.by_graph((1, 4)))
        assert metres < 0.005, name
        assert degrees < 0.05, name


def test_adjusted_poses_share_out_what_does_not_close() -> None:
    rng = np.random.default_rng(0)
    true = np.array([se3_exp(rng.normal(size=6)) for _ in range(5)])
    scans = Scans(SOURCES[0], (np.zeros((1, 3)),) * 5, (), true @ se3_exp([0.05, 0, 0, 0, 0, 0.01]))
    exact = {(a, b): np.asarray(invert(true[a]) @ true[b]) for a, b in combinations(range(5), 2)}
    T = adjusted(scans, exact)
    assert all(apart(invert(T[a]) @ T[b], exact[a, b])[0] < 1e-6 for a, b in exact)
    # One of ten registrations is 5 cm off: nine say otherwise, and it keeps most of the error.
    T = adjusted(scans, {**exact, (0, 4): exact[0, 4] @ make_transform(np.eye(3), [0.05, 0, 0])})
    assert 0.01 < apart(invert(T[0]) @ T[4], exact[0, 4])[0] < 0.03
    assert apart(invert(T[1]) @ T[2], exact[1, 2])[0] < 0.01


def test_turned_identities_turn_by_no_more_than_asked() -> None:
    starts = turned_identities(20, 3)
    angles = [np.degrees(rotation_angle(T[:3, :3])) for T in starts]
    assert max(angles) == pytest.approx(30.0)
    assert len({round(float(a), 6) for a in angles}) == 20
    assert not any(T[:3, 3].any() for T in starts)
    np.testing.assert_array_equal(turned_identities(20, 3), starts)
    assert not np.array_equal(turned_identities(20, 4)[0], starts[0])


def test_the_most_plausible_of_the_allowed_guesses_is_taken() -> None:
    here, there = np.eye(4), make_transform(np.eye(3), [100.0, 0, 0])
    candidates = [Candidate(here, here, 0.2), Candidate(there, there, 0.9)]
    assert best(candidates) is there
    assert best(allowed(np.eye(4), candidates)) is here
    assert best([]) is None


def test_scans_that_are_missing_or_cut_off_are_named(tmp_path: Path) -> None:
    source = Source("two", "two", "{:02d}.bin", 1)
    with pytest.raises(DatasetError, match="expected a graph of poses") as caught:
        read_scans(tmp_path, source)
    assert caught.value.path == tmp_path / "two" / "graph.txt"
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "graph.txt").write_text("v0 0 0 0 0 0 0 1\nv1 1 0 0 0 0 0 1\n")
    for k in range(2):
        room(400, k).astype("<f4").tofile(tmp_path / "two" / f"{k:02d}.bin")
    np.testing.assert_allclose(read_scans(tmp_path, source).by_graph((0, 1))[:3, 3], [1, 0, 0])
    (tmp_path / "two" / "01.bin").write_bytes(b"12345")
    with pytest.raises(DatasetError, match="expected a graph of poses"):
        read_scans(tmp_path, source)


def test_without_recordings_the_benchmark_says_so_and_ends_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(os, "environ", os.environ.copy())
    monkeypatch.setattr(sys, "argv", ["real_clouds.py", "--data", str(tmp_path)])
    runpy.run_path(str(TRUTH / "real_clouds.py"), run_name="__main__")
    said = capsys.readouterr()
    assert json.loads(said.out.splitlines()[-1]) == {"benchmark": "real_clouds"}
    assert said.err.count("skipped: ") == 2


def thinned_out(scans: Scans, every: int) -> Scans:
    """One of so many scans."""
    some = slice(None, None, every)
    return replace(scans, points=scans.points[some], sides=scans.sides[some], T_graph_scan=scans.T_graph_scan[some])


@pytest.mark.slow
def test_methods_that_share_no_code_agree_with_us_more_than_with_the_graph(real_data: FindData) -> None:
    """Three scans of Newer College; the benchmark prints the same of all, and of KITTI 07, whose scans are thinner and
    lie further apart."""
    found = tell_precision(register_all(thinned_out(read_scans(real_data("lidar_submaps_with_graph"), SOURCES[2]), 2)))
    own = found["methods"]["own"]
    assert found["mutual"]["max_cm"] < 1.0
    assert own["off_adjusted"]["max_cm"] < 1.0
    assert own["triangles"]["max_cm"] < 2.5
    assert found["graph_outside_methods"] >= 2
    assert own["spread_cm"] < found["graph_spread_cm"]
    assert found["methods"]["GICP"]["spread_cm"] < found["graph_spread_cm"]


@pytest.mark.slow
def test_far_pairs_are_found_from_a_turned_identity_and_from_no_prior(real_data: FindData) -> None:
    scans = read_scans(real_data("lidar_submaps_with_graph"), SOURCES[1])
    found = tell_starts(thinned_out(scans, 4), count=1, seed=7)
    assert found["with_guesses"] == found["starts"] == 1
    assert found["coarse"] == found["pairs"] == 1


@pytest.mark.slow
def test_the_builder_reproduces_what_is_known_of_kitti_00(real_data: FindData) -> None:
    """With the beams raised; the benchmark prints the same of the scans as they are."""
    found = tell_kitti_00(real_data("kitti_odometry"), [REAL_ELEVATION_DEG])
    for figures in found.values():
        assert figures["max_error_cm"] < 1.5
        assert figures["median_px"] < 0.7
        assert figures["within_3px"] > 0.85
        assert figures["coverage"] > 0.4
    assert abs(found["elevation_0.205"]["bias_px"]) < 0.15

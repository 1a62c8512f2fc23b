"""Registration of real clouds: one pose from all starts, and wrong ones refused.

``benchmarks/lidar/real_clouds.py`` compares registrations with those of other methods and holds its figures to limits;
its own tools are tested here.
"""

from __future__ import annotations

import json
import os
import runpy
import sys
from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from limits import Limits
from real_clouds_methods import Candidate, adjusted, allowed, apart, best, methods, turned_identities
from real_clouds_scans import SOURCES, Scans, Source, read_scans, submap
from refusals import refused
from repository import LIDAR

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.icp.icp import run_icp
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.verification.verification import verdict, verification_evidence
from relocbench.errors import DatasetError
from relocbench.geometry import apply, invert, make_transform, rotation_angle, se3_exp, so3_exp


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


@pytest.mark.thorough
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
    with refused(DatasetError, tmp_path / "two" / "graph.txt"):
        read_scans(tmp_path, source)
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "graph.txt").write_text("v0 0 0 0 0 0 0 1\nv1 1 0 0 0 0 0 1\n")
    for k in range(2):
        room(400, k).astype("<f4").tofile(tmp_path / "two" / f"{k:02d}.bin")
    np.testing.assert_allclose(read_scans(tmp_path, source).by_graph((0, 1))[:3, 3], [1, 0, 0])
    (tmp_path / "two" / "01.bin").write_bytes(b"12345")
    with refused(DatasetError, tmp_path / "two" / "graph.txt", None, "points"):
        read_scans(tmp_path, source)


def test_figures_outside_of_their_limits_are_named_and_end_a_proof_with_code_1(
    capsys: pytest.CaptureFixture[str],
) -> None:
    limits = Limits()
    limits.expect("pairs found", 10, 10)
    limits.expect("off the graph", 2.0, 0, 3.0)
    limits.expect("closure", float("nan"), 0, 3.0)
    limits.expect("coverage", 0.25, 0.5)
    with pytest.raises(SystemExit) as ended:
        limits.end()
    assert ended.value.code == 1
    assert [line.partition(":")[0] for line in capsys.readouterr().err.splitlines()] == ["closure", "coverage"]


def test_without_recordings_the_benchmark_says_so_and_ends_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(os, "environ", os.environ.copy())
    monkeypatch.setattr(sys, "argv", ["real_clouds.py", "--data", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(LIDAR / "real_clouds.py"), run_name="__main__")
    assert ended.value.code == 0
    said = capsys.readouterr()
    assert json.loads(said.out.splitlines()[-1]) == {"benchmark": "real_clouds"}
    assert said.err.count("skipped: ") == 2


@pytest.fixture(scope="module")
def real_scans(real_data: Callable[[str], Path]) -> dict[str, Scans]:
    """Neighbours 3 to 12 m apart in KITTI 07, and 1 m in Newer College, by title."""
    folder = real_data("lidar_submaps_with_graph")
    return {source.title: read_scans(folder, source) for source in (SOURCES[0], SOURCES[2])}


@pytest.mark.thorough
@pytest.mark.parametrize("title", [SOURCES[0].title, SOURCES[2].title])
def test_any_turn_and_a_coarse_place_lead_to_the_same_pose(real_scans: dict[str, Scans], title: str) -> None:
    """From the graph's place with the heading wrong by up to 4 degrees: what global registration leaves open."""
    scans = real_scans[title]
    for pair, yaw in zip(combinations(range(3), 2), (4.0, -3.0, 2.0), strict=True):
        ref, query = (scans.sides[k].planes for k in pair)
        turn = make_transform(so3_exp([0, 0, np.radians(yaw)]), [0.3, -0.3, 0.1])
        there = run_icp(ref, query, scans.by_graph(pair)).T_ref_query
        metres, degrees = apart(run_icp(ref, query, scans.by_graph(pair) @ turn).T_ref_query, there)
        assert metres < 0.005
        assert degrees < 0.03


@pytest.mark.thorough
def test_right_poses_of_a_dense_scene_are_trusted_and_wrong_ones_are_not(real_scans: dict[str, Scans]) -> None:
    scans = real_scans[SOURCES[2].title]
    for i in range(4):
        ref, query = scans.sides[i : i + 2]
        found = run_icp(ref.planes, query.planes, scans.by_graph((i, i + 1)))
        assert verdict(verification_evidence(ref, query, found.T_ref_query, found.information)) == ""
        for wrong in (
            make_transform(so3_exp([0, 0, np.pi]), [0, 0, 0]),
            make_transform(np.eye(3), [6.0, 0, 0]),
            make_transform(so3_exp([0, 0, 0.2]), [0, 0, 0]),
        ):
            assert verdict(verification_evidence(ref, query, found.T_ref_query @ wrong, found.information))

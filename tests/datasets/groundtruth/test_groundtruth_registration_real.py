"""Registration of real clouds: single scans of KITTI 07, 3 to 12 m apart and turned by up to 40 degrees, and of Newer
College, 1 m apart, with the poses of gtsam_points' graphs.

The graphs are not exact. Between neighbours GICP agrees with them to 0.4-2.7 cm and 0.02-0.13 degrees; over several
steps of Newer College the differences add up in one direction (5.6 cm over four), while registrations close that cycle
to 1.8 cm. So neighbours are held against the graph, and the farthest pair against the chain of neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.icp.icp import run_icp
from relocbench.datasets.groundtruth.registration.global_registration import describe, guesses
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.verification.alternatives import ShiftOptions, fit
from relocbench.datasets.groundtruth.verification.verification import verdict, verification_evidence
from relocbench.geometry import invert, make_transform, rotation_angle, so3_exp, transform_from_tq

pytestmark = pytest.mark.slow
FindData = Callable[[str], Path]
Scans = dict[str, tuple[np.ndarray, list[PreparedSubmap]]]
Guessed = Callable[[str, int], list[np.ndarray]]

FILES = {
    "kitti_07_dump": [f"{k:06d}/points.bin" for k in range(5)],
    "newer_01": [f"planes_{10 * k:06d}.bin" for k in range(5)],
}


def submap(points: np.ndarray) -> Submap:
    """A scan from its own origin, with normals of 15 neighbours."""
    p = points.astype(np.float64)
    neighbours = p[cKDTree(p).query(p, k=15)[1]]
    centred = neighbours - neighbours.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred) / 15)
    normals = vectors[:, :, 0] * np.where(np.sum(vectors[:, :, 0] * p, axis=1) > 0, -1.0, 1.0)[:, None]
    flat = values[:, 0] < 0.05 * values[:, 1]
    level = np.abs(normals[:, 2]) > 0.9
    surface = np.where(flat, np.where(level, Surface.GROUND, Surface.STRUCTURE), Surface.ROUGH)
    return Submap(
        p.astype(np.float32),
        np.where(flat[:, None], normals, 0.0).astype(np.float32),
        np.zeros_like(p, dtype=np.float32),
        surface.astype(np.uint8),
        np.ones(len(p), np.float32),
        np.zeros(len(p), np.int32),
    )


@pytest.fixture(scope="module")
def scans(real_data: FindData) -> dict[str, tuple[np.ndarray, list[PreparedSubmap]]]:
    folder = real_data("lidar_submaps_with_graph")
    found = {}
    for name, files in FILES.items():
        rows = np.loadtxt(folder / name / "graph.txt", usecols=range(1, 8))
        clouds = [np.fromfile(folder / name / file, np.float32).reshape(-1, 3) for file in files]
        found[name] = (transform_from_tq(rows[:, :3], rows[:, 3:]), [PreparedSubmap(submap(cloud)) for cloud in clouds])
    return found


@pytest.fixture(scope="module")
def guessed(scans: Scans) -> Guessed:
    """What becomes of the guesses that features alone make of a scan and the next one."""

    @cache
    def refined(name: str, i: int) -> list[np.ndarray]:
        ref, query = scans[name][1][i : i + 2]
        found = guesses(describe(ref.submap), describe(query.submap))
        return [run_icp(ref.planes, query.planes, T).T_ref_query for T in found]

    return refined


def error(T: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    d = invert(truth) @ T
    return float(np.linalg.norm(d[:3, 3])), float(np.degrees(rotation_angle(d[:3, :3])))


@pytest.mark.parametrize(("name", "metres", "degrees"), [("kitti_07_dump", 0.035, 0.32), ("newer_01", 0.025, 0.08)])
def test_neighbours_agree_with_the_graph_from_no_prior_at_all(
    scans: Scans, guessed: Guessed, name: str, metres: float, degrees: float
) -> None:
    poses, sides = scans[name]
    for i in range(4):
        ref, query = sides[i], sides[i + 1]
        best = max(guessed(name, i), key=lambda T: fit(ref.planes, query.planes, T, ShiftOptions()))
        m, d = error(best, invert(poses[i]) @ poses[i + 1])
        assert m < metres, (i, m, d)
        assert d < degrees, (i, m, d)


@pytest.mark.parametrize("name", list(FILES))
def test_any_turn_and_a_coarse_place_lead_to_the_same_pose(scans: Scans, name: str) -> None:
    """From the graph's place with the heading wrong by up to 4 degrees: what global registration leaves open."""
    poses, sides = scans[name]
    for (i, j), yaw in zip(combinations(range(3), 2), (4.0, -3.0, 2.0), strict=True):
        truth = invert(poses[i]) @ poses[j]
        turn = make_transform(so3_exp([0, 0, np.radians(yaw)]), [0.3, -0.3, 0.1])
        there = run_icp(sides[i].planes, sides[j].planes, truth)
        again = run_icp(sides[i].planes, sides[j].planes, truth @ turn)
        m, d = error(again.T_ref_query, there.T_ref_query)
        assert m < 0.005
        assert d < 0.03


def test_from_the_identity_turned_by_up_to_thirty_degrees(scans: Scans, guessed: Guessed) -> None:
    """Newer College: neighbours lie a metre apart; where the identity is too coarse a prediction, features help."""
    poses, sides = scans["newer_01"]
    for (i, j), yaw in (((0, 1), 30.0), ((1, 2), -30.0), ((2, 3), 20.0), ((3, 4), -10.0)):
        start = make_transform(so3_exp([0, 0, np.radians(yaw)]), [0.0, 0.0, 0.0])
        ref, query = sides[i], sides[j]
        refined = [run_icp(ref.planes, query.planes, start).T_ref_query, *guessed("newer_01", i)]
        best = max(refined, key=lambda T: fit(ref.planes, query.planes, T, ShiftOptions()))
        m, d = error(best, invert(poses[i]) @ poses[j])
        assert m < 0.03
        assert d < 0.15


def test_far_pairs_close_the_cycle_of_near_ones(scans: Scans) -> None:
    poses, sides = scans["newer_01"]

    def registered(i: int, j: int) -> np.ndarray:
        return run_icp(sides[i].planes, sides[j].planes, invert(poses[i]) @ poses[j]).T_ref_query

    chain = np.eye(4)
    for i in range(4):
        chain = chain @ registered(i, i + 1)
    m, d = error(registered(0, 4), chain)
    assert m < 0.025
    assert d < 0.1


def test_right_poses_of_a_dense_scene_are_trusted_and_wrong_ones_are_not(scans: Scans) -> None:
    poses, sides = scans["newer_01"]
    for i in range(4):
        ref, query = sides[i], sides[i + 1]
        found = run_icp(ref.planes, query.planes, invert(poses[i]) @ poses[i + 1])
        assert verdict(verification_evidence(ref, query, found.T_ref_query, found.information)) == ""
        for wrong in (
            make_transform(so3_exp([0, 0, np.pi]), [0, 0, 0]),
            make_transform(np.eye(3), [6.0, 0, 0]),
            make_transform(so3_exp([0, 0, 0.2]), [0, 0, 0]),
        ):
            T = found.T_ref_query @ wrong
            assert verdict(verification_evidence(ref, query, T, found.information))

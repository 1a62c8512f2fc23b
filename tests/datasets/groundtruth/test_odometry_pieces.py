"""Where odometry has a gap or a break, nothing is carried across it: neither poses of images, nor depth, nor motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.blocks.nodes import nearest_nodes
from relocbench.datasets.groundtruth.calibration.estimation import node_twists
from relocbench.datasets.groundtruth.pairs.outcome import SolvedDrive
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import make_transform

TENTH = 100_000_000
BREAK = 40
JUMP_M = 0.3
"""odometry is too long by this much at the break"""


def along(x: Array) -> Array:
    return make_transform(np.eye(3), np.stack([x, 0 * x, 0 * x], axis=-1))


def drive() -> tuple[Trajectory, Nodes]:
    """Ten metres a second, ten poses a second, a node every two metres, and a step that is off, where it is broken."""
    count = np.arange(80, dtype=np.float64)
    jumped = np.where(count >= BREAK, JUMP_M, 0.0)
    odometry = Trajectory((TENTH * count).astype(np.int64), along(count + jumped), breaks=(BREAK,))
    times = np.array([TENTH * k for k in range(1, 80, 2)])
    piece = odometry.pieces(times)
    return odometry, Nodes(times, odometry.at(times), times / TENTH, piece)


def solved(odometry: Trajectory, nodes: Nodes) -> SolvedDrive:
    """The graph has put every node where it is in truth."""
    return SolvedDrive(nodes, odometry, along(nodes.times_ns / TENTH))


@pytest.mark.parametrize("tenths", [BREAK - 3, BREAK - 1.5, BREAK - 1, BREAK, BREAK + 0.5, BREAK + 1, BREAK + 4])
def test_poses_beside_a_break_follow_the_node_on_their_side(tenths: float) -> None:
    odometry, nodes = drive()
    place = solved(odometry, nodes).place(round(tenths * TENTH))
    assert place is not None
    np.testing.assert_allclose(place.T_world_rig, along(np.array(tenths)), atol=1e-9)
    assert (nodes.times_ns[place.node] < BREAK * TENTH) == (tenths < BREAK)


def test_no_pose_is_known_within_a_break_or_on_a_piece_without_nodes() -> None:
    odometry, nodes = drive()
    assert solved(odometry, nodes).place(round((BREAK - 0.5) * TENTH)) is None
    short = replace(odometry, breaks=(BREAK - 2, BREAK))  # two poses, and no node: those of the sides are near
    kept = np.array([t for t in range(len(nodes.times_ns)) if nodes.times_ns[t] != (BREAK - 1) * TENTH])
    fewer = Nodes(
        nodes.times_ns[kept], nodes.T_odom_node[kept], nodes.travelled_m[kept], short.pieces(nodes.times_ns[kept])
    )
    assert solved(short, fewer).place((BREAK - 1) * TENTH) is None
    assert solved(short, fewer).place((BREAK - 3) * TENTH) is not None


def test_the_nearest_node_is_on_the_same_piece() -> None:
    odometry, nodes = drive()
    times = np.array([0, BREAK - 1, BREAK, 79], dtype=np.int64) * TENTH
    at = nodes.times_ns[nearest_nodes(nodes, odometry, times)] / TENTH
    assert at.tolist() == [1, BREAK - 1, BREAK + 1, 79]
    only = Nodes(nodes.times_ns[:5], nodes.T_odom_node[:5], nodes.travelled_m[:5])
    assert nearest_nodes(only, odometry, times).tolist() == [0, 4, -1, -1]


def test_a_jump_is_no_motion() -> None:
    odometry, nodes = drive()
    np.testing.assert_allclose(node_twists(odometry, nodes)[:, 0], 10.0, atol=1e-6)
    whole = replace(odometry, breaks=())
    assert node_twists(whole, nodes)[:, 0].max() > 10.5

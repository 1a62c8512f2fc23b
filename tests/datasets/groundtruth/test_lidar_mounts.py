"""Lidars that are mounted otherwise than their extrinsics say: upside down by the road, and what blocks would be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lidar_street import Street, drive_street
from refusals import assert_names
from robotcar_street import Built, record_robotcar_street

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.nodes import make_nodes
from relocbench.datasets.groundtruth.blocks.store import build_blocks, write_block
from relocbench.datasets.groundtruth.calibration.correction import CorrectedLidar
from relocbench.datasets.groundtruth.jobs.mounting import mounting_faults, road_height
from relocbench.datasets.groundtruth.registration.mounts import MOUNTS, RemountedStore
from relocbench.datasets.groundtruth.registration.rig_mounts import contradicting_mount
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.importers.robotcar.recording import read_robotcar
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream
from relocbench.geometry import make_transform, so3_exp

STREET = Street(length_m=10.0, sigma=0.01)


def remounted(lidar: LidarStream, how: Callable[[Array], Array]) -> CorrectedLidar:
    return CorrectedLidar(lidar, 0, how(lidar.T_rig_lidar) @ np.linalg.inv(lidar.T_rig_lidar))


def mounted(recording: FieldRecording, how: Callable[[Array], Array], *numbers: int) -> FieldRecording:
    """The recording with other extrinsics of some of its lidars."""
    lidars = [remounted(s, how) if k in numbers else s for k, s in enumerate(recording.lidars)]
    return replace(recording, lidars=tuple(lidars))


def upside_down(T: Array) -> Array:
    return make_transform(so3_exp([np.pi, 0.0, 0.0]) @ T[:3, :3], T[:3, 3])


@pytest.mark.parametrize("numbers", [(0, 1), (1,)])
def test_lidars_that_are_upside_down_are_named(numbers: tuple[int, ...]) -> None:
    recording = drive_street(STREET)
    assert mounting_faults(recording) == []
    (fault,) = mounting_faults(mounted(recording, upside_down, *numbers))
    assert_names(fault.expected, "", None, "1.1 m", *(f"lidar{k}" for k in numbers))
    assert ("lidar0" in fault.expected) == (0 in numbers)


def test_a_ceiling_is_no_road() -> None:
    rng = np.random.default_rng(0)
    inside = rng.uniform([-8, -4, -1.5], [8, 4, 1.5], size=(4000, 3))
    walls, ceiling, floor = (inside.copy() for _ in range(3))
    walls[:, 1] = np.sign(walls[:, 1]) * 4.0
    ceiling[:, 2], floor[:, 2] = 1.5, -1.5
    assert np.isnan(road_height(np.concatenate([walls, ceiling, floor])))
    assert np.isnan(road_height(np.concatenate([walls, ceiling])))
    near = ceiling * [1.0, 1.0, 0.3]  # a garage: of the floor there are a tenth as many points
    assert np.isnan(road_height(np.concatenate([walls, near, floor[:400]])))
    high = walls * [1.0, 1.0, 5.0] + [0.0, 0.0, 6.0]
    assert road_height(np.concatenate([high, floor])) == pytest.approx(-1.5, abs=0.1)
    assert road_height(-np.concatenate([high, floor])) == pytest.approx(1.5, abs=0.1)


@pytest.mark.thorough
@pytest.mark.parametrize("words", list(MOUNTS)[::3])
def test_blocks_are_put_as_the_right_extrinsics_would_have_them(words: str, tmp_path: Path) -> None:
    recording = drive_street(Street(length_m=4.0, sigma=0.01))
    wrong = mounted(recording, MOUNTS[words], 1)
    stores = [build_blocks(r, make_nodes(r), tmp_path / str(k)) for k, r in enumerate((recording, wrong))]
    again = RemountedStore(stores[1].folder, {1: wrong.lidars[1].T_rig_lidar}, MOUNTS[words])
    right, found = stores[0].get(0), again.get(0)
    own = [block.points[block.lidar == 1] for block in (right, found)]
    apart = np.linalg.norm(own[0][:, None] - own[1][None], axis=2)
    assert np.median(apart.min(axis=1)) < 0.05


@pytest.mark.thorough
def test_lidars_of_one_drive_that_contradict_each_other_are_named(robotcar_built: Built, tmp_path: Path) -> None:
    folder = record_robotcar_street.original().folders[0]
    recording = read_robotcar(folder)
    right = Drive(recording, make_nodes(recording), robotcar_built.root / "groundtruth" / "blocks" / recording.name)
    assert contradicting_mount(right) == ""
    one, other = recording.lidars
    turned = next(iter(MOUNTS.values()))
    wrong = RemountedStore(right.blocks, {1: np.asarray(other.T_rig_lidar)}, turned)
    for node in range(len(right.nodes)):
        write_block(tmp_path / f"{node:06d}.npz", wrong.get(node))
    lidars = one, remounted(other, turned)
    spoilt = Drive(replace(recording, lidars=lidars), right.nodes, tmp_path)
    assert_names(contradicting_mount(spoilt), "", None, recording.name, "180 deg")

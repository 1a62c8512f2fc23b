"""Short drives along a small street in the Boreas layout, with all that is true about them.

Tests of other layouts write the same drives anew, so that each is judged by the same truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from built_once import built_once
from fenced_street import fenced_street_mesh, record_fenced
from projected_depth import depth_errors, true_depth
from small_street import Street

from relocbench.arrays import Array, Times
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.traversal import read_poses
from relocbench.datasets.importers.boreas.recording import read_boreas
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles
from relocbench.datasets.sensors.image_files import ImageFiles
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream, Trajectory
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs.recording import DriveOptions
from relocbench.datasets.synthetic.layouts.recorded import Layout
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.geometry import interpolate_trajectory, invert
from relocbench.metrics.pose.errors import pose_errors
from relocbench.progress import Reporter, Silent

SMALL = (
    *("--submap", 20, "--depth-submap", 10, "--keyframe-distance", 5, "--query-distance", 4, "--correspondences", 50),
    *("--matcher", "fgr", "--calibration", "given"),
)
"""options of a build from drives that are this short"""


@dataclass(frozen=True, eq=False)
class StreetDrive:
    """One drive."""

    root: Path
    options: DriveOptions

    @cached_property
    def layout(self) -> Layout:
        return self.options.target(self.root)

    @property
    def folder(self) -> Path:
        return self.layout.folder

    @cached_property
    def _motion(self) -> tuple[Times, Array]:
        poses = read_poses(self.root / "truth" / self.layout.name / "poses.csv")
        return np.array(list(poses)), np.array(list(poses.values()))

    def T_world_car(self, times_ns: Times) -> Array:
        """(N, 4, 4) of the car, whose origin is on the road below its middle: x forward, y left, z up."""
        return interpolate_trajectory(*self._motion, times_ns)

    @property
    def T_car_lidar(self) -> Array:
        return np.asarray(self.layout.lidars["lidar"].T_rig_lidar)

    @property
    def T_car_cam(self) -> Array:
        return np.asarray(self.layout.cameras["camera"].T_rig_cam)

    @cached_property
    def source(self) -> FieldRecording:
        """The drive as the importer of Boreas reads it."""
        return read_boreas(self.folder, self.layout.name).recording(_no_lidar, Silent())


def _no_lidar(
    lidar: LidarStream, reporter: Reporter | None = None, /, *, max_gap_ns: int = 1_000_000_000
) -> Trajectory:
    raise AssertionError("poses are there")


def record_street(out: Path, number: int, frames: int = 26, *, rings: int = 16, azimuths: int = 720) -> StreetDrive:
    """Record a drive; drives of different numbers differ in all that is random."""
    options = DriveOptions("boreas", number=number, frames=frames, scale=0.08, rings=rings, azimuths=azimuths)
    return StreetDrive(_recorded(out, number, frames, rings, azimuths), options)


@built_once(Path)
def _recorded(out: Path, number: int, frames: int, rings: int, azimuths: int) -> None:
    record_fenced(out, "boreas", frames=frames, scale=0.08, rings=rings, azimuths=azimuths, number=number)


def street_scene() -> LidarScene:
    return LidarScene(fenced_street_mesh(Street(), Factors()))


def errors_of(
    drive: StreetDrive, recording: FieldRecording, camera: str, index: int, scene: LidarScene, *, lidar: int = 0
) -> Array:
    """:func:`depth_errors` of an image of a recording of the drive in any layout, whose camera is that of the drive."""
    stream = recording.cameras[camera]
    T_world_cam = drive.T_world_car(stream.times_ns[[index]])[0] @ drive.T_car_cam
    return depth_errors(recording, camera, index, true_depth(scene, stream.camera, T_world_cam), lidar=lidar)


def from_poses(drive: DriveFiles) -> FieldRecording:
    """The recording of a drive that has poses."""
    return drive.recording(_no_lidar, Silent())


def assert_pairs_are_right(
    root: Path, pair_set: str, reference: StreetDrive, query: StreetDrive, *, T_rig_cam: Array | None = None
) -> None:
    """Fail unless the dataset has at least four pairs, none of which is off by 10 cm or 0.15 degrees.

    Args:
        T_rig_cam: (4, 4) where the camera is on the rig, if the pairs are of the rig.
    """
    dataset = Dataset(root)
    T_cam_rig = np.eye(4) if T_rig_cam is None else invert(T_rig_cam)
    found, exact = [], []
    for pair in dataset.pair_set(pair_set).pairs:
        T_world_ref = reference.T_world_car(np.array([pair.ref_timestamp_ns]))[0] @ reference.T_car_cam @ T_cam_rig
        T_world_query = query.T_world_car(np.array([pair.query_timestamp_ns]))[0] @ query.T_car_cam @ T_cam_rig
        assert pair.T_query_ref is not None
        found.append(pair.T_query_ref)
        exact.append(invert(T_world_query) @ T_world_ref)
    assert len(found) >= 4
    errors = pose_errors(found, exact)
    assert errors.translation_error_m.max() < 0.10
    assert errors.rotation_error_deg.max() < 0.15


def with_camera(drive: StreetDrive, recording: FieldRecording) -> FieldRecording:
    """A recording that has no images with the camera of the drive, where it is beside the first lidar."""
    T_rig_cam = recording.lidars[0].T_rig_lidar @ invert(drive.T_car_lidar) @ drive.T_car_cam
    camera = drive.source.cameras["camera"]
    assert isinstance(camera, ImageFiles)
    return replace(recording, cameras={"camera": replace(camera, T_rig_cam=T_rig_cam)})

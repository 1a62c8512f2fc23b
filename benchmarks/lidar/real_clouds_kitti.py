"""Six scans of KITTI 00 in the builder, for ``real_clouds.py``: odometry from scans, and depth compared with stereo."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.alignment.two_drives import AlignmentOptions
from relocbench.datasets.groundtruth.depth.depth import DepthOptions
from relocbench.datasets.groundtruth.depth.images import DepthView
from relocbench.datasets.groundtruth.depth.stereo import Agreement, cross_check, stereo_pair
from relocbench.datasets.groundtruth.submaps.drive import make_drive
from relocbench.datasets.importers.kitti.recording import read_kitti
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.progress import Silent

ALONG_M = (0.689, 1.382, 2.100, 2.832, 3.576)
"""metres from frame 0 to frames 1 to 5 along the lidar's x axis, by generalised ICP of each scan with the first; the
poses of the data set are 25 % wrong there"""
BLOCK_M = 0.5
"""shorter than usual, since the stretch is 3.6 m long and only one block of 2 m would fit"""


@dataclass(frozen=True, eq=False)
class Kitti00:
    """The builder's results."""

    elevation_deg: float
    along_m: Array
    """(5,)"""
    coverage: float
    """share of the first image's pixels with depth from lidar"""
    agreement: Agreement

    @property
    def errors_m(self) -> Array:
        """(5,) against :data:`ALONG_M`."""
        return np.asarray(self.along_m - ALONG_M)


def kitti_00(folder: Path, elevation_deg: float) -> Kitti00:
    """Compute odometry, blocks, a submap and the depth of the first left image, and compare it with stereo depth.

    Raises:
        DatasetError: a file, which is named, is missing or damaged.
    """
    recording = read_kitti(folder, "00", cameras=("image_0", "image_1"), elevation_deg=elevation_deg)
    left, pair = recording.cameras["image_0"], stereo_pair(recording.cameras, "image_0")
    if pair is None or not pair.common_times():
        raise DatasetError("expected a rectified stereo pair with an image of both cameras", recording.folder)
    time_ns = min(pair.common_times())
    options = AlignmentOptions(block_m=BLOCK_M)
    with tempfile.TemporaryDirectory() as work:
        drive = make_drive(recording, Path(work) / "blocks", options.block_m, Silent(), Run(1))
        view = DepthView(drive, left.camera, left.T_rig_cam, "lidar", pair, options.submap_m, DepthOptions())
        lidar = view.by_lidar(time_ns)
    agreement = cross_check(lidar.depth, pair.depth(time_ns).depth, left.camera, pair.baseline_m)
    return Kitti00(elevation_deg, recording.odometry.T_odom_rig[1:6, 0, 3], lidar.coverage, agreement)

"""Whether motion distorts the scans of a bag whose points have no times is told from the scans."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lidar_layouts import compensated, scans_of
from made_bags import Bag
from recorded_street import StreetDrive
from refusals import Notes

from relocbench.datasets.groundtruth.odometry.deferred import later
from relocbench.datasets.importers.rosbag.reading import BagSettings
from relocbench.datasets.importers.rosbag.recording import open_bag, read_bag
from relocbench.datasets.importers.rosbag.roles import Wanted
from relocbench.datasets.sensors.recording import LidarStream

pytestmark = pytest.mark.thorough


def bag_of(drive: StreetDrive, path: Path, motion: str) -> Path:
    bag = Bag(ros1=True)
    for found in scans_of(drive):
        points = compensated(drive, found) if motion == "compensated" else found.points
        rows = np.zeros(len(points), [(axis, "<f4") for axis in "xyz"])
        for axis, values in zip("xyz", points.T, strict=True):
            rows[axis] = values
        bag.cloud("/points", found.middle_ns, rows)
    return bag.write(path)


def lidar_of(path: Path, spoken: Notes, settings: BagSettings) -> LidarStream:
    opened = open_bag(path, Wanted(), spoken)
    return read_bag(opened, "drive", settings, reporter=spoken, from_lidar=later)[0].lidars[0]


@pytest.mark.parametrize("motion", ["distorted", "compensated"])
def test_motion_of_scans_without_times_is_told_from_them(
    drives: list[StreetDrive], tmp_path: Path, motion: str
) -> None:
    path, spoken = bag_of(drives[0], tmp_path / "drive.bag", motion), Notes()
    scan = lidar_of(path, spoken, BagSettings()).read(9)
    assert (np.ptp(scan.times_ns) > 50_000_000) == (motion == "distorted"), spoken.notes
    told = [note for note in spoken.notes if f"points have no times: scans are taken as {motion} by motion" in note]
    assert len(told) == 1
    spoken = Notes()
    scan = lidar_of(path, spoken, BagSettings(motion="compensated")).read(9)
    assert np.ptp(scan.times_ns) == 0
    assert not any("by motion" in note for note in spoken.notes)

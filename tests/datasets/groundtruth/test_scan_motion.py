"""Whether scans are motion-compensated is told from the scans, and where it cannot be told, this is said."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fenced_street import record_fenced

from relocbench.arrays import Times
from relocbench.datasets.groundtruth.odometry.deferred import computed, is_pending, later
from relocbench.datasets.groundtruth.odometry.scan_motion import detect_motion
from relocbench.datasets.importers.kitti.recording import VelodyneStream, read_kitti
from relocbench.datasets.sensors.recording import Scan, Trajectory
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS
from relocbench.progress import Silent


def recorded(out: Path, distorted: bool) -> Path:
    record_fenced(
        out, "kitti", CONDITIONS["Sunny"].factors, frames=20, scale=0.06, rings=16, azimuths=360, cameras=(),
        motion_distorted=distorted,
    )  # fmt: skip
    return out


@pytest.mark.thorough
@pytest.mark.parametrize("distorted", [False, True])
def test_scans_are_told_to_be_compensated_or_distorted(tmp_path: Path, distorted: bool) -> None:
    root = recorded(tmp_path, distorted)
    lidar = read_kitti(root, "00", motion="auto", from_lidar=later).lidars[0]
    assert isinstance(lidar, VelodyneStream)
    assert lidar.motion == ("distorted" if distorted else "compensated")


@dataclass(frozen=True, eq=False)
class Standing:
    """A lidar that stands before three walls."""

    count: int = 20
    name: str = "top"
    pattern: str = "spinning"
    max_range_m: float = 100.0
    sigma_m: float = 0.02
    turning: bool = False

    @property
    def T_rig_lidar(self) -> np.ndarray:
        return np.eye(4)

    @property
    def times_ns(self) -> Times:
        return 100_000_000 * np.arange(self.count, dtype=np.int64)

    def read(self, index: int) -> Scan:
        rng = np.random.default_rng(index)
        a, z = rng.uniform(-15, 15, size=1500), rng.uniform(-1, 5, size=1500)
        walls = [np.column_stack([a, np.full(1500, y), z]) for y in (-9.0, 11.0)]
        points = np.concatenate([*walls, np.column_stack([np.full(1500, 16.0), a, z])])
        azimuth = np.arctan2(points[:, 1], points[:, 0])
        offsets = np.rint(azimuth / (2 * np.pi) * 1e8).astype(np.int64) if self.turning else 0
        return Scan(points, np.full(len(points), self.times_ns[index]) + offsets)


@pytest.mark.thorough
@pytest.mark.parametrize("count", [20, 4])
def test_a_lidar_that_stands_or_has_few_scans_tells_nothing(count: int) -> None:
    told = detect_motion(Standing(count), Standing(count, turning=True))  # type: ignore[arg-type]
    assert told.motion == "compensated"
    assert "cannot be told" in told.evidence


def test_odometry_that_is_deferred_is_computed_once_it_is_asked_for(tmp_path: Path) -> None:
    recording = read_kitti(recorded(tmp_path, False), "00", from_lidar=later)
    assert is_pending(recording)
    assert recording.odometry_lidar == "velodyne"
    asked: list[str] = []

    def compute(lidar: object, reporter: object = None, /, *, max_gap_ns: int = 0) -> Trajectory:
        asked.append(lidar.name)  # type: ignore[attr-defined]
        return Trajectory(recording.odometry.times_ns, recording.odometry.T_odom_rig, max_gap_ns)

    done = computed(recording, compute, Silent())
    assert asked == ["velodyne"]
    assert not is_pending(done)
    assert computed(done, compute, Silent()) is done

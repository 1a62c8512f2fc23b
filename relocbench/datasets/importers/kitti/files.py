"""Parsers for the text files of a KITTI odometry sequence: calibration, poses, times."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core import images
from relocbench.datasets.sensors.numbered_rows import NumberedRows, read_numbered_rows, read_numbered_times
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_tables import MATRIX, PoseTable, pose_table
from relocbench.datasets.sensors.trajectories import numbered_files
from relocbench.errors import DatasetError
from relocbench.files import parse_floats, read_rows
from relocbench.geometry import Camera, make_transform, project_to_rotation
from relocbench.progress import SILENT, Reporter

_SECOND_NS = 10**9
_CALIBRATION_LINES = ("P0", "P1", "P2", "P3", "Tr")
_MATRIX = " ".join(f"m{row}{column}" for row in range(3) for column in range(4))


@dataclass(frozen=True)
class Calibration:
    """``calib.txt``: lines ``P0`` to ``P3`` and ``Tr``, each with an optional name and twelve numbers."""

    path: Path
    matrices: dict[str, Array]
    """name -> (3, 4)"""

    @classmethod
    def read(cls, path: Path) -> Calibration:
        """Read the file. Raises DatasetError with file and line."""
        matrices: dict[str, Array] = {}
        for order, (number, fields) in enumerate(read_rows(path, "a KITTI calibration", DatasetError)):
            if fields[0].endswith(":"):
                name, fields = fields[0][:-1], fields[1:]
            elif order < len(_CALIBRATION_LINES):
                name = _CALIBRATION_LINES[order]
            else:
                raise DatasetError(f"expected at most the lines {', '.join(_CALIBRATION_LINES)}", path, number)
            values = parse_floats(fields, path, number, _MATRIX, DatasetError)
            matrices[name] = np.array(values).reshape(3, 4)
        return cls(path, matrices)

    def matrix(self, name: str, why: str) -> Array:
        """The matrix (3, 4) of a line. Raises DatasetError if the line is missing."""
        if name not in self.matrices:
            raise DatasetError(f"line '{name}:' is missing, which {why} needs", self.path)
        return self.matrices[name]

    def projection(self, camera: str) -> Array:
        """Projection P (3, 4) of ``image_N`` from the frame of camera 0: ``K [I | t]``."""
        return self.matrix(f"P{camera[-1]}", camera)

    def T_cam0_cam(self, camera: str) -> Array:
        """Pose (4, 4) of a rectified camera: ``P = K [I | t]`` has ``T_cam_cam0 = [I | t]``."""
        p = self.projection(camera)
        return make_transform(np.eye(3), -np.linalg.solve(p[:, :3], p[:, 3]))

    def T_cam0_lidar(self) -> Array:
        """Pose (4, 4) of the lidar in the frame of camera 0."""
        tr = self.matrix("Tr", "velodyne depth")
        return make_transform(project_to_rotation(tr[:, :3]), tr[:, 3])


@dataclass(frozen=True)
class KittiSequence:
    """One sequence folder."""

    root: Path
    name: str

    @property
    def folder(self) -> Path:
        return self.root / "sequences" / self.name

    @property
    def traversal(self) -> str:
        return f"kitti_{self.name}"

    @property
    def poses_file(self) -> Path:
        return self.root / "poses" / f"{self.name}.txt"

    @cached_property
    def calibration(self) -> Calibration:
        return Calibration.read(self.folder / "calib.txt")

    def frames(self, folder: str, suffix: str) -> dict[int, Path]:
        """Files of a folder by frame number; a missing folder has none."""
        return numbered_files(self.folder / folder, suffix)

    def image_frames(self, camera: str) -> dict[int, Path]:
        """Images of a camera by frame number."""
        return self.frames(camera, ".png") or self.frames(camera, ".jpg")

    def camera(self, camera: str, example: Path) -> Camera:
        """The rectified camera with the intrinsics of its projection and the size of an image.

        Raises:
            DatasetError: the image or the projection is bad.
        """
        p = self.calibration.projection(camera)
        height, width = images.read_image(example).shape[:2]
        try:
            return Camera("pinhole", width, height, float(p[0, 0]), float(p[1, 1]), float(p[0, 2]), float(p[1, 2]))
        except ValueError as bad:
            raise DatasetError(f"line 'P{camera[-1]}:' is not a projection ({bad})", self.calibration.path) from None

    def poses(self, reporter: Reporter = SILENT) -> tuple[NumberedRows, dict[int, Array]]:
        """The rows of the file of poses, and ``T_world_cam0`` (4, 4) by frame, without frames that have none.

        Raises:
            DatasetError: with file and line.
        """
        rows = read_numbered_rows(self.poses_file, f"poses of sequence {self.name} (12 numbers a line)")
        filled = rows.filled
        table = pose_table(list(filled.values()), MATRIX, self.poses_file, reporter, times=list(filled))
        return rows, table.by_time

    def times(self, rate_hz: float, frames: int, reporter: Reporter) -> tuple[NumberedRows | None, dict[int, int]]:
        """The rows of ``times.txt``, if there is one, and nanoseconds by frame, from it or by ``rate_hz``.

        Args:
            frames: the number of the last one, and one.

        Raises:
            DatasetError: with file and line: a row is no time, times do not increase, or there are fewer than frames.
        """
        path = self.folder / "times.txt"
        if not path.exists():
            reporter.note(f"{self.name}: no times.txt; {rate_hz:g} frames per second are assumed")
            return None, {i: round(i * 1e9 / rate_hz) for i in range(frames)}
        rows, times, _ = read_numbered_times(path, _SECOND_NS)
        rows.check_covers(frames, "frames")
        return rows, times

    def times_and_poses(
        self, rate_hz: float, frames: int, reporter: Reporter
    ) -> tuple[dict[int, int], dict[int, Array], tuple[int, ...]]:
        """Nanoseconds and ``T_world_cam0`` (4, 4) by frame, of those that have one, and the poses after a break.

        Raises:
            DatasetError: with file and line: as :meth:`times` and :meth:`poses`, or the files have different numbers of
                rows, or fewer than there are frames: then nothing tells which row belongs to which frame.
        """
        rows, poses = self.poses(reporter)
        rows.check_covers(frames, "frames")
        timed, times = self.times(rate_hz, frames, reporter)
        if timed is not None:
            rows.check_agrees(timed)
        numbers = [number for number in poses if number in times]
        table = plausible(
            PoseTable(
                self.poses_file,
                np.array([times[number] for number in numbers], dtype=np.int64),
                np.array([poses[number] for number in numbers]).reshape(-1, 4, 4),
                [rows.filled[number].line for number in numbers],
            ),
            reporter,
        )
        posed = set(table.times_ns.tolist())
        return times, {number: poses[number] for number in numbers if times[number] in posed}, table.breaks

"""Parsers for the files of a 4Seasons or MLAD recording.

Frames: ``cam`` is the rectified left camera (cam0), ``w`` the world of the recording's own SLAM, ``gpsw`` a world
aligned with gravity and north, and ``e`` the earth (ECEF).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.core.pairfile import parse_pose
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_columns import read_pose_columns
from relocbench.datasets.sensors.pose_tables import TQ, Row, pose_table
from relocbench.datasets.sensors.times import times_in_ns
from relocbench.errors import DatasetError
from relocbench.files import lines_of, parse_floats, parse_timestamp, read_rows, read_text
from relocbench.geometry import Camera, invert
from relocbench.progress import SILENT, Reporter
from relocbench.tracking import KeyframePoints

_POINT_FIELDS = "u v idepth idepth_hessian maxRelBaseline numGoodRes status"
_PATCH_FIELDS = " ".join(f"grey{i}" for i in range(8))
"""the grey values around a point (Engel et al. 2018, pattern 8)"""

MAX_IDEPTH_VARIANCE = 0.001
MAX_DEPTH_VARIANCE = 0.001
MIN_RELATIVE_BASELINE = 0.1
_HESSIAN_FLOOR = 0.01


@dataclass(frozen=True, eq=False)
class KeyframeFile:
    """``KeyFrameData/KeyFrame_TIMESTAMP.txt``: one keyframe of the direct odometry and the points it hosts.

    Lengths are in units of ``w``; the GNSS scale converts them to metres.
    """

    timestamp_ns: int
    camera: Camera
    T_w_cam: Array
    """(4, 4), as estimated by the odometry; not the fused pose of GNSSPoses.txt"""
    uv: Array
    """(N, 2) pixels"""
    inverse_depth: Array
    """(N,)"""
    hessian: Array
    """(N,) Hessian of the inverse depth, whose variance is 1 / hessian"""
    relative_baseline: Array
    """(N,) greatest ratio of baseline to depth among the frames that saw the point"""

    def __len__(self) -> int:
        return len(self.uv)

    @property
    def reliable(self) -> Mask:
        """(N,) The usual selection of points for localization: positive, of low variance and sufficient baseline."""
        variance = 1.0 / (self.hessian + _HESSIAN_FLOOR)
        with np.errstate(divide="ignore"):
            depth_variance = variance / self.inverse_depth**4
        return (
            (self.inverse_depth > 0)
            & (depth_variance <= MAX_DEPTH_VARIANCE)
            & (variance <= MAX_IDEPTH_VARIANCE)
            & (self.relative_baseline >= MIN_RELATIVE_BASELINE)
        )

    def points(self, scale: float = 1.0, keep: Mask | None = None) -> KeyframePoints:
        """Points in metres: a depth d of ``w`` is ``scale * d`` metres, so inverse depth and sigma are divided by it.

        Args:
            scale: metres per unit of ``w``.
            keep: (N,) mask of the points to return; those without positive inverse depth are always left out.
        """
        chosen = self.inverse_depth > 0
        if keep is not None:
            chosen = chosen & keep
        sigma = 1.0 / np.sqrt(self.hessian[chosen] + _HESSIAN_FLOOR)
        return KeyframePoints(self.uv[chosen], self.inverse_depth[chosen] / scale, sigma / scale)


@dataclass(frozen=True, eq=False)
class GnssPose:
    """One line of ``GNSSPoses.txt``."""

    T_w_cam: Array
    """(4, 4), translation in units of ``w``"""
    scale: float
    """metres per unit of ``w``"""

    @property
    def metric(self) -> Array:
        """(4, 4) ``T_w_cam`` in metres."""
        pose = self.T_w_cam.copy()
        pose[:3, 3] *= self.scale
        return pose


@dataclass(frozen=True, eq=False)
class Transformations:
    """What is used of ``Transformations.txt``."""

    T_e_w: Array
    """(4, 4) from the SLAM world in metres to the earth: ``p_e = e_gpsw inv(w_gpsw) (scale p_w)``"""
    scale: float
    """metres per unit of ``w``"""


_TRANSFORMATIONS = ("S_AS", "TS_cam_imu", "w_gpsw", "gps_imu", "e_gpsw", "scale")


def read_keyframe(path: Path) -> KeyframeFile:
    """Parse a keyframe file. Exposure, GNSS fix and the grey values of points are checked, but not kept.

    Raises:
        DatasetError: with file and line: a part is missing, a field is not a number, the number of points differs
            from the header's, or the timestamp from the one in the file's name.
    """
    rows = list(read_rows(path, "a keyframe (timestamp, camera, pose, exposure, points)", DatasetError))
    if len(rows) < 4:
        raise DatasetError("expected timestamp, camera, pose and exposure before the points", path)
    (time_line, time), (camera_line, intrinsics), (pose_line, pose), (exposure_line, exposure) = rows[:4]
    timestamp = parse_timestamp(" ".join(time), path, time_line, DatasetError)
    if path.stem.startswith("KeyFrame_") and path.stem != f"KeyFrame_{timestamp}":
        raise DatasetError(f"timestamp {timestamp} is not the one of the file's name", path, time_line)
    fx, fy, cx, cy, width, height, count = parse_floats(
        intrinsics, path, camera_line, "fx fy cx cy width height npoints", DatasetError
    )
    try:
        camera = Camera("pinhole", int(width), int(height), fx, fy, cx, cy)
    except ValueError as bad:
        raise DatasetError(str(bad), path, camera_line) from None
    body = rows[4:]
    if body and len(body[0][1]) == 9:
        _check_gps(body, path)
        body = body[2:]
    if len(body) != 2 * int(count):
        raise DatasetError(
            f"holds {len(body) / 2:g} points (two lines each), but its header says {int(count)}", path, camera_line
        )
    table = [parse_floats(f, path, n, _POINT_FIELDS, DatasetError) for n, f in body[0::2]]
    for line, fields in body[1::2]:
        parse_floats(fields, path, line, _PATCH_FIELDS, DatasetError)
    values = np.array(table, dtype=np.float64).reshape(-1, 7)
    negative = np.nonzero(values[:, 3] < 0)[0]
    if negative.size:
        raise DatasetError("idepth_hessian is negative", path, body[2 * int(negative[0])][0])
    parse_floats(exposure, path, exposure_line, "exposure_ms", DatasetError)
    return KeyframeFile(
        timestamp_ns=timestamp,
        camera=camera,
        T_w_cam=parse_pose(pose, path, pose_line),
        uv=values[:, :2].copy(),
        inverse_depth=values[:, 2].copy(),
        hessian=values[:, 3].copy(),
        relative_baseline=values[:, 4].copy(),
    )


def _check_gps(rows: list[tuple[int, list[str]]], path: Path) -> None:
    """Check the covariance and the position of the GNSS fix that some keyframe files hold."""
    line, fields = rows[0]
    parse_floats(fields, path, line, " ".join(f"cov{i}" for i in range(9)), DatasetError)
    if len(rows) < 2:
        raise DatasetError("expected the GPS point after its covariance", path, line)
    line, fields = rows[1]
    parse_floats(fields, path, line, "x y z", DatasetError)


def keyframe_files(recording: Path) -> dict[int, Path]:
    """Keyframe files of a recording by timestamp, in time order. Raises DatasetError if a name has no timestamp."""
    files = sorted((recording / "KeyFrameData").glob("KeyFrame_*.txt"))
    texts = [path.stem.removeprefix("KeyFrame_") for path in files]
    return dict(sorted(zip(times_in_ns(texts, lambda i: (files[i], None)).ns, files, strict=True)))


def read_gnss_poses(path: Path, reporter: Reporter = SILENT) -> dict[int, GnssPose]:
    """Read ``GNSSPoses.txt``: timestamp_ns -> the fused pose of a keyframe.

    Columns: timestamp_ns tx ty tz qx qy qz qw scale [fusion_quality ...], those of the pose as a header names them.

    Raises:
        DatasetError: with file and line.
    """
    what = "GNSS poses (timestamp_ns tx ty tz qx qy qz qw scale ...)"
    _, found = read_pose_columns(path, what, more=True)
    rows, scales = [], {}
    for line, fields in found:
        if len(fields) < 9:
            raise DatasetError(
                f"expected 9 columns or more (... qw scale fusion_quality), found {len(fields)}", path, line
            )
        rows.append(Row(line, fields[1:8], fields[0]))
        scales[line] = fields[8]
    table = plausible(pose_table(rows, TQ, path, reporter), reporter)
    poses = zip(table.transforms, table.lines, strict=True)
    metric = [GnssPose(T_w_cam, _parse_scale(scales[line], path, line)) for T_w_cam, line in poses]
    return dict(zip(table.times_ns.tolist(), metric, strict=True))


def read_times(path: Path) -> list[int]:
    """The times in nanoseconds of ``times.txt``, whose lines are ``timestamp_ns seconds exposure_ms``.

    Raises:
        DatasetError: with file and line, also if the two times of a line differ by a microsecond or more.
    """
    rows = list(read_rows(path, "frame times (timestamp_ns seconds exposure_ms)", DatasetError))
    for line, fields in rows:
        parse_floats(fields[1:], path, line, "seconds exposure_ms", DatasetError)
    times, seconds = (
        times_in_ns([fields[column] for _, fields in rows], lambda i: (path, rows[i][0]), own_ns).ns
        for column, own_ns in ((0, 1), (1, 10**9))
    )
    for time, same, (line, fields) in zip(times, seconds, rows, strict=True):
        if abs(same - time) >= 1000:
            raise DatasetError(f"{fields[0]} ns and {fields[1]} s are not the same time", path, line)
    return times


def read_transformations(path: Path) -> Transformations:
    """Read ``Transformations.txt``: five transforms ``tx,ty,tz,qx,qy,qz,qw`` and the GNSS scale, each below its title.

    Raises:
        DatasetError: with file and line: a part is missing or out of order.
    """
    lines = lines_of(read_text(path, "the transformations of a recording", DatasetError))
    rows = list(read_rows(path, "the transformations of a recording", DatasetError))
    if len(rows) != len(_TRANSFORMATIONS):
        raise DatasetError(f"holds {len(rows)} parts, expected {', '.join(_TRANSFORMATIONS)} in this order", path)
    for name, (line, _) in zip(_TRANSFORMATIONS, rows, strict=True):
        titles = [text for text in lines[: line - 1] if text.strip().startswith("#")]
        if titles and name not in titles[-1]:
            raise DatasetError(f"expected {name} here, but its title is '{titles[-1].strip('# ')}'", path, line)
    _, _, w_gpsw, _, e_gpsw = (parse_pose(fields, path, line) for line, fields in rows[:5])
    line, fields = rows[5]
    if len(fields) != 1:
        raise DatasetError(f"expected the scale alone, found {len(fields)} numbers", path, line)
    return Transformations(e_gpsw @ invert(w_gpsw), _parse_scale(fields[0], path, line))


def _parse_scale(text: str, path: Path, line: int) -> float:
    scale = parse_floats([text], path, line, "scale", DatasetError)[0]
    if scale <= 0:
        raise DatasetError(f"scale is {text}, expected a positive number", path, line)
    return scale

"""The scale of a build's drives, from what their lidars see: rooms are enlarged to the size of a street, streets stay.

The size is that of what the lidar measures along a stretch of the drive, as a submap of a street holds it. How long a
stretch is follows from how far the lidar sees there, so that a long way through small rooms is not taken for a street.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.odometry.deferred import is_pending
from relocbench.datasets.groundtruth.registration.scene_scale import (
    SCALE_FILE,
    SceneScale,
    SceneSize,
    read_scale,
    scale_of,
    scene_size,
    write_scale,
)
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream
from relocbench.errors import DatasetError
from relocbench.geometry import apply, invert, path_lengths
from relocbench.progress import Reporter

_PLACES = (0.2, 0.5, 0.8)
"""where along a drive it is measured, as shares of the scans"""
_MOST_M = 60.0
"""longest stretch: a submap of a street"""
_STRETCH = {"push-broom": 5.0, "spinning": 2.0}
"""length of a stretch in multiples of the range within which most surfaces lie; the plane of a push-broom lidar shows
the width of a street, and only its motion the length"""
_FARTHEST_M = 60.0
"""farther points are left out, as blocks leave them out"""
_SCANS, _POINTS = 40, 200_000
"""largest numbers of scans and of points of a stretch"""
_FEW_SCANS = 5
"""scans that the range is measured on, at each place"""
_CELLS = 50
_WITHIN = 0.8
_WANTED_M = 10.0
"""radius of an enlarged scene, that of a narrow street: larger ones cost more and are found less often where a sensor
sees a part of the room at a time"""
_STREET_M = 5.5
"""a scene of at least this radius is left as it is"""
_NOISE_M = 0.05
"""largest noise of an enlarged scene; blocks take the mean of many points, so that it is more than a cloud may have"""
_SPACING_M = 0.75
"""largest spacing: that of the rings of a spinning lidar in a street; without odometry, single scans are measured"""


def scale_of_build(
    recordings: Sequence[FieldRecording], options: FieldOptions, folder: Path, reporter: Reporter
) -> SceneScale:
    """The scale of the drives; that of an earlier run is read from the folder of ground truth.

    Raises:
        DatasetError: the folder was made with another scale than is given.
    """
    if (folder / SCALE_FILE).exists():
        kept = read_scale(folder)
        if options.scale not in ("auto", kept.factor):
            message = f"was made with a scale of {kept.factor:g}, and {options.scale:g} is given; choose another folder"
            raise DatasetError(message, folder / SCALE_FILE)
        scale = SceneScale(kept.factor, kept.reason)
    else:
        scale = scale_of_drives(recordings, options.scale, reporter)
    reporter.note(f"scale: {scale.reason}")
    if scale.factor == 1.0:
        return scale
    most = options.max_sigma_at(scale.factor)
    write_scale(folder, scale, most)
    reporter.note(
        f"scale: lengths of the method are those of a street divided by {scale.factor:.3g}: a submap holds "
        f"{options.submap / scale.factor:.2g} m of the way, and a sigma of up to {1000 * most:.3g} mm is accepted "
        "(--max-sigma)"
    )
    return scale


def scale_of_drives(
    recordings: Sequence[FieldRecording], wanted: float | Literal["auto"], reporter: Reporter
) -> SceneScale:
    """The factor by which all drives of a build are enlarged.

    Drives are never reduced unless the factor is given by hand: the reaches of the build are those of roads.

    Args:
        wanted: a factor given by hand, or ``auto``.
    """
    if wanted != "auto":
        return SceneScale(float(wanted), f"enlarged {wanted:g} times, as given")
    with reporter.stage("size of the scene", len(recordings)) as advance:
        sizes = []
        for recording in recordings:
            sizes.append(_size(recording))
            advance(1)
    known = [size for size in sizes if size is not None]
    if not known:
        return SceneScale(1.0, "too few points to measure it: taken to be as large as a street")
    radius = min(size.radius_m for size in known)
    if radius >= _STREET_M:
        return SceneScale(1.0, f"a scene of {radius:.3g} m radius: as large as a street", radius)
    return scale_of(known, noise_m=_NOISE_M, spacing_m=_SPACING_M, wanted_m=_WANTED_M)


def _size(recording: FieldRecording) -> SceneSize | None:
    """The medians of the sizes along a drive; None if its scans have too few points."""
    sizes = []
    for place in _PLACES:
        points = _Stretch(recording, place).points()
        try:
            sizes.append(scene_size(points))
        except DatasetError:
            continue  # too few points here
    if not sizes:
        return None
    radius, spacing, noise = np.median([(s.radius_m, s.spacing_m, s.noise_m) for s in sizes], axis=0).tolist()
    return SceneSize(radius, spacing, noise)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A stretch of a drive around a place."""

    recording: FieldRecording
    place: float

    def points(self) -> Array:
        """(N, 3) points along the stretch, those of each scan as if the lidar stood still while it measured."""
        parts = []
        for lidar in self.recording.lidars:
            rows = self._known(lidar)
            if not len(rows):
                continue
            middle = rows[int(self.place * (len(rows) - 1))]
            if is_pending(self.recording):
                parts.append(self._some(lidar, int(middle), _POINTS))
                continue
            T_odom_lidar = self.recording.odometry.at(lidar.times_ns[rows]) @ lidar.T_rig_lidar
            length = min(_STRETCH[lidar.pattern] * self._range_m(lidar, rows), _MOST_M)
            T_middle_lidar = invert(T_odom_lidar[rows == middle][0]) @ T_odom_lidar
            inside = _around(T_odom_lidar[:, :3, 3], int(np.flatnonzero(rows == middle)[0]), length)
            for row in _evenly(inside, _SCANS):
                scan = self._some(lidar, int(rows[row]), _POINTS // _SCANS)
                parts.append(apply(lidar.T_rig_lidar @ T_middle_lidar[row], scan))
        return np.concatenate(parts) if parts else np.zeros((0, 3))

    def _known(self, lidar: LidarStream) -> Indices:
        """Scans whose pose is known; all of them where odometry is computed later."""
        if is_pending(self.recording):
            return np.arange(len(lidar.times_ns))
        return np.flatnonzero(self.recording.odometry.covers(lidar.times_ns))

    def _range_m(self, lidar: LidarStream, rows: Indices) -> float:
        """The range within which most of the surfaces around the place lie."""
        at = int(self.place * (len(rows) - 1))
        near = rows[max(at - _FEW_SCANS // 2, 0) : at + _FEW_SCANS // 2 + 1]
        points = np.concatenate([self._some(lidar, int(row), _POINTS // _SCANS) for row in near])
        if not len(points):
            return _MOST_M
        extent = float(np.max(np.ptp(points, axis=0)))
        even = points[first_in_voxels(points, extent / _CELLS)] if extent > 0 else points
        return float(np.quantile(np.linalg.norm(even, axis=1), _WITHIN))

    def _some(self, lidar: LidarStream, index: int, most: int) -> Array:
        """Points of a scan, evenly chosen."""
        points = lidar.read(index).points
        points = points[np.linalg.norm(points, axis=1) <= min(lidar.max_range_m, _FARTHEST_M)]
        return np.asarray(points[_evenly(np.arange(len(points)), most)])


def _around(positions: Array, middle: int, length_m: float) -> Indices:
    """Rows of positions (N, 3) within half a length, along the way, of one of them."""
    way = path_lengths(positions)
    return np.flatnonzero(np.abs(way - way[middle]) <= length_m / 2)


def _evenly(rows: Indices, most: int) -> Indices:
    return rows if len(rows) <= most else rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]

"""The GNSS receiver's track of a recording, with which its poses are compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.sensors.geodesy import R_enu_ecef, ecef_from_geodetic
from relocbench.errors import DatasetError
from relocbench.files import lines_of, read_bytes, seconds_to_ns
from relocbench.geometry import path_lengths

_DAY_NS = 86_400 * 1_000_000_000
_PATH_STEP_S = 2.0
"""time between the positions that measure a path's length; the noise of closer ones would add to it"""


@dataclass(frozen=True)
class GgaFix:
    """One GGA sentence."""

    time_of_day_ns: int
    """UTC"""
    latitude_deg: float
    longitude_deg: float
    height_m: float
    """above the WGS 84 ellipsoid"""


def read_gga(path: Path) -> list[GgaFix]:
    """The GGA sentences with a fix in an NMEA log; sentences with a wrong checksum are skipped.

    Raises:
        DatasetError: the log is missing or holds no fix, or a sentence with a correct checksum cannot be parsed.
    """
    data = read_bytes(path, "an NMEA log", DatasetError)
    fixes = []
    for number, line in enumerate(lines_of(data.decode("ascii", "replace").replace("\r", "\n")), start=1):
        try:
            fix = _parse_gga(line)
        except ValueError:
            raise DatasetError("a GGA sentence has a correct checksum but invalid fields", path, number) from None
        if fix is not None:
            fixes.append(fix)
    if not fixes:
        raise DatasetError("holds no GGA sentence with a fix", path)
    return fixes


def _parse_gga(line: str) -> GgaFix | None:
    body, star, checksum = line.strip().partition("*")
    if not (body.startswith("$") and star) or body[3:6] != "GGA":
        return None
    if f"{reduce(xor, body[1:].encode('ascii', 'replace'), 0):02X}" != checksum[:2].upper():
        return None
    _, clock, latitude, north, longitude, east, quality, _, _, altitude, _, geoid, *_ = body.split(",")
    if not (clock and latitude and longitude and altitude and geoid and quality) or not int(quality):
        return None
    seconds = seconds_to_ns(clock[4:])
    return GgaFix(
        time_of_day_ns=(int(clock[:2]) * 3600 + int(clock[2:4]) * 60) * 1_000_000_000 + seconds,
        latitude_deg=_degrees(latitude, 2) * (-1 if north == "S" else 1),
        longitude_deg=_degrees(longitude, 3) * (-1 if east == "W" else 1),
        height_m=float(altitude) + float(geoid),
    )


def _degrees(text: str, digits: int) -> float:
    """Degrees of ``ddmm.mmm`` or ``dddmm.mmm``, degrees and minutes."""
    return int(text[:digits]) + float(text[digits:]) / 60


@dataclass(frozen=True)
class TrackAgreement:
    """How a recording's poses agree with its receiver's track during the time that both cover."""

    path_ratio: float
    """path length of the poses over that of the track"""
    horizontal_m: float
    """median horizontal distance, including the receiver's lever arm"""
    vertical_m: float
    """median height of the poses above the track"""


def agreement(positions: Mapping[int, Array], fixes: list[GgaFix]) -> TrackAgreement | None:
    """Compare ECEF positions (timestamp_ns -> (3,)) with a receiver's track, interpolated to their times.

    Returns None if the two overlap for less than two seconds.
    """
    track_times = np.array([f.time_of_day_ns for f in fixes], dtype=np.int64)
    kept = np.concatenate([[True], np.diff(track_times) > 0])
    track = ecef_from_geodetic(np.array([(f.latitude_deg, f.longitude_deg, f.height_m) for f in fixes]))[kept]
    track_times = track_times[kept]
    times = np.array([t % _DAY_NS for t in positions], dtype=np.int64)
    inside = (times >= track_times[0]) & (times <= track_times[-1])
    if inside.sum() < 2 or np.ptp(times[inside]) < 2e9 * _PATH_STEP_S:
        return None
    poses = np.array(list(positions.values()))[inside]
    start = track_times[0]
    seconds, track_seconds = (times[inside] - start) * 1e-9, (track_times - start) * 1e-9
    receiver = _resample(seconds, track_seconds, track)
    steps = np.arange(seconds.min(), seconds.max(), _PATH_STEP_S)
    up = R_enu_ecef(fixes[0].latitude_deg, fixes[0].longitude_deg)[2]
    difference = poses - receiver
    height = difference @ up
    return TrackAgreement(
        path_ratio=float(path_lengths(_resample(steps, seconds, poses))[-1])
        / float(path_lengths(_resample(steps, track_seconds, track))[-1]),
        horizontal_m=float(np.median(np.linalg.norm(difference - height[:, None] * up, axis=1))),
        vertical_m=float(np.median(height)),
    )


def _resample(at: Array, times: Array, positions: Array) -> Array:
    return np.stack([np.interp(at, times, axis) for axis in positions.T], axis=1)

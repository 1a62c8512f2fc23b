"""Scans of the two Velodyne HDL-32E of the Oxford Radar RobotCar dataset.

Barnes et al., The Oxford Radar RobotCar Dataset, ICRA 2020, and the dataset's SDK (``python/velodyne.py``). The axes of
a scan are those of the vehicle, z down. Both lidars turn twenty times a second, clockwise seen from above.

- Raw scans are grey PNG of 106 rows, a column for each firing of all beams: 32 rows of intensities, 32 ranges in steps
  of 2 mm (16 bits, over 64 rows), the azimuth in hundredths of a degree (16 bits), and the time in microseconds since
  1970 (64 bits), little-endian downwards.
- Binary scans are float32, all x, then all y, z and intensities; beam by beam, in each in the order of firing. They are
  not motion-compensated and hold no times: these follow from the azimuths, the first firing having the name's time.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.images import decode_image
from relocbench.datasets.importers.robotcar.files import US
from relocbench.datasets.sensors.scan_files import Returns
from relocbench.datasets.sensors.times import time_in_name
from relocbench.errors import DatasetError

VELODYNES = ("velodyne_left", "velodyne_right")
MAX_RANGE_M = 100.0
SIGMA_M = 0.02
"""data sheet"""
NEAREST_M = 1.0
_ROWS = 106
_BEAMS = 32
_RANGE_STEP_M = 0.002
_TURN_NS = 50_000_000
_DOWN_RAD = np.array(
    [
        *(-0.1862, -0.1628, -0.1396, -0.1164, -0.0930, -0.0698, -0.0466, -0.0232, 0.0, 0.0232, 0.0466, 0.0698, 0.0930),
        *(0.1164, 0.1396, 0.1628, 0.1862, 0.2094, 0.2327, 0.2560, 0.2793, 0.3025, 0.3259, 0.3491, 0.3723, 0.3957),
        *(0.4189, 0.4421, 0.4655, 0.4887, 0.5119, 0.5353),
    ]
)
"""angle of each beam below the horizon, by the SDK"""
BASE_TO_FIRE_M = 0.090805
"""from the base of the lidar up to where its beams cross, by the SDK"""


def decode_raw(data: bytes, path: Path) -> Returns:
    """The points of a raw scan, each with the time of its firing."""
    image = decode_image(data, path)
    if image.dtype != np.uint8 or image.ndim != 2 or image.shape[0] != _ROWS:
        raise DatasetError(f"expected a raw Velodyne scan, a grey PNG of {_ROWS} rows", path)
    columns = np.ascontiguousarray(image.T)
    ranges = np.ascontiguousarray(columns[:, 32:96]).view("<u2") * _RANGE_STEP_M
    azimuth = np.ascontiguousarray(columns[:, 96:98]).view("<u2")[:, 0] * (2 * np.pi / 36000)
    times_us = np.ascontiguousarray(columns[:, 98:106]).view("<i8")[:, 0]
    scan_us = time_in_name(path, US) // US
    # Compared before they are multiplied, which could overflow.
    if np.any(np.abs(times_us.astype(np.float64) - scan_us) > 1e6):
        raise DatasetError("has firings more than a second away from the scan's time", path)
    offsets = np.repeat((times_us - scan_us) * 1000, _BEAMS)
    points = points_of(ranges, azimuth[:, None]).reshape(-1, 3)
    return Returns(np.where((ranges > NEAREST_M).reshape(-1, 1), points, np.nan), offsets)


def points_of(ranges: Array, azimuth: Array) -> Array:
    """(N, 32, 3) points of ranges (N, 32) in metres at azimuths (N, 1) in radians."""
    level = np.cos(_DOWN_RAD) * ranges
    down = np.sin(_DOWN_RAD) * ranges - BASE_TO_FIRE_M
    return np.stack([np.sin(azimuth) * level, -np.cos(azimuth) * level, down], axis=-1)


def decode_binary(data: bytes, path: Path) -> Returns:
    """The points of a binary scan, with times by their azimuths."""
    if len(data) % 16:
        raise DatasetError(
            f"{len(data)} bytes are not four columns of float32 (all x, all y, all z, all intensity)", path
        )
    points = np.frombuffer(data, dtype="<f4").reshape(4, -1)[:3].T.astype(np.float64)
    return Returns(points, _by_azimuth(points))


def _by_azimuth(points: Array) -> Times:
    """Offsets (N,) from the first firing of a turn.

    The turn begins at the earliest azimuth of the beams' first points.
    """
    if not len(points):
        return np.empty(0, dtype=np.int64)
    azimuth = np.nan_to_num(np.arctan2(points[:, 0], -points[:, 1]))
    down = np.nan_to_num(np.arctan2(points[:, 2] + BASE_TO_FIRE_M, np.hypot(points[:, 0], points[:, 1])))
    beam = np.searchsorted((_DOWN_RAD[1:] + _DOWN_RAD[:-1]) / 2, down)
    firsts = azimuth[np.concatenate([[True], np.diff(beam) != 0])]
    middle = np.angle(np.exp(1j * firsts).sum())
    around = np.mod(firsts - middle + np.pi, 2 * np.pi) - np.pi
    begin = middle + around[np.abs(around) < np.pi / 3].min(initial=0.0)
    out: Times = np.rint(np.mod(azimuth - begin + 1e-6, 2 * np.pi) / (2 * np.pi) * _TURN_NS).astype(np.int64)
    return out

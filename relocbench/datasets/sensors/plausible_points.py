"""Whether coordinates are what they seem: metres, within their integers, and finer than what they measure.

A cloud that is wrong in one of these ways can be read, and looks like a cloud.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.errors import DatasetError

_FEW = 0.01
"""share of saturated points that may be left out"""
_MOST_DEGREES = 180.0
_SHARE = 5.0
"""percent of the coordinates at either end that a span leaves out"""
_STEEP, _STEEP_FINE = 500.0, 20.0
"""a cloud this many times as high as it is wide has degrees for x and y; the second, if they are as fine as degrees"""
_STEP_M = 0.003
"""steps of single precision from this size on are reported"""
_FEWEST, _LOOKED_AT = 20, 100_000
"""points that are enough to judge, and about so many that are looked at"""
_FARTHEST_MEDIAN_M = 1000.0
"""no lidar has half of its points farther away than this"""


def without_saturated(integers: NDArray[Any], path: Path, notes: list[str]) -> NDArray[Any]:
    """Integer coordinates (N, 3) without the points that are at a limit of their type.

    Args:
        notes: the number of points that are left out is added.

    Raises:
        DatasetError: there are more than a few of them.
    """
    limits = np.iinfo(integers.dtype)
    lowest = limits.min if limits.min < 0 else -1  # 0 is no limit that a value runs into
    at_limit = (integers == limits.max) | (integers == lowest)
    bad = at_limit.any(axis=1)
    count = int(np.count_nonzero(bad))
    if not count:
        return integers
    axes = ", ".join(axis for axis, any_bad in zip("xyz", at_limit.any(axis=0), strict=True) if any_bad)
    said = f"{count} of {len(bad)} points have {axes} at the limit of {8 * integers.dtype.itemsize}-bit integers"
    if count > _FEW * len(bad):
        raise DatasetError(f"{said}: scale and offset cannot hold the coordinates, which are lost", path)
    notes.append(f"{said} and are left out")
    kept: NDArray[Any] = integers[~bad]
    return kept


def check_degrees(points: Array, path: Path, *, fine: bool = False) -> None:
    """Raise DatasetError if x and y of points (N, 3) are longitude and latitude by their ranges, and z is metres.

    Args:
        fine: whether x and y are stored so finely that they would be micrometres.
    """
    points = _some(points)
    if len(points) < _FEWEST or not np.all(np.abs(points[:, :2]) <= _MOST_DEGREES):
        return
    low, middle, high = np.percentile(points, [_SHARE, 50.0, 100.0 - _SHARE], axis=0)
    span = high - low
    wide = float(span[:2].max())
    if not 0 < wide < 2 or span[2] < (_STEEP_FINE if fine else _STEEP) * wide or np.abs(middle[:2]).max() < 2 * wide:
        return
    at = f"({middle[0]:.4f}, {middle[1]:.4f})"
    message = f"its x and y look like degrees: they span {wide:.2g} about {at}, z spans {span[2]:.3g}"
    raise DatasetError(f"{message}; expected metres: project it first, such as to UTM", path)


def note_of_steps(points: Array) -> str:
    """A note on coordinates (N, 3) that went through single precision while they were large; empty if they did not."""
    points = _some(points)
    if len(points) < _FEWEST:
        return ""
    said = []
    for axis, values in zip("xyz", points.T, strict=True):
        with np.errstate(over="ignore"):
            single = values.astype(np.float32)
        step = float(np.spacing(np.median(np.abs(single))))
        # Numbers that were rounded are held by single precision too, but are multiples of much more than its steps.
        if step >= _STEP_M and np.all(single == values) and np.any(values % (8 * step)):
            said.append(f"{axis} in steps of {_length(step)}")
    return f"coordinates went through single precision (float32), which holds {' and '.join(said)}" if said else ""


def check_distances(points: Array, path: Path) -> None:
    """Raise DatasetError if points (N, 3) of a scan are too far from the lidar to be metres in its own frame."""
    points = _some(points)
    points = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
    if not len(points):
        return
    with np.errstate(over="ignore"):
        middle = float(np.median(np.linalg.norm(points, axis=1)))
    if middle <= _FARTHEST_MEDIAN_M:
        return
    around = np.ptp(np.percentile(points, [_SHARE, 100.0 - _SHARE], axis=0), axis=0).max() > middle / 2
    what = "which are millimetres, as it seems" if around else "as coordinates of a map would be"
    message = f"half of its points are farther than {middle:.0f} from the lidar, {what}"
    raise DatasetError(f"{message}; expected metres in the lidar's own frame", path)


def _some(points: Array) -> Array:
    """Some of the points, from all parts of the cloud."""
    return points[:: max(len(points) // _LOOKED_AT, 1)]


def _length(metres: float) -> str:
    return f"{1000 * metres:.3g} mm" if metres < 0.01 else f"{100 * metres:.3g} cm"

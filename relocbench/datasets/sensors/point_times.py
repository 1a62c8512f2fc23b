"""When the points of a cloud were measured: which field says so, in which unit, and relative to what.

Drivers disagree: seconds, milliseconds, microseconds or nanoseconds, after the stamp of the scan or before it, since
1970, or since the sensor was switched on. The values themselves tell: the times of a scan span about the time from one
scan to the next in one unit only, since units are a factor of 1000 apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Times

FIELDS = ("t", "time", "timestamp", "offset_time", "time_stamp", "time_offset", "timeoffset", "t_offset", "stamp")
"""names of fields with times, of which a cloud's first is used"""
Unit = Literal["s", "ms", "us", "ns"]
UNITS: dict[str, float] = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
BASES = ("scan", "epoch", "first")
_SHORTEST, _LONGEST = 0.1, 1.5
"""a scan's times span this part of the time from scan to scan: a push-broom lidar rests between its sweeps, and a
field of view may be narrow"""
_NEAR_NS = 2_000_000_000
"""absolute times lie this near to the scan's stamp"""
_TURN = 2 * np.pi


@dataclass(frozen=True)
class PointTimes:
    """How the times of a cloud's points are found."""

    field: str = ""
    """name of the field; empty: there is none"""
    unit: str = "s"
    base: str = "scan"
    """``scan``: relative to the scan's stamp; ``epoch``: since 1970; ``first``: the scan's stamp is that of its first
    point, and only differences count"""
    turn_ns: int = 0
    """without a field: time of a turn, if times follow from the azimuth; 0: all points have the scan's time"""

    def __str__(self) -> str:
        if self.field:
            since = {"scan": "from the scan's stamp", "epoch": "since 1970", "first": "from the first point"}[self.base]
            return f"field '{self.field}', {self.unit} {since}"
        if self.turn_ns:
            return f"by azimuth, a turn in {self.turn_ns / 1e9:.3f} s"
        return "none: scans are taken as motion compensated"

    def at(self, values: NDArray[Any] | None, points: Array, stamp_ns: int, most_s: float = 2.0) -> Times:
        """Times (N,) of points (N, 3), by the values (N,) of the field if there is one.

        By azimuth, a lidar that faces forward at the scan's stamp turns clockwise seen from above, as KITTI's does.

        Raises:
            ValueError: a time is not finite or more than ``most_s`` away from the scan's.
        """
        if values is not None and len(values):
            return _as_ns(values, self, stamp_ns, most_s)
        times = np.full(len(points), stamp_ns, dtype=np.int64)
        if self.turn_ns:
            azimuth = np.arctan2(points[:, 1], points[:, 0])
            times -= np.rint(azimuth / _TURN * self.turn_ns).astype(np.int64)
        return times


def parse_point_times(text: str) -> PointTimes | None:
    """The setting of an option: ``auto`` (None), ``none``, or ``FIELD:UNIT:BASE``.

    Raises:
        ValueError: it is none of these.
    """
    if text == "auto":
        return None
    if text == "none":
        return PointTimes()
    words = text.split(":")
    if len(words) != 3 or not words[0] or words[1] not in UNITS or words[2] not in BASES:
        units, bases = "|".join(UNITS), "|".join(BASES)
        raise ValueError(f"'{text}' is neither auto, none nor FIELD:UNIT:BASE with {units} and {bases}")
    return PointTimes(words[0], words[1], words[2])


def detect(field: str, scans: Sequence[tuple[int, NDArray[Any]]], period_ns: float) -> PointTimes:
    """Unit and base of a field's times.

    Args:
        scans: stamp in nanoseconds and times (N,) of some scans.
        period_ns: time from scan to scan.

    Returns:
        No field, if all times of each scan are the same.

    Raises:
        ValueError: no unit and base fit, with what was found.
    """
    spans, starts, ends, stamps = [], [], [], []
    for stamp, values in scans:
        finite = np.asarray(values[np.isfinite(values)], dtype=np.float64)
        if len(finite) > 1:
            starts.append(finite.min())
            ends.append(finite.max())
            spans.append(finite.max() - finite.min())
            stamps.append(stamp)
    if not spans or max(spans) == 0.0:
        coarse = spans and scans[0][1].dtype == np.float32 and max(np.abs(ends)) > 1e6
        if coarse:
            raise ValueError(f"'{field}' holds absolute times as float32, which cannot tell the points of a scan apart")
        return PointTimes()
    span = float(np.median(spans))
    fitting = [unit for unit, ns in UNITS.items() if _SHORTEST * period_ns <= span * ns <= _LONGEST * period_ns]
    found = f"'{field}' spans {span:g} in scans {period_ns / 1e9:.3f} s apart"
    if len(fitting) != 1:
        raise ValueError(f"{found}, which fits no unit of s, ms, us and ns")
    ns = UNITS[fitting[0]]
    first, last, at = np.array(starts) * ns, np.array(ends) * ns, np.array(stamps, dtype=np.float64)
    if (np.abs(first - at) < _NEAR_NS).all() and (np.abs(last - at) < _NEAR_NS).all():
        return PointTimes(field, fitting[0], "epoch")
    if (np.abs(first) <= _LONGEST * period_ns).all() and (np.abs(last) <= _LONGEST * period_ns).all():
        return PointTimes(field, fitting[0], "scan")
    raise ValueError(
        f"{found}, in {fitting[0]}, but begins at {starts[0]:.9g}, neither near the stamp ({stamps[0]} ns) nor near 0"
    )


def _as_ns(values: NDArray[Any], how: PointTimes, stamp_ns: int, most_s: float) -> Times:
    factor = UNITS[how.unit]
    if not np.isfinite(values.astype(np.float64)).all():
        raise ValueError(f"'{how.field}' holds a time that is not finite")
    # Compared as floats first: far-off times could overflow 64-bit integers and wrap around to near ones.
    with np.errstate(over="ignore", invalid="ignore"):
        rough = values.astype(np.float64) * factor
        shift = {"scan": 0.0, "epoch": float(stamp_ns), "first": float(rough.min())}[how.base]
        near = np.abs(rough - shift) <= most_s * 1e9
    if not near.all():
        raise ValueError(f"'{how.field}' is more than {most_s:g} s away from the scan's time")
    if values.dtype.kind in "iu" and factor == 1.0:
        ns = values.astype(np.int64)
    elif how.base == "scan":
        ns = np.rint(rough).astype(np.int64)
    else:
        # Whole seconds are converted apart, so that float64 keeps all digits that the value has.
        whole = np.floor(values.astype(np.float64) * (factor / 1e9))
        rest = np.rint((values.astype(np.float64) - whole * (1e9 / factor)) * factor)
        ns = whole.astype(np.int64) * 10**9 + rest.astype(np.int64)
    if how.base == "epoch":
        return ns
    return np.asarray(stamp_ns + ns - (ns.min() if how.base == "first" else 0), dtype=np.int64)

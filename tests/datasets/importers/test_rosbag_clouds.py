"""Points of PointCloud2 and LaserScan messages in any layout, and the times of points in any unit."""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from refusals import ErrorData, refused

from relocbench.datasets.importers.rosbag.clouds import cloud_fields, laser_points
from relocbench.datasets.sensors.point_times import PointTimes, detect, parse_point_times

CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
STAMP = 1_700_000_000_123_456_789
PERIOD = 10**8


@st.composite
def clouds(draw: st.DrawFn) -> tuple[SimpleNamespace, dict[str, NDArray[Any]]]:
    """A cloud with fields of any type at any offset, padding and byte order, and the values in it."""
    order = draw(st.sampled_from("<>"))
    height, width = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    names = draw(st.lists(st.sampled_from(["x", "y", "z", "ring", "time", "intensity"]), unique=True, max_size=6))
    offset, fields, places = 0, [], {}
    for name in names:
        code = draw(st.sampled_from(sorted(CODES)))
        offset += draw(st.integers(0, 5))
        fields.append(
            SimpleNamespace(name=name, offset=offset, datatype=CODES[code], count=draw(st.sampled_from([0, 1])))
        )
        places[name] = (offset, np.dtype(order + code))
        offset += np.dtype(code).itemsize
    step = offset + draw(st.integers(1, 4))
    row = step * width + (draw(st.integers(0, 7)) if height > 1 else 0)
    data = np.array(draw(st.lists(st.integers(0, 255), min_size=row * height, max_size=row * height)), dtype=np.uint8)
    expected = {}
    for name, (at, dtype) in places.items():
        starts = [r * row + c * step + at for r in range(height) for c in range(width)]
        raw = b"".join(data[s : s + dtype.itemsize].tobytes() for s in starts)
        expected[name] = np.frombuffer(raw, dtype)
    message = SimpleNamespace(
        height=height, width=width, point_step=step, row_step=row, fields=fields, data=data, is_bigendian=order == ">"
    )
    return message, expected


@pytest.mark.thorough
@given(clouds())
def test_every_layout_gives_the_values_that_are_at_its_offsets(made: tuple[SimpleNamespace, dict[str, Any]]) -> None:
    message, expected = made
    found = cloud_fields(message)
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert found[name].tobytes() == values.astype(values.dtype.newbyteorder("=")).tobytes()
        assert found[name].dtype.isnative


NUMBERS = st.integers(-1, 2**32)
DAMAGE = st.fixed_dictionaries(
    {},
    optional={
        "height": st.integers(0, 2**32 - 1),
        "width": st.integers(0, 2**32 - 1),
        "point_step": st.integers(0, 2**32 - 1),
        "row_step": st.integers(0, 2**32 - 1),
        "data": st.binary(max_size=40).map(lambda raw: np.frombuffer(raw, np.uint8)),
    },
)


@given(clouds(), DAMAGE, st.integers(0, 2**32 - 1), st.integers(0, 255), st.integers(0, 2**32 - 1))
def test_a_message_that_contradicts_itself_is_told_and_never_read_beyond_its_end(
    made: tuple[SimpleNamespace, dict[str, Any]], damage: dict[str, Any], offset: int, datatype: int, count: int
) -> None:
    message, _ = made
    if message.fields:
        message.fields[0].offset, message.fields[0].datatype, message.fields[0].count = offset, datatype, count
    for name, value in damage.items():
        setattr(message, name, value)
    try:
        found = cloud_fields(message)
    except ValueError:
        return
    total = message.height * message.width
    assert all(len(values) == total for values in found.values())


def test_the_error_names_the_field_that_is_missing_and_those_that_are_there() -> None:
    fields = [SimpleNamespace(name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate("xyz")]
    message = SimpleNamespace(
        height=1, width=1, point_step=12, row_step=12, fields=fields, data=np.zeros(12, np.uint8), is_bigendian=False
    )
    with refused(ValueError, "", None, "time", "x, y, z"):
        cloud_fields(message, ("x", "y", "z", "time"))


def laser(**changes: Any) -> SimpleNamespace:
    ranges = np.array([2.0, 0.1, 3.0, np.inf, 31.0, np.nan, 1.0])
    values = {"angle_min": 0.0, "angle_increment": np.pi / 2, "time_increment": 1e-3, "scan_time": 0.02,
              "range_min": 0.5, "range_max": 30.0, "ranges": ranges}  # fmt: skip
    return SimpleNamespace(**(values | changes))


def test_beams_of_a_laser_scan_have_the_times_of_their_numbers_and_those_without_return_are_left_out() -> None:
    points, offsets = laser_points(laser())
    assert np.allclose(points, [[2, 0, 0], [-3, 0, 0], [-1, 0, 0]], atol=1e-12)
    assert offsets.tolist() == [0, 2_000_000, 6_000_000]


def test_without_a_time_between_beams_it_follows_from_the_time_of_a_turn() -> None:
    _, offsets = laser_points(laser(time_increment=0.0))
    assert offsets.tolist() == [0, 10_000_000, 30_000_000]


def test_a_laser_scan_with_impossible_numbers_is_refused() -> None:
    with refused(ValueError, "", None, "finite"):
        laser_points(laser(angle_increment=np.nan))
    with refused(ValueError, "", None, "700"):
        laser_points(laser(time_increment=100.0))


def scans(values: Any, dtype: str, epoch: float = 0.0) -> list[tuple[int, NDArray[Any]]]:
    """Five scans whose points have these times; ``epoch`` is the factor from nanoseconds of absolute times."""
    out = []
    for k in range(5):
        stamp = STAMP + k * PERIOD
        out.append((stamp, (np.asarray(values, dtype=np.float64) + stamp * epoch).astype(dtype)))
    return out


FRACTIONS = np.linspace(0.0, 0.0995, 50)


@pytest.mark.parametrize(
    ("what", "found", "expected"),
    [
        ("Ouster: nanoseconds after the stamp", scans(FRACTIONS * 1e9, "u4"), ("ns", "scan")),
        ("Velodyne: seconds after the stamp", scans(FRACTIONS, "f4"), ("s", "scan")),
        ("Velodyne: seconds before the stamp", scans(FRACTIONS - 0.0995, "f4"), ("s", "scan")),
        ("Hesai: seconds since 1970", scans(FRACTIONS, "f8", 1e-9), ("s", "epoch")),
        ("Livox: nanoseconds since 1970", scans(FRACTIONS * 1e9, "f8", 1.0), ("ns", "epoch")),
        ("microseconds after the stamp", scans(FRACTIONS * 1e6, "f4"), ("us", "scan")),
        ("milliseconds after the stamp", scans(FRACTIONS * 1e3, "f4"), ("ms", "scan")),
        ("a push-broom lidar that rests between its sweeps", scans(FRACTIONS * 0.3e9, "i4"), ("ns", "scan")),
    ],
)
def test_unit_and_base_of_times_are_told_from_their_values(
    what: str, found: list[tuple[int, NDArray[Any]]], expected: tuple[str, str]
) -> None:
    how = detect("t", found, PERIOD)
    assert (how.unit, how.base) == expected, what
    stamp, values = found[2]
    times = how.at(values, np.zeros((len(values), 3)), stamp) - stamp
    first = -99_500_000 if "before" in what else 0
    spread = 0.3 if "push-broom" in what else 1.0
    assert np.abs(times - (FRACTIONS * spread * 1e9 + first)).max() < 300, what


@pytest.mark.parametrize(
    ("values", "dtype", "epoch", "complaint"),
    [
        (FRACTIONS * 1e-3, "f4", 0.0, ()),
        (FRACTIONS + 1234.0, "f8", 0.0, ()),
        (FRACTIONS, "f4", 1e-9, ("", None, "float32")),
    ],
)
def test_times_that_make_no_sense_are_refused(values: Any, dtype: str, epoch: float, complaint: ErrorData) -> None:
    with refused(ValueError, *complaint):
        detect("t", scans(values, dtype, epoch), PERIOD)


@pytest.mark.thorough
@given(
    st.lists(arrays(st.sampled_from(["f4", "f8", "u4", "i4", "u8"]), st.integers(0, 6)), max_size=4),
    st.floats(1.0, 1e12),
    st.integers(0, 2**62),
)
def test_no_values_do_more_than_be_refused(found: list[NDArray[Any]], period: float, stamp: int) -> None:
    with contextlib.suppress(ValueError):
        how = detect("t", [(stamp, values) for values in found], period)
        for values in found:
            times = how.at(values if how.field else None, np.zeros((len(values), 3)), stamp)
            assert np.abs(times - stamp).max(initial=0) <= 2 * 10**9 + 1000


def test_equal_times_count_as_none() -> None:
    assert detect("t", scans(np.zeros(50), "f4"), PERIOD) == PointTimes()


def test_times_from_the_first_point_on_need_no_common_clock() -> None:
    how = PointTimes("t", "us", "first")
    times = how.at(np.array([5_000_100, 5_000_000, 5_099_000], np.uint64), np.zeros((3, 3)), STAMP)
    assert (times - STAMP).tolist() == [100_000, 0, 99_000_000]


def test_times_far_from_their_scan_are_refused_even_where_they_would_wrap_around() -> None:
    for value in (2**63, 2**64 - 1, 3 * 10**9):
        with refused(ValueError, "", None, "t"):
            PointTimes("t", "ns", "scan").at(np.array([value], np.uint64), np.zeros((1, 3)), STAMP)


def test_without_times_of_points_a_clockwise_turn_gives_them() -> None:
    points = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 1.0, 0]])
    times = PointTimes(turn_ns=PERIOD).at(None, points, STAMP)
    assert (times - STAMP).tolist() == [0, PERIOD // 4, -PERIOD // 4]


def test_settings_of_times_are_parsed() -> None:
    assert parse_point_times("auto") is None
    assert parse_point_times("none") == PointTimes()
    assert parse_point_times("ts:us:epoch") == PointTimes("ts", "us", "epoch")
    for wrong in ("", "t", "t:s", "t:hours:scan", ":s:scan", "t:s:now"):
        with refused(ValueError, "", None, "FIELD:UNIT:BASE"):
            parse_point_times(wrong)

"""Times as text mean the same at every door: whole numbers by their digits, seconds with a decimal point."""

from __future__ import annotations

from pathlib import Path

import pytest
from refusals import ErrorData, refused

from relocbench.datasets.sensors.times import times_in_ns, times_in_unit
from relocbench.datasets.sensors.trajectories import timed_files
from relocbench.errors import DatasetError

SECOND = 10**9


def read(texts: str, own_ns: int = 1, *, dates_only: bool = False) -> list[int]:
    """Nanoseconds of words that stand in the lines of a file."""
    return times_in_ns(texts.split(), lambda i: (Path("t.txt"), i + 1), own_ns, dates_only=dates_only).ns


@pytest.mark.parametrize(
    ("texts", "first", "step"),
    [
        ("1403636580 1403636581", 1403636580 * SECOND, SECOND),
        ("1403636580838 1403636580938", 1403636580838 * 10**6, SECOND // 10),
        ("1403636580838555 1403636580938555", 1403636580838555 * 1000, SECOND // 10),
        ("1403636580838555392 1403636580938555392", 1403636580838555392, SECOND // 10),
        ("1403636580.838555392 1403636580.938555392", 1403636580838555392, SECOND // 10),
        ("1403636580.9 1403636581", 1403636580 * SECOND + 9 * SECOND // 10, SECOND // 10),
        ("1.0e-01 .25", SECOND // 10, 3 * SECOND // 20),
        ("1000000000 1100000000 1200000000", SECOND, SECOND // 10),  # nanoseconds since the start of a recording
        ("900000000 1000000000 1100000000", 9 * SECOND // 10, SECOND // 10),
        ("1000000000000 1000033333333", 1000 * SECOND, 33333333),
        ("5 7", 5, 2),
        ("-5 7", -5, 12),
    ],
)
def test_the_unit_of_whole_numbers_follows_from_their_digits(texts: str, first: int, step: int) -> None:
    ns = read(texts)
    assert (ns[0], ns[1] - ns[0]) == (first, step)


@pytest.mark.parametrize("own_ns", [1, 1000, SECOND])
def test_a_format_gives_other_whole_numbers_its_own_unit_and_dates_that_of_their_digits(own_ns: int) -> None:
    assert read("0 1 2", own_ns) == [0, own_ns, 2 * own_ns]
    assert read("1403636580838555", own_ns) == [1403636580838555000]


@pytest.mark.parametrize(
    ("texts", "told"),
    [
        ("1403636580 1403636580838555", (2, 16, 10)),
        ("1403636580838555392 1403636580938", (2, 13, 19)),
        ("1.0 1000000000", (2, 1000000000)),
        ("1.0 first", (2, "first")),
        ("1.2.3", (1, "1.2.3")),
        ("nan", (1, "nan")),
        ("0x10", (1, "0x10")),
        ("1_000", (1, "1_000")),
        ("9223372036854775808", (1, 64)),
    ],
)
def test_what_is_no_time_or_in_another_unit_than_the_others_is_named_with_its_line(texts: str, told: ErrorData) -> None:
    line, *names = told
    with refused(DatasetError, "t.txt", line, *names):
        read(texts)


@pytest.mark.parametrize("text", ["17", "15018221459"])
def test_a_number_is_no_date(text: str) -> None:
    with refused(DatasetError, "t.txt", 1, text, 1970):
        read(text, dates_only=True)


def test_a_named_unit_is_obeyed_or_contradicted(tmp_path: Path) -> None:
    def in_unit(text: str, unit_ns: int) -> list[int]:
        return times_in_unit(text.split(), lambda i: (Path("t.txt"), i + 1), unit_ns)

    assert in_unit("1.403636580838555392e18", 1) == [1403636580838555392]
    assert in_unit("7 8", SECOND) == [7 * SECOND, 8 * SECOND]
    with refused(DatasetError, "t.txt", 1, "microseconds", "nanoseconds"):
        in_unit("1403636580838555 1403636580938555", 1)


def test_names_of_files_are_times_like_those_of_tables(tmp_path: Path) -> None:
    for text in ("1403636580838555", "1403636580938555"):
        (tmp_path / f"{text}.png").touch()
    images = timed_files(tmp_path)
    assert list(images) == [1403636580838555000, 1403636580938555000]
    (tmp_path / "-5.png").touch()
    with refused(DatasetError, "-5.png", None, 1970):
        timed_files(tmp_path)
    depth = tmp_path / "depth"
    depth.mkdir()
    (depth / "1000000000.png").touch()  # alone it would be a second of 2001
    assert list(timed_files(depth, like=[Path("1100000000.png"), Path("1200000000.png")])) == [SECOND]

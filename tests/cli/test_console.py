"""What the command line tells while it works."""

from __future__ import annotations

import re

import pytest

from relocbench.cli.console import Pace, in_lines, print_table


def done_at(workers: int, first_s: float, unit_s: float, total: int) -> list[float]:
    """When units are done by workers whose first one takes longer."""
    times = [first_s + unit_s * k for k in range(total) for _ in range(workers)]
    return sorted(times)[:total]


@pytest.mark.parametrize("workers", [1, 2, 8])
@pytest.mark.parametrize(("first_s", "unit_s"), [(0.5, 0.5), (20.0, 0.5), (60.0, 4.0)])
def test_ten_seconds_after_the_first_units_the_estimate_is_right_within_a_factor_of_two(
    workers: int, first_s: float, unit_s: float
) -> None:
    times = done_at(workers, first_s, unit_s, 400)
    pace = Pace(len(times))
    judged = 0
    for now in times[:-20]:
        pace.advance(1, now)
        if now >= first_s + 10.0:
            left = pace.left(now)
            assert left is not None
            assert 0.5 <= left / (times[-1] - now) <= 2.0
            judged += 1
    assert judged > 100


def test_a_pace_that_changes_is_followed() -> None:
    pace = Pace(1000)
    for k in range(100):
        pace.advance(1, 0.1 * k)
    for k in range(100):
        pace.advance(1, 10.0 + 1.0 * k)
    left = pace.left(109.0)
    assert left == pytest.approx(800.0, rel=0.1)


@pytest.mark.parametrize("unit_s", [30.0, 300.0])
def test_long_units_have_an_estimate_from_the_second_on(unit_s: float) -> None:
    pace = Pace(10)
    pace.advance(1, 400.0)
    for k in range(1, 9):
        now = 400.0 + unit_s * k
        pace.advance(1, now)
        assert pace.left(now) == pytest.approx(unit_s * (9 - k))


def test_a_stall_makes_no_estimate_vanish() -> None:
    pace = Pace(1000)
    for k in range(500):
        pace.advance(1, 0.1 * k)
    pace.advance(1, 200.0)
    left = pace.left(200.0)
    assert left is not None
    assert left > 100.0


def test_nothing_is_said_while_only_the_first_units_are_done() -> None:
    pace = Pace(10)
    assert pace.left(5.0) is None
    pace.advance(1, 20.0)
    assert pace.left(20.0) is None


@pytest.mark.parametrize(
    ("heading", "lines"),
    [
        ("rank", ["rank"]),
        ("coverage, %", ["coverage, %"]),
        ("median_translation_error_m", ["median_", "translation_", "error_m"]),
        ("recall@(0.25m,2deg), %", ["recall@", "(0.25m,", "2deg), %"]),
        ("median_seconds / p95_seconds", ["median_", "seconds /", "p95_seconds"]),
        ("aheadingwithoutanywords", ["aheadingwithoutanywords"]),
    ],
)
def test_a_heading_is_broken_between_its_words(heading: str, lines: list[str]) -> None:
    assert in_lines(heading).split("\n") == lines


def test_only_a_table_wider_than_its_terminal_has_broken_headings(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    for width, broken in ((100, False), (30, True)):
        monkeypatch.setenv("COLUMNS", str(width))
        print_table("", ["method", "median_translation_error_m"], [["dso", "0.5"]])
        assert ("translation_error" not in capsys.readouterr().out) == broken


def test_a_table_too_wide_for_its_terminal_wraps_texts_then_leaves_out_the_last_columns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    why = "a text of so many words that it does not fit into the half of a narrow terminal"
    numbers = [f"number {i}" for i in range(8)]
    print_table("", ["method", "why", *numbers], [["dso", why, *("0.12345678" for _ in numbers)]])
    table, left_out = capsys.readouterr().out.split("too wide")
    assert max(map(len, re.sub(r"\x1b\[[0-9;]*m", "", table).split("\n"))) <= 80
    assert all(word in table for word in why.split())
    assert table.count("0.12345678") + sum(number in left_out for number in numbers) == len(numbers)

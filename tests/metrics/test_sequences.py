"""Lost stretches and short runs along a drive."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relocbench.metrics import PairScores, PoseErrors, summarize, summarize_scores
from relocbench.metrics.pose.sequences import Drive, LostStretches, right_runs

SECOND = 10**9
AT = "@(0.25m,2deg)"
patterns = st.lists(st.booleans(), min_size=1, max_size=30)


def scores(right: str, *, seconds: list[float] | None = None, metres: list[float] | None = None) -> PairScores:
    """A pair for each letter, ``x`` where it is wrong, a second and two metres apart."""
    error = np.array([0.3 if letter == "x" else 0.0 for letter in right])
    times = np.arange(len(right)) if seconds is None else np.array(seconds)
    travelled = np.array([2.0 * i for i in range(len(right))] if metres is None else metres)
    return PairScores(
        PoseErrors(error, error, error), travelled_m=travelled, query_ns=1_700 * SECOND + (times * 1e9).astype(np.int64)
    )


def drive(right: list[bool]) -> Drive:
    count = len(right)
    return Drive(np.array(right, dtype=bool), np.arange(count, dtype=np.float64), np.arange(count, dtype=np.float64))


def test_stretches_by_hand() -> None:
    # Wrong: one query, three, and the last two, which no right one follows.
    summary = summarize_scores(scores("ox" + "oxxxo" + "ooxx"))
    assert summary[f"longest_lost_queries{AT}"] == 3
    assert summary[f"longest_lost_seconds{AT}"] == 3.0
    assert summary[f"longest_lost_metres{AT}"] == 6.0
    assert summary[f"lost_for_2{AT}"] == 5 / 11
    assert summary[f"lost_for_5{AT}"] == 0.0
    assert summary[f"lost_stretches_of_2{AT}"] == 2 / 3


def test_runs_by_hand() -> None:
    # Of three: oxo, xox, oxx, xxx, xxo, xoo; of five: oxoxx, xoxxx, oxxxo, xxxoo.
    summary = summarize_scores(scores("oxoxxxoo"))
    assert summary[f"run_recall_3{AT}"] == 2 / 6
    assert summary[f"run_recall_5{AT}"] == 0.0
    assert summarize_scores(scores("oxoxo"))[f"run_recall_5{AT}"] == 1.0
    assert summarize_scores(scores("ox"))[f"run_recall_3{AT}"] is None


def test_order_is_that_of_the_drive_and_a_query_of_several_keyframes_counts_once() -> None:
    # Queries at 0 to 3 s: the one at 1 s is right against one of two keyframes, that at 2 s against one of three.
    mixed = scores("oxoxxox", seconds=[3, 2, 1, 1, 2, 2, 0], metres=[9, 4, 1, 1, 4, 4, 0])
    assert mixed.drives is not None
    assert mixed.drives[0].right.tolist() == [False, True, False, True]
    assert mixed.drives[0].seconds.tolist() == [0, 1, 2, 3]
    assert summarize_scores(mixed)[f"longest_lost_metres{AT}"] == 5.0


def test_no_stretch_and_no_run_goes_from_one_set_into_the_next() -> None:
    both = summarize_scores(PairScores.joined([scores("ooxx"), scores("xxxo")]))
    assert both[f"longest_lost_queries{AT}"] == 3
    assert both[f"lost_for_2{AT}"] == 5 / 8
    assert both[f"run_recall_3{AT}"] == 1 / 4


def test_what_is_not_known_is_not_said() -> None:
    wrong = scores("oxo", metres=[0, np.nan, np.nan])
    assert summarize_scores(wrong)[f"longest_lost_metres{AT}"] is None
    assert summarize_scores(wrong)[f"longest_lost_seconds{AT}"] == 1.0
    without_times = summarize(wrong.errors)
    assert {without_times[f"{name}{AT}"] for name in ("longest_lost_queries", "lost_for_2", "run_recall_3")} == {None}


def test_a_method_that_is_never_lost() -> None:
    summary = summarize_scores(scores("oooo"))
    assert [summary[f"longest_lost_{what}{AT}"] for what in ("queries", "seconds", "metres")] == [0, 0, 0]
    assert summary[f"lost_for_2{AT}"] == 0
    assert summary[f"lost_stretches_of_2{AT}"] is None


@given(patterns, st.integers(0, 29))
def test_stretches_and_runs_get_no_worse_when_one_query_more_is_right(right: list[bool], which: int) -> None:
    better = list(right)
    better[which % len(right)] = True
    before, after = LostStretches.of([drive(right)]), LostStretches.of([drive(better)])
    assert np.max(after.queries, initial=0) <= np.max(before.queries, initial=0)
    assert np.max(after.seconds, initial=0) <= np.max(before.seconds, initial=0)
    for least in (1, 2, 5):
        assert after.queries_in(least) <= before.queries_in(least)
    assert before.queries_in(1) == right.count(False)
    for length in (1, 3, 5):
        runs, more = right_runs([drive(right)], length), right_runs([drive(better)], length)
        assert len(runs) == max(0, len(right) - length + 1)
        assert np.all(more >= runs)
    assert right_runs([drive(right)], 1).tolist() == right


@given(patterns)
def test_a_drive_backwards_has_the_same_stretches_and_runs(right: list[bool]) -> None:
    forth, back = [drive(right)], [drive(right[::-1])]
    assert sorted(LostStretches.of(forth).queries) == sorted(LostStretches.of(back).queries)
    assert right_runs(forth, 3).tolist() == right_runs(back, 3).tolist()[::-1]


@given(st.lists(st.floats(0, 3), min_size=3, max_size=20))
def test_a_run_of_odd_length_is_right_where_its_median_error_is(joint: list[float]) -> None:
    error = np.array(joint)
    medians = [np.median(error[i : i + 3]) <= 1 for i in range(len(error) - 2)]
    assert right_runs([drive((error <= 1).tolist())], 3).tolist() == medians


def test_times_of_another_number_are_refused() -> None:
    error = np.zeros(2)
    with pytest.raises(ValueError):  # noqa: PT011
        PairScores(PoseErrors(error, error, error), query_ns=np.arange(3))

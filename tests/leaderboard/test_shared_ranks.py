"""Ranks as all boards show them."""

from __future__ import annotations

from typing import Any

import pytest

from relocbench.leaderboard.common.model import NO_RANK, Row, rank_text, why_no_ranks
from relocbench.metrics import Interval

KNOWN = {"R@1": Interval(0.1, 0.3, 0.95)}


@pytest.mark.parametrize(
    ("ranks", "shown", "word"),
    [
        ([(1, {}), (1, {}), (None, {})], [NO_RANK, NO_RANK, ""], "24 queries"),
        ([(1, KNOWN), (1, {}), (None, {})], [NO_RANK, NO_RANK, ""], "24 queries"),
        ([(1, KNOWN), (1, KNOWN), (None, {})], [NO_RANK, NO_RANK, ""], "difference"),
        ([(1, KNOWN), (None, {})], [NO_RANK, ""], "one method"),
        ([(1, KNOWN), (2, KNOWN), (None, {})], ["1", "2", ""], None),
        ([(None, {}), (None, {})], ["", ""], None),
    ],
)
def test_a_dash_stands_for_a_shared_rank_with_the_reason(
    ranks: list[tuple[int | None, dict[str, Interval]]], shown: list[str], word: str | None
) -> None:
    rows = [Row[Any](None, {}, intervals, rank) for rank, intervals in ranks]
    assert [rank_text(row, rows) for row in rows] == shown
    why = why_no_ranks(rows, "R@1", "24 queries")
    assert bool(why) == (NO_RANK in shown)
    assert word is None or word in why

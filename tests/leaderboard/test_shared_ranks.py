"""Ranks as all boards show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import pytest

from relocbench.leaderboard.common.ranks import NO_RANK, rank_text, why_no_ranks
from relocbench.metrics import Interval


@dataclass
class Row:
    rank: int | None
    intervals: Mapping[str, Interval | None] = field(default_factory=dict)


KNOWN = {"R@1": Interval(0.1, 0.3, 0.95)}


@pytest.mark.parametrize(
    ("rows", "shown", "word"),
    [
        ([Row(1), Row(1), Row(None)], [NO_RANK, NO_RANK, ""], "24 queries"),
        ([Row(1, KNOWN), Row(1), Row(None)], [NO_RANK, NO_RANK, ""], "24 queries"),
        ([Row(1, KNOWN), Row(1, KNOWN), Row(None)], [NO_RANK, NO_RANK, ""], "difference"),
        ([Row(1, KNOWN), Row(None)], [NO_RANK, ""], "one method"),
        ([Row(1, KNOWN), Row(2, KNOWN), Row(None)], ["1", "2", ""], None),
        ([Row(None), Row(None)], ["", ""], None),
    ],
)
def test_a_dash_stands_for_a_shared_rank_with_the_reason(rows: list[Row], shown: list[str], word: str | None) -> None:
    assert [rank_text(row, rows) for row in rows] == shown
    why = why_no_ranks(rows, "R@1", "24 queries")
    assert bool(why) == (NO_RANK in shown)
    assert word is None or word in why

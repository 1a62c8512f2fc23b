"""Near-copies on boards: which they are, who represents them, and how they are shown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from board_pages import board_pages
from made_results import WINTER, Made, MadeResults, made, read_csv, row

from relocbench.evaluation.common.results import RunRecord
from relocbench.leaderboard import write_leaderboard
from relocbench.leaderboard.common.model import NEAR_COPIES
from relocbench.leaderboard.common.near_copies import nearly_same_settings

FIRST, LATER = "2024-01-01T00:00:00+00:00", "2024-01-02T00:00:00+00:00"


def run(target: str = "mine", **fields: Any) -> RunRecord:
    return RunRecord(method="a", target=target, dataset="town", fingerprint="0" * 64, **fields)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (run(parameters={"points": 2000, "seed": 1}), run(parameters={"points": 2100, "seed": 7}), True),
        (run(parameters={"points": 2000}), run(parameters={"points": 4000}), False),
        (run(parameters={"levels": [3, 3, 8]}), run(parameters={"levels": [3, 3]}), False),
        (run(parameters={"fast": True}), run(parameters={"fast": 1}), False),
        (run(parameters={"points": 2000}), run("other", parameters={"points": 2000}), False),
        (run(files={"weights": "a"}), run(files={"weights": "b"}), False),
        (run(versions={"method": "1"}), run(versions={"method": "2"}), False),
        (run("predictions:a"), run("predictions:a"), False),
    ],
)
def test_settings_are_nearly_the_same_where_numbers_are_apart_in_little(
    one: RunRecord, other: RunRecord, same: bool
) -> None:
    assert nearly_same_settings([one], [other]) == same


@pytest.fixture
def results(tmp_path: Path) -> MadeResults:
    """A good method, five copies of it without one pair each, and a bad one that fails on other pairs."""
    results = MadeResults(tmp_path / "results", {WINTER: 200})
    results.write_dataset()
    good = made(1, 200, 0.08)
    results.add("good", {WINTER: good}, start=LATER)
    for number in range(5):
        errors = np.array(good.translation_m)
        errors[17 * number] = np.inf
        copy = Made(errors, good.rotation_deg)
        results.add(
            f"a-copy-{number}", {WINTER: copy}, target=f"predictions:{number}", made_elsewhere=True, start=FIRST
        )
    results.add("bad", {WINTER: made(3, 200, 0.4)}, start=LATER)
    return results


def test_copies_count_once_and_what_was_run_here_represents_them(results: MadeResults, tmp_path: Path) -> None:
    board = results.board()
    copies = tuple(f"a-copy-{number}" for number in range(5))
    assert row(board, WINTER, "good").family == row(board, WINTER, "a-copy-3").family == ("good", *copies)
    assert row(board, WINTER, "bad").family == ()
    assert (row(board, WINTER, "good").rank, row(board, WINTER, "bad").rank) == (1, 2)
    write_leaderboard(results.root, tmp_path / "out")
    page, rows = board_pages(tmp_path / "out"), read_csv(tmp_path / "out" / "leaderboard.csv")
    assert f"{NEAR_COPIES} near-copies count as one method in the ranks of others: good, a-copy-0" in page
    assert f"| 1 {NEAR_COPIES} | good " in page
    assert {(r["method"], r["family"]) for r in rows} == {("good", "good"), ("bad", ""), *((c, "good") for c in copies)}

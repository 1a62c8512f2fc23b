"""Shares and marks by the condition of the query."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_leaderboard import Made, MadeResults

from relocbench.leaderboard.tracking.by_condition import ByCondition, by_condition

SNOW, NIGHT, OWN = "sun__snow__front", "sun__night__front", "sun__sun__front"
BAD = np.inf


def sorted_by_condition(root: Path) -> ByCondition:
    results = MadeResults(root, {NIGHT: 4, OWN: 3, SNOW: 4}, splits={"test": (SNOW, NIGHT, OWN)})
    results.write_dataset()
    good = Made([0.1, 0.1, 0.1], [0.1] * 3)
    results.add("close", {OWN: good, SNOW: Made([0.1, 0.3, BAD, 0.1], [0.1, 0.1, BAD, 3.0])})
    results.add(
        "far", {OWN: good, SNOW: Made([0.1] * 4, [0.1] * 4), NIGHT: Made([0.1, 0.1, BAD, BAD], [1, 3, BAD, BAD])}
    )
    results.add("identity", {OWN: good, SNOW: good_of(4), NIGHT: good_of(4)})
    return by_condition(results.board().datasets[0])


def good_of(count: int) -> Made:
    return Made([0.1] * count, [0.1] * count)


def test_the_maps_own_drive_is_first_and_floors_are_last(tmp_path: Path) -> None:
    found = sorted_by_condition(tmp_path)
    assert [c.pair_set for c in found.columns] == [OWN, SNOW, NIGHT]
    assert [c.one_drive for c in found.columns] == [True, False, False]
    assert [line.label for line in found.lines] == ["far", "close", "identity"]
    assert [line.floor for line in found.lines] == [False, False, True]


def test_an_answer_is_found_within_both_thresholds(tmp_path: Path) -> None:
    far, close, _ = sorted_by_condition(tmp_path).lines
    assert close.found[1].right.tolist() == [True, False, False, False]
    assert close.found[1].share == pytest.approx(0.25)
    assert far.found[2].right.tolist() == [True, False, False, False]
    assert far.found[2].share == pytest.approx(0.25)


def test_a_missing_result_has_neither_share_nor_marks(tmp_path: Path) -> None:
    close = sorted_by_condition(tmp_path).lines[1]
    assert close.found[2].share is None
    assert len(close.found[2].right) == 0


def test_pair_sets_of_several_maps_are_refused(tmp_path: Path) -> None:
    results = MadeResults(tmp_path, {SNOW: 2, "rain__snow__front": 2})
    results.write_dataset()
    results.add("close", {SNOW: good_of(2), "rain__snow__front": good_of(2)})
    with pytest.raises(ValueError, match="all of one map"):
        by_condition(results.board().datasets[0])

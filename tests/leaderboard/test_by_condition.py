"""The matrix of methods and conditions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_results import Made, MadeResults

from relocbench.evaluation.tables.errors import ErrorTable
from relocbench.leaderboard.common.model import NO_RANK
from relocbench.leaderboard.tracking.by_condition import ByCondition, by_condition
from relocbench.leaderboard.tracking.reservations import FinerThresholds, finer_thresholds

SNOW, NIGHT, OWN = "sun__snow__front", "sun__night__front", "sun__sun__front"
BAD = np.inf


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> ByCondition:
    results = MadeResults(
        tmp_path_factory.mktemp("results"), {NIGHT: 4, OWN: 3, SNOW: 4}, splits={"test": (SNOW, NIGHT, OWN)}
    )
    results.write_dataset()
    good = Made([0.1, 0.1, 0.1], [0.1] * 3)
    results.add("close", {OWN: good, SNOW: Made([0.1, 0.3, BAD, 0.1], [0.1, 0.1, BAD, 3.0])})
    results.add(
        "far", {OWN: good, SNOW: Made([0.1] * 4, [0.1] * 4), NIGHT: Made([0.1, 0.1, BAD, BAD], [1, 3, BAD, BAD])}
    )
    results.add("identity", {OWN: good, SNOW: good_of(4), NIGHT: good_of(4)})
    results.add("timed", {OWN: good, SNOW: good_of(4), NIGHT: good_of(4)}, uses_times=True)
    return by_condition(results.board().datasets)


def good_of(count: int) -> Made:
    return Made([0.1] * count, [0.1] * count)


def test_the_maps_own_drive_is_first_and_trivial_baselines_are_last(found: ByCondition) -> None:
    assert [column.pair_sets for column in found.columns] == [(OWN,), (SNOW,), (NIGHT,)]
    assert [column.same_drive for column in found.columns] == [True, False, False]
    assert [(line.label, line.baseline) for line in found.lines] == [
        ("far", False),
        ("close", False),
        ("timed", False),
        ("identity", True),
    ]


def test_an_answer_is_found_within_both_thresholds(found: ByCondition) -> None:
    far, close, *_ = found.lines
    assert close.found[1].right.tolist() == [True, False, False, False]
    assert close.found[1].share == pytest.approx(0.25)
    assert far.found[2].right.tolist() == [True, False, False, False]
    assert far.share == pytest.approx((1 + 0.25) / 2)


def test_a_missing_result_has_neither_share_nor_marks(found: ByCondition) -> None:
    close = found.lines[1]
    assert close.share is None
    assert close.found[2].share is None
    assert len(close.found[2].right) == 0


def test_a_dash_is_a_rank_that_all_share_and_who_is_not_ranked_has_none(found: ByCondition) -> None:
    """Of the ranked method alone; one misses a pair set, one uses times, and one is a trivial baseline."""
    assert [line.rank for line in found.lines] == [NO_RANK, "", "", ""]


def test_pair_sets_of_one_condition_share_a_column_and_count_the_same(tmp_path: Path) -> None:
    results = MadeResults(tmp_path, {SNOW: 2, "sun__snow__rear": 4})
    results.write_dataset()
    results.add("close", {SNOW: good_of(2), "sun__snow__rear": Made([0.1, BAD, BAD, BAD], [0.1, BAD, BAD, BAD])})
    found = by_condition(results.board().datasets)
    assert [(column.pair_sets, column.pairs) for column in found.columns] == [((SNOW, "sun__snow__rear"), 6)]
    assert found.lines[0].share == pytest.approx((1 + 0.25) / 2)


@pytest.mark.parametrize("first", ["new", "old"])
def test_errors_of_an_earlier_version_have_no_share_of_a_tier(first: str, tmp_path: Path) -> None:
    results = MadeResults(tmp_path, {SNOW: 3})
    results.write_dataset()
    results.add("a", {SNOW: good_of(3)})
    results.add("b", {SNOW: good_of(3)})
    board = results.board().datasets[0]
    overlaps = [0.9, 0.9, 0.3]
    methods = []
    for method, is_new in zip(board.entry.methods, (first == "new", first == "old"), strict=True):
        known: dict[str, Any] = [{"overlap_query": 0.9, "depth_error": 0.0, "scale_change": 1.0}, {}][not is_new]
        rows = [
            replace(row, overlap=share, angle_deg=1.0, **known)
            for row, share in zip(method.errors[SNOW], overlaps, strict=True)
        ]
        methods.append(replace(method, errors={SNOW: ErrorTable.of(rows)}))
    found = by_condition([replace(board, entry=replace(board.entry, methods=tuple(methods)))])
    shares = {line.label: [own.share for own in line.found] for line in found.lines}
    if first == "new":
        assert [(column.tier, column.pairs) for column in found.columns] == [("", 3), ("easy", 2), ("medium", 1)]
        assert shares == {"a": [1.0, 1.0, 1.0], "b": [1.0, None, None]}
        assert [column.tier for column in found.usual.columns] == [""]
    else:
        assert [column.tier for column in found.columns] == [""]


@pytest.mark.parametrize(
    ("distances", "expected"),
    [
        ([0.2, 0.3, 0.4], None),
        ([0.2, 0.2, 0.4], FinerThresholds(0.1, 1.0, 2 / 3, 0.0)),
        ([0.06, 0.06, 0.2], FinerThresholds(0.05, 0.5, 1.0, 0.0)),
        ([0.01, 0.01, 0.01], FinerThresholds(0.025, 0.25, 1.0, 1.0)),
        ([0.01, 0.01, None], None),
    ],
)
def test_the_finer_default_is_the_first_that_standing_still_does_not_solve(
    distances: list[float | None], expected: FinerThresholds | None, tmp_path: Path
) -> None:
    results = MadeResults(tmp_path, {SNOW: 3})
    results.write_dataset()
    results.add("close", {SNOW: good_of(3)})
    entry = results.board().datasets[0].entry
    (method,) = entry.methods
    rows = [
        replace(row, distance_m=far, angle_deg=0.0) for row, far in zip(method.errors[SNOW], distances, strict=True)
    ]
    apart = replace(method, errors={SNOW: ErrorTable.of(rows)})
    finer = finer_thresholds(replace(entry, methods=(apart,)))
    assert finer == expected
    assert finer is None or finer.fits == (finer.metres > 0.025)

"""The table of errors: what earlier versions wrote is read, and what it lacks is missing rather than zero."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from answered_dataset import add_answers
from forgery import change_yaml, reseal
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.checks.faults import Findings
from relocbench.errors import PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.results import dataset_results, write_dataset_record
from relocbench.evaluation.tables.errors import ERRORS, PairErrors, read_errors, write_errors
from relocbench.files import write_text
from relocbench.leaderboard import load_results, make_board

LATER = ("vcre", "metres", "overlap", "scale", "recall_easy", "recall_medium", "recall_hard", "recall_extreme", "look")
"""in the names of metrics that later columns give"""
FIRST_COLUMNS = 13
"""of the first version of the table"""


def shorten(path: Path) -> None:
    """Make a table of errors one of the first version."""
    lines = [line.split(",")[:FIRST_COLUMNS] for line in path.read_text(encoding="utf-8").splitlines()]
    write_text(path, "".join(",".join(line) + "\n" for line in lines))


def test_a_table_of_an_earlier_version_lacks_what_came_later(tmp_path: Path) -> None:
    path = tmp_path / "x.errors.csv"
    rows = [PairErrors(i, i, "", "ok", 0.1, 0.1, 0.1, None, 2.0, None, 1.5, 0.02, None) for i in range(3)]
    write_errors(path, [replace(row, vcre=0.1) for row in rows])
    shorten(path)
    assert list(read_errors(path)) == rows
    findings = Findings()
    ERRORS.check(path, findings)
    assert findings.faults == []
    write_text(path, path.read_text(encoding="utf-8").replace("sigma_rotation_deg", "sigma"))
    with pytest.raises(PredictionError) as refused:
        read_errors(path)
    ERRORS.check(path, findings)
    assert [refused.value.line, *(fault.line for fault in findings.faults)] == [1, 1]


def test_results_of_an_earlier_version_get_what_they_lack_from_the_dataset_where_it_is_at_hand(tmp_path: Path) -> None:
    results = tmp_path / "away" / "results"
    dataset = make_small_dataset(tmp_path / "dataset")
    add_answers(results, dataset, "near", "test", lambda pair: np.eye(4))
    folder = dataset_results(results, dataset).method("near")
    rows = read_errors(folder.errors(ACROSS))
    expected = rows.column("vcre")
    assert np.all((expected > 0) & (expected < 1))
    # The set keeps no correspondences: what queries see is known all the same.
    assert np.all(rows.column("overlap") > 0.5)
    assert np.all((rows.column("scale_change") > 1) & (rows.column("scale_change") < 1.3))
    write_dataset_record(dataset_results(results, dataset), dataset)
    for name in dataset.pair_set_names:
        shorten(folder.errors(name))
    change_yaml(folder.scores_yaml, _forget_what_came_later)
    reseal(folder)
    medians = []
    for lookup in (DatasetLookup(results), DatasetLookup(results, [dataset.root])):
        board = make_board(load_results(results, datasets=lookup))
        tables = {table.pair_set: table for table in board.datasets[0].tables}
        medians.append(tables[ACROSS].rows[0].values["median_vcre"])
    assert medians == [None, pytest.approx(np.median(expected))]


def _forget_what_came_later(scores: dict[str, Any]) -> None:
    for groups in scores["pair_sets"].values():
        for name in [name for name in groups["all"] if any(word in name for word in LATER)]:
            for values in groups.values():
                del values[name]

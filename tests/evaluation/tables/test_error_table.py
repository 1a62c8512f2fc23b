"""The table of errors: what is known of pairs stands in it, and a table that lacks a column is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from answered_dataset import add_answers
from refusals import refused
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.checks.faults import Findings
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import dataset_results
from relocbench.evaluation.tables.errors import ERRORS, read_errors


def test_errors_say_how_hard_pairs_are_though_the_set_keeps_no_correspondences(tmp_path: Path) -> None:
    dataset = make_small_dataset(tmp_path / "dataset")
    add_answers(tmp_path / "results", dataset, "near", "test", lambda pair: np.eye(4))
    rows = read_errors(dataset_results(tmp_path / "results", dataset).method("near").errors(ACROSS))
    assert np.all((rows.column("vcre") > 0) & (rows.column("vcre") < 1))
    assert np.all(rows.column("overlap") > 0.5)
    assert np.all((rows.column("scale_change") > 1) & (rows.column("scale_change") < 1.3))


def test_a_table_that_lacks_a_column_is_refused(tmp_path: Path) -> None:
    path, findings = tmp_path / "x.errors.csv", Findings()
    path.write_text(",".join(ERRORS.columns[:-1]) + "\n")
    with refused(PredictionError, "x.errors.csv", 1, "similarity"):
        read_errors(path)
    ERRORS.check(path, findings)
    assert [fault.line for fault in findings.faults] == [1]

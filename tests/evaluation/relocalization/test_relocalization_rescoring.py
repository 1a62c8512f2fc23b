"""Rows of pipelines follow from rankings, trackers' answers and truth, or are refused where the truth is at hand."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_line import relocbench
from forgery import change_yaml
from pipelines_for_tests import lists
from refusals import refused
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.relocalization.answers import PIPELINE, PipelineAnswer
from relocbench.evaluation.relocalization.evaluate import RelocalizationOptions, evaluate_pipelines
from relocbench.evaluation.relocalization.records import PipelineResults
from relocbench.files import sha256_file
from relocbench.leaderboard import displays
from relocbench.leaderboard.common.by_query import load_board
from relocbench.leaderboard.relocalization.board import RELOCALIZATION
from relocbench.progress import Silent

FRAMES = 8
CHAIN = "near+knows.top2"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results and, not beside them, the dataset."""
    root = tmp_path_factory.mktemp("made")
    dataset = make_small_dataset(root / "elsewhere" / "small", frames=FRAMES, size=(32, 24))
    near = lists(dataset, root / "near", [[q, (q + 5) % FRAMES] for q in range(FRAMES)])
    asked = RelocalizationOptions(
        dataset=dataset.root,
        out=root / "results",
        retriever=("oracle", f"near=predictions:{near}"),
        methods=("knows=pipelines_for_tests:Knows",),
        set=("knows.beyond=fail",),
        top=2,
        workers=0,
    )
    evaluate_pipelines(asked, Silent())
    return root


@pytest.fixture
def results(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made / "results", tmp_path / "results")
    return tmp_path / "results"


@pytest.fixture
def dataset(made: Path) -> Path:
    return made / "elsewhere" / "small"


def pipeline(results: Path) -> PipelineResults:
    return PipelineResults(next(results.glob(f"*@*/{CHAIN}")))


def forge(results: Path, change: Callable[[PipelineAnswer], PipelineAnswer]) -> Path:
    """Change the rows of a pipeline, and make the digest fit again."""
    folder = pipeline(results)
    path = folder.answers(ACROSS)
    PIPELINE.write(path, [change(row) for row in PIPELINE.read(path)])
    change_yaml(folder.scores_yaml, lambda scores: scores["answers"].update({ACROSS: sha256_file(path)}))
    return path


def rows_of(results: Path, out: Path, *datasets: Path) -> dict[tuple[str, str], dict[str, str]]:
    board = load_board(RELOCALIZATION, results, datasets=DatasetLookup(results, datasets))
    assert board is not None
    displays.RELOCALIZATION.write_table(board, out)
    displays.RELOCALIZATION.write_page(board, out)
    with (out / "relocalization.csv").open(newline="", encoding="utf-8") as stream:
        return {(r["retriever"], r["tracker"]): r for r in csv.DictReader(stream) if r["table"] == ACROSS}


def test_honest_pipelines_are_rescored_and_say_so(results: Path, dataset: Path, tmp_path: Path) -> None:
    claimed, found = rows_of(results, tmp_path / "a"), rows_of(results, tmp_path / "b", dataset)
    assert {row["rescored"] for row in claimed.values()} == {"no"}
    assert {row["rescored"] for row in found.values()} == {"yes"}
    assert [{**row, "rescored": ""} for row in claimed.values()] == [{**row, "rescored": ""} for row in found.values()]
    page = (tmp_path / "b" / "relocalization.md").read_text()
    assert "| near | knows (uses times) ¹ ² | 2 |" in page
    assert "relocbench leaderboard RESULTS --out DIR --dataset DATASET" in page


@pytest.mark.parametrize(
    "change",
    [
        {"translation_error_m": 0.001},
        {"outcome": "choice"},
        {"hit_rank": 2},
        {"confidence": 9.0},
        {"status": "failed", "translation_error_m": math.inf},
    ],
)
def test_forged_rows_are_exposed_by_the_truth(results: Path, dataset: Path, change: dict[str, Any]) -> None:
    path = forge(results, lambda row: replace(row, **change))
    assert load_board(RELOCALIZATION, results) is not None, "nothing without the truth tells it"
    with refused(PredictionError, path, None, "rankings"):
        load_board(RELOCALIZATION, results, datasets=DatasetLookup(results, [dataset]))


def test_rows_without_their_digest_are_refused_without_the_truth(results: Path) -> None:
    path = pipeline(results).answers(ACROSS)
    path.write_text(path.read_text().replace("right", "choice", 1))
    with refused(PredictionError, path, None, "changed", "scored"):
        load_board(RELOCALIZATION, results)


def test_an_edited_record_of_a_run_is_refused_without_the_truth(results: Path) -> None:
    path = pipeline(results).run_yaml
    change_yaml(path, lambda run: run["tracker_run"].update(uses_times=False, isolated=True))
    with refused(PredictionError, path, None, "record"):
        load_board(RELOCALIZATION, results)


def test_a_forged_basin_or_task_is_exposed_by_the_truth(results: Path, dataset: Path) -> None:
    def wide(scores: dict[str, Any]) -> None:
        scores["basins"][ACROSS]["metres"] = 99.0

    change_yaml(pipeline(results).scores_yaml, wide)
    with refused(PredictionError, f"{ACROSS}.csv", None, "basin", ACROSS):
        load_board(RELOCALIZATION, results, datasets=DatasetLookup(results, [dataset]))
    path = next(results.glob("*@*/relocalization.yaml"))
    change_yaml(path, lambda record: record["tasks"][ACROSS].update(rejected=7))
    with refused(PredictionError, path, None, "task", ACROSS):
        load_board(RELOCALIZATION, results, datasets=DatasetLookup(results, [dataset]))


def test_without_the_rankings_a_pipeline_is_not_rescored(results: Path, dataset: Path, tmp_path: Path) -> None:
    for folder in [path.parent for path in results.glob("*@*/retrieval.yaml")]:
        shutil.rmtree(folder)
    rows = rows_of(results, tmp_path / "board", dataset)
    assert {retriever: row["rescored"] for (retriever, _), row in rows.items()} == {"near": "no", "oracle": "yes"}


def test_a_dataset_that_no_pipeline_is_of_is_a_users_mistake(results: Path, tmp_path: Path) -> None:
    other: Dataset = make_small_dataset(tmp_path / "far" / "other", frames=3, name="other", size=(32, 24))
    told = relocbench("leaderboard", results, "--out", tmp_path / "board", "--dataset", other.root)
    assert (told.status, "of which the results hold nothing" in told.complaint) == (2, True)

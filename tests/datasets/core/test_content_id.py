"""The question of a dataset is told apart from its bytes."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from board_pages import board_pages
from refusals import refused
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core import fingerprint, images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.schema import DatasetFile
from relocbench.datasets.cross_view import content
from relocbench.errors import PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.folders import sets_in
from relocbench.evaluation.common.results import dataset_results
from relocbench.evaluation.common.runs import Asking
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.evaluation.retrieval.records import SetResults
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.evaluation.tracking.external import import_predictions
from relocbench.evaluation.tracking.run import run_method
from relocbench.execution import Run
from relocbench.files import dump_yaml, load_yaml_values, write_text
from relocbench.leaderboard import displays
from relocbench.leaderboard.common.by_query import load_board
from relocbench.leaderboard.retrieval.board import RETRIEVAL
from relocbench.leaderboard.retrieval.page import retrieval_page
from relocbench.leaderboard.tracking.load import load_results
from relocbench.leaderboard.tracking.write import write_leaderboard
from relocbench.methods import parse_method
from relocbench.progress import Silent


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("question") / "here", pairs=3)


def changed(original: Dataset, root: Path, change: Callable[[Dataset], None]) -> Dataset:
    """A copy that differs by ``change``, described anew as if it had been built so."""
    shutil.copytree(original.root, root)
    change(Dataset(root))
    layout = original.layout.__class__(root)
    fingerprint.write_manifest(layout)
    values, _ = load_yaml_values(layout.dataset_yaml, "a dataset description")
    file = DatasetFile.model_validate(values)
    values["fingerprint"] = fingerprint.compute(layout, file.format_version, file.splits)
    write_text(layout.dataset_yaml, dump_yaml(values))
    return Dataset(root)


def nudge_numbers(path: Path, by: float) -> None:
    """Every decimal number of a file is off by so much."""
    write_text(path, re.sub(r"-?\d+\.\d+(e-?\d+)?", lambda m: repr(float(m[0]) + by), path.read_text()))


def last_digits(dataset: Dataset) -> None:
    """What another processor does."""
    for path in (*dataset.layout.pairs.glob("*.txt"), *dataset.layout.traversals.glob("*/poses.csv")):
        nudge_numbers(path, 1e-13)
    for path in dataset.layout.traversals.glob("*/images/*/*.png"):
        image = images.read_image(path)
        images.write_image(path, np.where(image < 255, image + 1, image).astype(np.uint8))


def less_pairs(dataset: Dataset) -> None:
    for suffix in ("txt", "csv"):
        path = dataset.layout.pairs / f"{ACROSS}.{suffix}"
        lines = path.read_text().splitlines(keepends=True)
        write_text(path, "".join(lines[:-1]))


def other_weather(dataset: Dataset) -> None:
    path = dataset.layout.traversal("winter").traversal_yaml
    values, _ = load_yaml_values(path, "a traversal description")
    write_text(path, dump_yaml({**values, "condition": {"weather": "hail"}}))


def other_recipe(dataset: Dataset) -> None:
    values, _ = load_yaml_values(dataset.layout.dataset_yaml, "a dataset description")
    write_text(dataset.layout.dataset_yaml, dump_yaml({**values, "made_by": {"renderer": 99}}))


def elsewhere(dataset: Dataset) -> None:
    """Other folders, versions, name and licence."""
    values, _ = load_yaml_values(dataset.layout.dataset_yaml, "a dataset description")
    made = {**values["made_by"], "sources": ["/somewhere/else"], "versions": {"numpy": "1.0"}}
    write_text(dataset.layout.dataset_yaml, dump_yaml({**values, "made_by": made, "name": "other", "licence": "none"}))


def test_last_digits_and_grey_levels_change_the_fingerprint_and_not_the_question(
    original: Dataset, tmp_path: Path
) -> None:
    other = changed(original, tmp_path / "there", last_digits)
    assert other.fingerprint != original.fingerprint
    assert other.content_id == original.content_id


def test_where_and_under_which_name_a_dataset_was_made_is_no_part_of_the_question(
    original: Dataset, tmp_path: Path
) -> None:
    assert changed(original, tmp_path / "there", elsewhere).content_id == original.content_id


@pytest.mark.parametrize(
    "change",
    [
        lambda d: nudge_numbers(d.layout.pair_file(ACROSS), 1e-4),
        lambda d: nudge_numbers(d.layout.traversal("winter").poses, 1e-4),
        less_pairs,
        other_weather,
        other_recipe,
        lambda d: next(iter(d.layout.traversals.glob("winter/images/*/*.png"))).unlink(),
    ],
    ids=["truth by 0.1 mm", "poses by 0.1 mm", "a pair less", "another weather", "another recipe", "an image less"],
)
def test_what_is_asked_changes_the_question(
    original: Dataset, tmp_path: Path, change: Callable[[Dataset], None]
) -> None:
    assert changed(original, tmp_path / "there", change).content_id != original.content_id


def test_a_quaternion_and_its_negative_are_one_rotation(original: Dataset, tmp_path: Path) -> None:
    def turn_signs(dataset: Dataset) -> None:
        path = dataset.layout.traversal("winter").poses
        rows = [line.split(",") for line in path.read_text().splitlines()]
        turned = [[*r[:4], *(repr(-float(v)) for v in r[4:])] for r in rows[1:]]
        write_text(path, "".join(",".join(r) + "\n" for r in [rows[0], *turned]))

    assert changed(original, tmp_path / "there", turn_signs).content_id == original.content_id


def test_predictions_of_another_copy_of_the_question_are_scored_and_say_so(original: Dataset, tmp_path: Path) -> None:
    other = changed(original, tmp_path / "there", last_digits)
    there = dataset_results(tmp_path / "theirs", other)
    answered = run_method(other, other.pair_sets(), parse_method("identity"), there, Asking(Run(0), Silent()))
    here = dataset_results(tmp_path / "ours", original)
    taken = import_predictions(original, original.pair_sets(), answered.root, "theirs", here)
    assert taken.run_record().answered_on == other.fingerprint
    assert taken.run_record().fingerprint == original.fingerprint


@pytest.mark.thorough
def test_results_on_two_copies_of_one_question_stand_in_one_table(original: Dataset, tmp_path: Path) -> None:
    other = changed(original, tmp_path / "there", last_digits)
    results = tmp_path / "results"
    for dataset, methods in ((original, ["identity", "orb-pnp"]), (other, ["identity", "sift-pnp"])):
        evaluate_methods(
            EvaluateOptions(dataset=dataset.root, methods=tuple(methods), out=results, workers=0), Silent()
        )
    assert len(list(results.iterdir())) == 2
    (entry,) = load_results(results)
    first, second = sorted([original.fingerprint, other.fingerprint])
    assert entry.record.fingerprint == first
    assert entry.copies == (second,)
    assert {m.label: m.run.fingerprint for m in entry.methods} == {
        "identity": first,
        f"identity@{second[:12]}": second,
        "orb-pnp": original.fingerprint,
        "sift-pnp": other.fingerprint,
    }
    write_leaderboard(results, tmp_path / "board", reporter=Silent())
    page = board_pages(tmp_path / "board")
    assert "on other copies of the same question" in page
    rows = list(csv.DictReader((tmp_path / "board" / "leaderboard.csv").open()))
    assert {r["method"]: r["fingerprint"] for r in rows}["sift-pnp"] == other.fingerprint


def test_results_that_claim_a_question_and_hold_other_pairs_are_refused(original: Dataset, tmp_path: Path) -> None:
    other = changed(original, tmp_path / "there", less_pairs)
    results = tmp_path / "far" / "results"  # without a dataset beside them
    for dataset in (original, other):
        evaluate_methods(EvaluateOptions(dataset=dataset.root, methods=("identity",), out=results, workers=0), Silent())
    for path in results.glob("*/dataset.yaml"):
        write_text(path, path.read_text().replace(other.content_id, original.content_id))
    with refused(PredictionError, "", None, "summer__winter__cam0"):
        load_results(results)
    with refused(PredictionError, "", None, "question"):
        load_results(results, datasets=DatasetLookup(results, [other.root]))


def test_predictions_of_another_question_are_refused(original: Dataset, tmp_path: Path) -> None:
    other = changed(original, tmp_path / "there", lambda d: nudge_numbers(d.layout.pair_file(ACROSS), 1e-4))
    there = dataset_results(tmp_path / "theirs", other)
    answered = run_method(other, other.pair_sets(), parse_method("identity"), there, Asking(Run(0), Silent()))
    with refused(PredictionError, "run.yaml"):
        import_predictions(
            original, original.pair_sets(), answered.root, "theirs", dataset_results(tmp_path / "ours", original)
        )


def retrieved(dataset: Dataset, out: Path, *methods: str, predictions: Path | None = None) -> Path:
    """The folder of a retriever's results."""
    options = RetrievalOptions(dataset=dataset.root, out=out, methods=methods, predictions=predictions, workers=0)
    return evaluate_retrievers(options, Silent()).folders[0].root


def test_retrievers_on_two_copies_of_one_question_stand_in_one_table(original: Dataset, tmp_path: Path) -> None:
    other = changed(original, tmp_path / "there", last_digits)
    results = tmp_path / "results"
    retrieved(original, results, "random", "colour-histogram")
    retrieved(other, results, "random")
    first, second = sorted(found.record.fingerprint for found in sets_in(results, SetResults))
    boards = load_board(RETRIEVAL, results)
    assert boards is not None
    (board,) = boards.sets
    assert (board.record.fingerprint, board.copies) == (first, (second,))
    assert {m.label for m in board.methods} == {"colour-histogram", "random", f"random@{second[:12]}"}
    assert "on other copies of the same question" in retrieval_page(boards)
    assert {row["question"] for row in displays.RETRIEVAL.records(boards)} == {board.record.question}


def test_lists_of_another_copy_of_the_question_are_scored_and_lists_of_another_question_are_not(
    original: Dataset, tmp_path: Path
) -> None:
    other = changed(original, tmp_path / "there", last_digits)
    answered = retrieved(other, tmp_path / "theirs", "random")
    taken = retrieved(original, tmp_path / "ours", "theirs", predictions=answered)
    (here,) = sets_in(tmp_path / "ours", SetResults)
    (there,) = sets_in(tmp_path / "theirs", SetResults)
    run = here.method("theirs").run_record()
    assert taken == here.method("theirs").root
    assert (run.fingerprint, run.answered_on) == (here.record.fingerprint, there.record.fingerprint)
    third = changed(original, tmp_path / "third", less_pairs)
    with refused(PredictionError, "run.yaml"):
        retrieved(third, tmp_path / "ours", "again", predictions=answered)


def test_retrieval_results_that_claim_a_question_and_hold_other_tasks_are_refused(
    original: Dataset, tmp_path: Path
) -> None:
    def an_image_less(dataset: Dataset) -> None:
        max(dataset.layout.traversals.glob("winter/images/*/*.png")).unlink()

    other = changed(original, tmp_path / "there", an_image_less)
    results = tmp_path / "results"
    for dataset in (original, other):
        retrieved(dataset, results, "random")
    mine, theirs = (found.record.question for found in sets_in(results, SetResults))
    assert mine != theirs
    for path in results.glob("*/retrieval.yaml"):
        write_text(path, path.read_text().replace(theirs, mine))
    with refused(PredictionError, "retrieval.yaml", None, "summer__winter__cam0"):
        load_board(RETRIEVAL, results)


def test_a_rendered_cross_view_set_asks_the_same_whatever_the_last_digits_of_its_images() -> None:
    def made(fingerprint: str = "ab" * 32, **by: object) -> str:
        recipe = {"kind": "cross-view", "renderer": 1, "options": {"size": 64, "name": "x"}, "versions": {"numpy": "1"}}
        file = content.CrossViewFile(
            format_version=1, kind="cross-view", name="x", licence="", made_by={**recipe, **by}, made={},
            fingerprint=fingerprint,
        )  # fmt: skip
        return content.content_id_of(file, ["test/b.jpg", "test/a.jpg"])

    assert made() == made("cd" * 32, versions={"numpy": "2"}, options={"size": 64, "name": "y"})
    assert made() != made(renderer=2)
    assert made() != made(options={"size": 65, "name": "x"})

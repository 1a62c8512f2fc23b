"""Forged and stale results are refused by name, or shown for what they are where the truth is at hand."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from board_pages import board_pages
from command_line import relocbench
from forgery import change_yaml, forge_errors, forge_summary, reseal
from refusals import Notes, assert_names, refused
from small_dataset import ACROSS, WITHIN, make_small_dataset
from typer.testing import CliRunner

from relocbench.api import read_leaderboard
from relocbench.cli import app as app_module
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.errors import ConfigError, DatasetError, PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.tables.answers import ANSWERS, read_answers
from relocbench.evaluation.tables.errors import PairErrors
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.evaluation.tracking.score import predictions_hash
from relocbench.evaluation.tracking.validation import validate_results
from relocbench.leaderboard import load_results, write_leaderboard
from relocbench.progress import Silent

METHODS = ("identity", "clock", "orb-pnp", "sift-pnp")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with results and, not beside them, the dataset."""
    root = tmp_path_factory.mktemp("made")
    dataset = make_small_dataset(root / "elsewhere" / "small", frames=8)
    evaluate(dataset, root / "results", *METHODS, workers=0)
    return root


@pytest.fixture(scope="module")
def dataset(made: Path) -> Dataset:
    return Dataset(made / "elsewhere" / "small")


@pytest.fixture
def results(made: Path, tmp_path: Path) -> Path:
    """A copy of the results that a test may forge."""
    shutil.copytree(made / "results", tmp_path / "results")
    return tmp_path / "results"


def evaluate(dataset: Dataset, out: Path, *methods: str, **options: Any) -> list[MethodResults]:
    asked = EvaluateOptions(dataset=dataset.root, methods=methods, out=out, **{"workers": 1, **options})
    return evaluate_methods(asked, Silent()).folders


def method(results: Path, label: str) -> MethodResults:
    return MethodResults(next(results.glob("*@*")) / label)


def lookup(results: Path, *datasets: Path, reporter: Silent | None = None) -> DatasetLookup:
    return DatasetLookup(results, datasets, reporter)


def better(row: PairErrors) -> PairErrors:
    """The row of a pair as a forger wishes it was."""
    return replace(
        row,
        status="ok",
        rotation_error_deg=0.01,
        translation_error_m=0.01,
        mlad_translation_error_m=0.01,
    )


def rows_of(results: Path, out: Path, *datasets: Path) -> dict[str, dict[str, str]]:
    """The rows of the board on one pair set, by method."""
    write_leaderboard(results, out, datasets=lookup(results, *datasets))
    with (out / "leaderboard.csv").open(newline="", encoding="utf-8") as stream:
        rows = [row for row in csv.DictReader(stream) if row["pair_set"] == ACROSS]
    return {row["method"]: row for row in rows}


def refused_file(results: Path, *names: object, dataset: Dataset | None = None) -> Path | None:
    """The file that a leaderboard and ``validate`` refuse, in a message that holds ``names``."""
    datasets = [] if dataset is None else [dataset.root]
    with refused(PredictionError, "", None, *names) as bad:
        load_results(results, datasets=lookup(results, *datasets))
    faults = validate_results(results, dataset, Silent()).faults
    path = bad.value.path
    assert path in {fault.path for fault in faults}, "validate finds it too"
    return path


@pytest.mark.thorough
def test_honest_results_are_rescored_bit_for_bit(results: Path, dataset: Dataset, tmp_path: Path) -> None:
    claimed = {m.label: m for m in load_results(results)[0].methods}
    found = {m.label: m for m in load_results(results, datasets=lookup(results, dataset.root))[0].methods}
    assert {m.rescored for m in claimed.values()} == {False}
    assert {m.rescored for m in found.values()} == {True}
    for label, each in found.items():
        for name in (ACROSS, WITHIN):
            assert np.array_equal(each.errors[name].numbers, claimed[label].errors[name].numbers, equal_nan=True)
    assert validate_results(results, dataset, Silent()).faults == []


def test_who_edits_the_errors_is_named(results: Path) -> None:
    folder = method(results, "orb-pnp")
    forge_errors(folder, ACROSS, better)
    assert refused_file(results, "changed", "relocbench evaluate") == folder.errors(ACROSS)
    folder.errors(ACROSS).unlink()
    assert refused_file(results, "missing", "scores.yaml") == folder.errors(ACROSS)


def test_who_edits_the_scores_is_named(results: Path) -> None:
    folder = method(results, "orb-pnp")
    change_yaml(folder.scores_yaml, lambda s: s["pair_sets"][ACROSS]["all"].update({"t_auc@0.5m": 0.99}))
    assert refused_file(results, "t_auc@0.5m", "scores.yaml", 0.99) == folder.errors(ACROSS)


def test_who_edits_errors_and_scores_is_named(results: Path) -> None:
    folder = method(results, "orb-pnp")
    forge_errors(folder, ACROSS, better)
    forge_summary(folder, ACROSS)
    assert refused_file(results, "changed") == folder.errors(ACROSS)


def test_who_computes_the_digests_again_is_exposed_by_the_truth(
    results: Path, dataset: Dataset, tmp_path: Path
) -> None:
    folder = method(results, "orb-pnp")
    forge_errors(folder, ACROSS, better)
    forge_summary(folder, ACROSS)
    reseal(folder)
    row = rows_of(results, tmp_path / "board")["orb-pnp"]
    assert (row["rescored"], float(row["recall@(0.25m,2deg)"])) == ("no", 1.0), "nothing without the truth tells it"
    assert refused_file(results, "rotation_error_deg", 0.01, dataset=dataset) == folder.errors(ACROSS)


@pytest.mark.parametrize("change", ["status", "seconds", "group", "sigma_translation_m"])
def test_no_column_of_the_errors_escapes_the_truth(results: Path, dataset: Dataset, change: str) -> None:
    folder = method(results, "identity")
    new: dict[str, Any] = {"status": "failed", "seconds": 1e-9, "group": "step_2", "sigma_translation_m": 9.0}
    forge_errors(folder, WITHIN, lambda row: replace(row, **{change: new[change]}))
    forge_summary(folder, WITHIN)
    reseal(folder)
    with refused(PredictionError, "", None, change):
        load_results(results, datasets=lookup(results, dataset.root))


def test_who_edits_predictions_is_named(results: Path) -> None:
    folder = method(results, "orb-pnp")
    path = folder.predictions(ACROSS)
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    assert refused_file(results, "changed") == path


def test_who_edits_predictions_and_digests_is_exposed_by_the_truth(results: Path, dataset: Dataset) -> None:
    folder = method(results, "orb-pnp")
    lines = [PoseLine(*pair.key, np.eye(4)) for pair in dataset.pair_set(ACROSS).pairs]
    write_pose_lines(folder.predictions(ACROSS), lines)
    reseal(folder)
    load_results(results)
    assert refused_file(results, "predictions and truth", dataset=dataset) == folder.errors(ACROSS)


@pytest.mark.parametrize(
    "change", [{"isolated": True}, {"uses_times": False}, {"made_elsewhere": False}, {"target": "identity"}]
)
def test_who_edits_the_record_of_a_run_is_named(
    made: Path, dataset: Dataset, tmp_path: Path, change: dict[str, Any]
) -> None:
    evaluate(dataset, tmp_path / "results", "cheat=cheating_trackers:DeclaredClock", workers=0)
    folder = method(tmp_path / "results", "cheat")
    change_yaml(folder.run_yaml, lambda run: run.update({**change, "seed": 7}))
    assert refused_file(tmp_path / "results", "changed", "--overwrite") == folder.run_yaml


@pytest.mark.thorough
def test_what_the_record_of_a_run_admits_is_on_the_page(made: Path, dataset: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "results"
    evaluate(dataset, out, "identity", "clock")
    evaluate(dataset, out, "timed=cheating_trackers:DeclaredClock", "inside=orb-pnp", workers=0)
    theirs = tmp_path / "theirs"
    shutil.copytree(method(made / "results", "orb-pnp").root, theirs, ignore=shutil.ignore_patterns("scores.yaml"))
    evaluate(dataset, out, "theirs", predictions=theirs)
    rows = rows_of(out, tmp_path / "board")
    columns = ("rank", "rescored", "isolated", "uses_times", "made_elsewhere")
    assert {label: tuple(row[c] for c in columns) for label, row in rows.items()} == {
        "inside": ("1", "no", "no", "no", "no"),
        "theirs": ("1", "no", "", "no", "yes"),
        "timed": ("", "no", "no", "yes", "no"),
        "clock": ("", "no", "", "yes", "no"),
        "identity": ("", "no", "yes", "no", "no"),
    }
    assert list(rows)[2:] == ["timed", "clock", "identity"], "those without a rank stand below the others"
    page = board_pages(tmp_path / "board")
    for name in ("inside ¹ ³", "theirs ² ³", "timed (uses times) ¹ ³", "*clock* (timestamp-only baseline) ³"):
        assert f"| {name} |" in page
    assert "- ¹ not isolated: `inside`, `timed`" in page
    assert "- ² made elsewhere: `theirs`" in page
    assert "relocbench evaluate --dataset DATASET --out RESULTS --method clock\n" in page


@pytest.mark.thorough
def test_where_the_clock_was_not_run_the_page_says_how(dataset: Dataset, tmp_path: Path) -> None:
    evaluate(dataset, tmp_path / "results", "identity")
    write_leaderboard(tmp_path / "results", tmp_path / "board")
    assert "Run `relocbench evaluate --method clock`" in board_pages(tmp_path / "board")


@pytest.mark.parametrize("names", [("{}.txt",), ("{}.csv",), ("{}.errors.csv",), ("run.yaml",), ("scores.yaml",)])
def test_files_that_are_swapped_between_methods_are_refused(results: Path, names: tuple[str, ...]) -> None:
    good, bad = method(results, "identity"), method(results, "orb-pnp")
    for name in (name.format(ACROSS) for name in names):
        content = (good.root / name).read_bytes()
        (good.root / name).write_bytes((bad.root / name).read_bytes())
        (bad.root / name).write_bytes(content)
    refused_file(results)


@pytest.mark.thorough
def test_folders_that_are_swapped_say_as_what_they_ran(results: Path, dataset: Dataset, tmp_path: Path) -> None:
    good, bad = method(results, "sift-pnp").root, method(results, "orb-pnp").root
    good.rename(good.with_name("parked"))
    bad.rename(good)
    good.with_name("parked").rename(bad)
    write_leaderboard(results, tmp_path / "board", datasets=lookup(results, dataset.root))
    page = board_pages(tmp_path / "board")
    assert "Folders that are not named as their runs: `orb-pnp` ran as `sift-pnp`, `sift-pnp` ran as `orb-pnp`." in page


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (
            lambda record: record["pair_sets"][ACROSS].update(median_sigma_translation_m=1e-6),
            ACROSS,
        ),
        (lambda record: record["pair_sets"][ACROSS].update(rejected=0, query_condition="fog"), ACROSS),
        (lambda record: record["splits"].update(test=[WITHIN]), "splits"),
        (lambda record: record.update(question="0" * 64), "question"),
    ],
)
def test_what_results_say_of_the_dataset_is_compared_with_the_dataset(
    results: Path, dataset: Dataset, change: Callable[[dict[str, Any]], object], name: str
) -> None:
    path = next(results.glob("*@*/dataset.yaml"))
    change_yaml(path, change)
    load_results(results)
    assert refused_file(results, name, dataset=dataset) == path


@pytest.mark.thorough
def test_scores_of_another_version_of_the_formulas_are_scored_again(results: Path, dataset: Dataset) -> None:
    folder = method(results, "identity")
    change_yaml(folder.scores_yaml, lambda scores: scores.update(formulas=99))
    assert refused_file(results, "version 99") == folder.scores_yaml
    change_yaml(folder.scores_yaml, lambda scores: [scores.pop(k) for k in ("formulas", "errors", "truth", "run")])
    assert refused_file(results, "version 0") == folder.scores_yaml
    evaluate(dataset, results, "identity", pair_sets=(WITHIN,))
    assert load_results(results, datasets=lookup(results, dataset.root))[0].methods[1].rescored, (
        "both pair sets are scored again"
    )


def test_scores_against_another_truth_are_refused(results: Path, dataset: Dataset) -> None:
    folder = method(results, "identity")
    change_yaml(folder.scores_yaml, lambda scores: scores["truth"].update({ACROSS: "0" * 64}))
    assert refused_file(results, "truth", ACROSS, dataset=dataset) == folder.scores_yaml


def test_a_dataset_beside_the_results_is_used_unless_it_is_damaged(
    results: Path, dataset: Dataset, tmp_path: Path
) -> None:
    kept = Notes()
    beside = tmp_path / "data"
    shutil.copytree(dataset.root, beside)
    assert all(m.rescored for m in load_results(results)[0].methods)
    assert all(m.rescored for m in load_results(next(results.glob("*@*")))[0].methods)
    path = beside / "pairs" / f"{ACROSS}.txt"
    path.write_text(path.read_text().replace(" 0.", " 1.", 1))
    assert not any(m.rescored for m in load_results(results, datasets=lookup(results, reporter=kept))[0].methods)
    assert_names(kept.notes[0], "", None, beside, path)
    with refused(DatasetError, path):
        load_results(results, datasets=lookup(results, beside))


def test_datasets_are_found_in_a_folder_of_them(results: Path, dataset: Dataset) -> None:
    make_small_dataset(dataset.root.parent / "other", frames=3, name="other")
    assert all(m.rescored for m in load_results(results, datasets=lookup(results, dataset.root.parent))[0].methods)


def test_a_dataset_that_no_result_is_of_is_a_users_mistake(results: Path, tmp_path: Path) -> None:
    other = make_small_dataset(tmp_path / "far" / "other", frames=3, name="other")
    with refused(ConfigError, "", None, f"other@{other.fingerprint[:12]}"):
        read_leaderboard(results, datasets=[other.root])
    board = tmp_path / "board"
    told = relocbench("leaderboard", results, "--out", board, "--dataset", other.root)
    assert (told.status, "other@" in told.complaint) == (2, True)
    assert not board.exists() or not list(board.iterdir()), "nothing is written"
    with refused(DatasetError, tmp_path / "results"):
        load_results(results, datasets=lookup(results, tmp_path / "results"))


@pytest.mark.thorough
def test_the_commands_refuse_a_forgery_with_status_2(results: Path, dataset: Dataset, tmp_path: Path) -> None:
    folder = method(results, "orb-pnp")
    forge_errors(folder, ACROSS, better)
    forge_summary(folder, ACROSS)
    reseal(folder)
    run = CliRunner()
    asked = ["leaderboard", str(results), "--out", str(tmp_path / "board"), "--quiet"]
    assert run.invoke(app_module.app, asked).exit_code == 0
    told = run.invoke(app_module.app, [*asked, "--dataset", str(dataset.root)])
    assert isinstance(told.exception, PredictionError)
    checked = run.invoke(app_module.app, ["validate", str(results), "--dataset", str(dataset.root)])
    assert checked.exit_code == 2
    assert folder.errors(ACROSS).name in checked.stdout


@pytest.mark.thorough
def test_rescored_boards_have_the_same_bytes(results: Path, dataset: Dataset, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_leaderboard(results, tmp_path / name, datasets=lookup(results, dataset.root))
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_predictions_hash_covers_the_table_of_answers(results: Path) -> None:
    folder = method(results, "orb-pnp")
    before = predictions_hash(folder, ACROSS)
    folder.answers(ACROSS).write_text(folder.answers(ACROSS).read_text().replace("ok", "failed", 1))
    assert predictions_hash(folder, ACROSS) != before
    assert refused_file(results, "changed") == folder.predictions(ACROSS)


@pytest.mark.parametrize("seconds", ["-1.0", "1e300", "nan"])
def test_times_that_cannot_be_are_refused(tmp_path: Path, seconds: str) -> None:
    path = tmp_path / "answers.csv"
    path.write_text(f"{','.join(ANSWERS.columns[:7])}\n1,2,ok,{seconds},,,{{}}\n")
    with refused(PredictionError, "answers.csv", 2, "seconds"):
        read_answers(path)

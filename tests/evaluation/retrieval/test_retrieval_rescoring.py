"""Ranks of retrievers follow from the retrieved images and the truth, or are refused where the truth is at hand."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import relocbench
from forgery import change_yaml
from refusals import Notes, refused
from small_dataset import ACROSS, make_small_dataset
from small_views import make_small_views

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import DatasetError, PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.folders import sets_in
from relocbench.evaluation.retrieval.answers import ANSWERS, QueryAnswer
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.evaluation.retrieval.opening import SetOptions, open_set
from relocbench.evaluation.retrieval.records import (
    METRICS,
    SET_FILE,
    RetrieverResults,
    SetResults,
    write_set_record,
)
from relocbench.evaluation.retrieval.score import summary
from relocbench.files import sha256_file
from relocbench.leaderboard import displays
from relocbench.leaderboard.common.by_query import load_board
from relocbench.leaderboard.retrieval.board import RETRIEVAL, rescored_text
from relocbench.metrics import relevance_within
from relocbench.progress import Silent

HERE = "retrievers_for_tests"
D2S, S2D = "drone-satellite", "satellite-drone"
PLACES = 12


def evaluate(dataset: Path, out: Path, *methods: str, **options: Any) -> None:
    asked = RetrievalOptions(dataset=dataset, out=out, methods=methods, workers=0, **options)
    evaluate_retrievers(asked, Silent())


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results and, not beside them, the set: a method with all images kept, one with few, one whose images tie."""
    root = tmp_path_factory.mktemp("made")
    views = make_small_views(root / "elsewhere" / "town", places=PLACES, noise=700.0)
    evaluate(views, root / "results", f"good={HERE}:Thumbnail", f"ties={HERE}:Constant")
    evaluate(views, root / "results", f"few={HERE}:Thumbnail", f"fewties={HERE}:Constant", keep=3)
    return root


@pytest.fixture
def results(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made / "results", tmp_path / "results")
    return tmp_path / "results"


@pytest.fixture(scope="module")
def town(made: Path) -> Path:
    return made / "elsewhere" / "town"


def only_set(results: Path) -> SetResults:
    (found,) = sets_in(results, SetResults)
    return found


def reseal(folder: RetrieverResults) -> None:
    """Make the digests and means in ``scores.yaml`` those of the files as they are."""
    tasks = SetResults(folder.root.parent).record.tasks

    def digests(scores: dict[str, Any]) -> None:
        scores["run"] = sha256_file(folder.run_yaml)
        for name in scores["answers"]:
            means = summary(tasks[name], ANSWERS.read(folder.answers(name)))
            scores["tasks"][name].update({metric: means[metric] for metric in METRICS})
            scores["answers"][name] = sha256_file(folder.answers(name))
            scores["lists"][name] = sha256_file(folder.predictions(name))

    change_yaml(folder.scores_yaml, digests)


def forge(folder: RetrieverResults, task: str, change: Callable[[QueryAnswer], QueryAnswer]) -> Path:
    """Change the rows of a task, and make the digests fit again."""
    path = folder.answers(task)
    ANSWERS.write(path, [change(row) for row in ANSWERS.read(path)])
    reseal(folder)
    return path


def refused_file(results: Path, *names: object, dataset: Path | None = None) -> Path | None:
    """The file that a leaderboard refuses, in a message that holds ``names``."""
    datasets = [] if dataset is None else [dataset]
    with refused(PredictionError, "", None, *names) as bad:
        load_board(RETRIEVAL, results, datasets=DatasetLookup(results, datasets))
    return bad.value.path


def rows_of(results: Path, out: Path, *datasets: Path) -> dict[tuple[str, str], dict[str, str]]:
    lookup = DatasetLookup(results, datasets)
    board = load_board(RETRIEVAL, results, datasets=lookup)
    assert board is not None
    displays.RETRIEVAL.write_table(board, out)
    displays.RETRIEVAL.write_page(board, out)
    lookup.check_used()
    with (out / "retrieval.csv").open(newline="", encoding="utf-8") as stream:
        return {(row["table"], row["method"]): row for row in csv.DictReader(stream)}


@pytest.mark.thorough
def test_honest_results_are_rescored_as_far_as_images_are_kept(results: Path, town: Path, tmp_path: Path) -> None:
    claimed, found = rows_of(results, tmp_path / "a"), rows_of(results, tmp_path / "b", town)
    assert {row["rescored"] for (_, name), row in claimed.items() if name != "(chance)"} == {"no"}
    said = {name: row["rescored"] for (table, name), row in found.items() if table == "mean over all tasks"}
    assert said == {"good": "yes", "ties": "yes", "few": "first 3", "fewties": "first 3", "(chance)": ""}
    for key, row in claimed.items():
        assert [row[metric] for metric in METRICS] == [found[key][metric] for metric in METRICS]
    page = (tmp_path / "b" / "retrieval.md").read_text(encoding="utf-8")
    assert "relocbench leaderboard RESULTS --out DIR --dataset DATASET" in page
    assert "Ranks behind the images that were kept could move a row by at most" in page
    assert "could move a row" not in (tmp_path / "a" / "retrieval.md").read_text(encoding="utf-8")


def test_what_is_believed_bounds_what_other_ranks_could_give(results: Path, town: Path, tmp_path: Path) -> None:
    row = rows_of(results, tmp_path / "honest", town)[D2S, "few"]
    assert float(row["R@1_believed"]) == 0.0, "it follows from the first three images"
    assert 0.0 < float(row["AP_believed"]) < 0.25
    folder = only_set(results).method("few")
    gallery = only_set(results).record.tasks[D2S].gallery
    ends = []
    for at in (4, gallery):
        forge(folder, D2S, lambda a, at=at: a if a.ranks and a.ranks[0] <= 3 else replace(a, ranks=(at,)))  # type: ignore[misc]
        ends.append(float(rows_of(results, tmp_path / str(at), town)[D2S, "few"]["AP"]))
    forge(folder, D2S, lambda a: a if a.ranks and a.ranks[0] <= 3 else replace(a, ranks=()))
    ends.append(float(rows_of(results, tmp_path / "never", town)[D2S, "few"]["AP"]))
    assert max(ends) - min(ends) == pytest.approx(float(row["AP_believed"]), abs=1e-9)


@pytest.mark.parametrize("label", ["good", "few", "ties", "fewties"])
def test_claimed_ranks_that_do_not_follow_are_exposed_by_the_truth(results: Path, town: Path, label: str) -> None:
    worst = max(ANSWERS.read(only_set(results).method(label).answers(D2S)), key=lambda a: a.ranks[0])
    assert worst.ranks[0] > 1
    folder = only_set(results).method(label)
    path = forge(folder, D2S, lambda a: replace(a, ranks=(1,)) if a.query == worst.query else a)
    assert load_board(RETRIEVAL, results) is not None, "nothing without the truth tells it"
    assert refused_file(results, "ranks", 1, dataset=town) == path


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"positives": 2}, ("positives", 2, 1)),
        ({"group": "0003x"}, ("group", "0003x")),
        ({"ranks": (), "status": "failed"}, ("status", "failed")),
        ({"ranks": ()}, ("ranks",)),
    ],
)
def test_other_forged_cells_are_exposed(
    results: Path, town: Path, change: dict[str, Any], told: tuple[object, ...]
) -> None:
    if "positives" in change:  # which the record would refuse at once
        change_yaml(only_set(results).root / SET_FILE, lambda r: r["tasks"][D2S].update(most_positives=2))
        assert refused_file(results, D2S, dataset=town) is not None
        return
    first = ANSWERS.read(only_set(results).method("good").answers(D2S))[0].query
    for label in ("good", "ties", "few", "fewties"):
        forge(only_set(results).method(label), D2S, lambda a: replace(a, **change) if a.query == first else a)
    assert refused_file(results, *told, dataset=town) is not None


def test_queries_that_the_dataset_does_not_have_are_exposed(results: Path, town: Path) -> None:
    first = ANSWERS.read(only_set(results).method("good").answers(D2S))[0].query
    for label in ("good", "ties", "few", "fewties"):
        forge(only_set(results).method(label), D2S, lambda a: replace(a, query="other.png") if a.query == first else a)
    refused_file(results, "other queries", dataset=town)


def test_a_rank_that_the_images_behind_the_kept_ones_cannot_have_is_refused(results: Path, town: Path) -> None:
    folder = only_set(results).method("few")
    forge(folder, D2S, lambda a: replace(a, ranks=(3,)) if a.ranks[0] > 3 else a)
    refused_file(results, "ranks", 3, dataset=town)


def test_a_forged_record_is_exposed(results: Path, town: Path) -> None:
    path = only_set(results).root / SET_FILE
    kept = path.read_text()
    changes: dict[str, Callable[[dict[str, Any]], object]] = {
        D2S: lambda r: r["tasks"][D2S]["chance"].update({"R@1": 0.001}),
        S2D: lambda r: r["tasks"][S2D].update(gallery=99),
        "positives": lambda r: r.update(positives="whatever is near"),
        "splits": lambda r: r.update(splits={"test": [D2S]}),
        "drone-moon": lambda r: r["tasks"].update({"drone-moon": r["tasks"][D2S]}),
    }
    for told, change in changes.items():
        change_yaml(path, change)
        assert refused_file(results, told, dataset=town) == path
        path.write_text(kept)


def test_edited_files_are_refused_without_the_truth(results: Path) -> None:
    folder = only_set(results).method("few")
    run, lists = folder.run_yaml.read_text(), folder.predictions(D2S).read_text()
    change_yaml(folder.run_yaml, lambda record: record.update(keep=1000))
    assert refused_file(results, "record") == folder.run_yaml
    folder.run_yaml.write_text(run)
    folder.predictions(D2S).write_text("\n".join(lists.splitlines()[1:]) + "\n")
    assert refused_file(results, "changed") == folder.predictions(D2S)
    folder.predictions(D2S).write_text(lists)
    change_yaml(folder.scores_yaml, lambda scores: [scores.pop("run"), scores.pop("lists")])
    assert refused_file(results, "record") == folder.run_yaml


def test_claiming_that_more_images_are_kept_than_there_are_exposes_the_ranks_behind_them(
    results: Path, town: Path
) -> None:
    folder = only_set(results).method("few")
    change_yaml(folder.run_yaml, lambda record: record.update(keep=1000))
    reseal(folder)
    refused_file(results, "ranks", dataset=town)


def test_lists_made_elsewhere_are_rescored(town: Path, made: Path, tmp_path: Path) -> None:
    theirs = only_set(made / "results").method("few").root
    (tmp_path / "mine").mkdir()
    shutil.copy(theirs / f"{D2S}.txt", tmp_path / "mine")
    asked = RetrievalOptions(dataset=town, out=tmp_path / "results", predictions=tmp_path / "mine", workers=0)
    evaluate_retrievers(asked, Silent())
    assert rows_of(tmp_path / "results", tmp_path / "board", town)[D2S, "mine"]["rescored"] == "yes"


@pytest.mark.parametrize("rule", [{"radius": 0.2}, {"radius": 0.3, "heading": 30.0}, {"positives": "pairs"}])
def test_places_of_a_street_are_rescored(tmp_path: Path, rule: dict[str, Any]) -> None:
    street: Dataset = make_small_dataset(tmp_path / "data" / "street", frames=8)
    results = tmp_path / "results"
    evaluate(street.root, results, f"t={HERE}:Constant", **rule)
    assert rows_of(results, tmp_path / "board", street.root)[ACROSS, "t"]["rescored"] == "yes"
    folder = only_set(results).method("t")
    wrong = next(a for a in ANSWERS.read(folder.answers(ACROSS)) if a.ranks and a.ranks[0] > 1)
    forge(folder, ACROSS, lambda a: replace(a, ranks=(1, *a.ranks[1:])) if a.query == wrong.query else a)
    refused_file(results, "ranks", 1, dataset=street.root)
    change_yaml(only_set(results).root / SET_FILE, lambda r: r["options"].clear())
    assert load_board(RETRIEVAL, results, datasets=DatasetLookup(results, [street.root])) is not None, (
        "it has no such set"
    )


def test_a_run_on_one_split_leaves_the_others_in_the_record(town: Path, tmp_path: Path) -> None:
    whole = open_set(town, tmp_path / "out", SetOptions(), Silent())
    splits = {"first": (D2S,), "second": (S2D,), "both": (D2S, S2D)}
    folder = SetResults(tmp_path)
    for name in (D2S, S2D):
        chosen = tuple(task for task in whole.all_tasks if task.name == name)
        write_set_record(folder, replace(whole, all_tasks=chosen, chosen=chosen, splits=splits), chosen)
    assert SetResults(tmp_path).record.splits == splits


def test_the_command_refuses_forged_ranks_and_sets_of_something_else(results: Path, town: Path, tmp_path: Path) -> None:
    other = make_small_views(tmp_path / "far" / "other", places=3)
    told = relocbench("leaderboard", results, "--out", tmp_path / "board", "--dataset", other)
    assert (told.status, "other@" in told.complaint) == (2, True)
    assert relocbench("leaderboard", results, "--out", tmp_path / "board", "--dataset", town, "-q").status == 0
    found = relocbench("leaderboard", results, "--out", tmp_path / "board", "--dataset", town.parent, "-q", "--json")
    assert '"rescored": "first 3"' in found.out
    forge(only_set(results).method("good"), D2S, lambda a: replace(a, ranks=(1,)))
    told = relocbench("leaderboard", results, "--out", tmp_path / "forged", "--dataset", town)
    assert (told.status, f"{D2S}.csv: query" in told.complaint) == (2, True)
    assert not (tmp_path / "forged" / "retrieval.md").exists()


def test_tasks_may_be_run_one_after_another(town: Path, tmp_path: Path) -> None:
    for name in (S2D, D2S):
        words = ("-m", f"t={HERE}:Thumbnail", "-o", tmp_path / "results", "--workers", 0, "--pair-set", name, "--json")
        told = relocbench("evaluate-retrieval", "-d", town, *words)
        assert told.status == 0, told.err
    rows = rows_of(tmp_path / "results", tmp_path / "board", town)
    assert {rows[name, "t"]["rescored"] for name in (D2S, S2D, "mean over all tasks")} == {"yes"}


def test_a_folder_that_was_renamed_is_told(results: Path, town: Path, tmp_path: Path) -> None:
    folder = only_set(results).method("ties").root
    folder.rename(folder.with_name("best"))
    rows_of(results, tmp_path / "board", town)
    page = (tmp_path / "board" / "retrieval.md").read_text(encoding="utf-8")
    assert "Folders that are not named as their runs: `best` ran as `ties`." in page


def test_a_copy_with_other_rules_is_refused(results: Path, town: Path) -> None:
    """A folder that claims to be of the same question, from another processor, and would be shown first."""
    honest = only_set(results)
    forged = honest.root.with_name(f"{honest.root.name.partition('@')[0]}@000000000000")
    shutil.copytree(honest.root, forged)
    for label in ("good", "ties", "few", "fewties"):
        change_yaml(forged / label / "run.yaml", lambda run: run.update(fingerprint="0" * 64))
        reseal(RetrieverResults(forged / label))
    kept = (forged / SET_FILE).read_text()
    for change in ({"positives": "anything"}, {"options": {"radius": 9.0}}, {"splits": {"test": [D2S]}}):
        (forged / SET_FILE).write_text(kept)
        change_yaml(forged / SET_FILE, lambda record, c=change: record.update(fingerprint="0" * 64, **c))  # type: ignore[misc]
        with pytest.raises(PredictionError):
            load_board(RETRIEVAL, results, datasets=DatasetLookup(results, [town]))


def test_a_plain_set_may_have_another_name(results: Path, town: Path, tmp_path: Path) -> None:
    shutil.copytree(town, tmp_path / "far" / "univ")
    assert rows_of(results, tmp_path / "board", tmp_path / "far" / "univ")[D2S, "good"]["rescored"] == "yes"


def test_naming_a_set_twice_or_in_a_folder_is_no_mistake(results: Path, town: Path, tmp_path: Path) -> None:
    assert rows_of(results, tmp_path / "board", town, town.parent, town)[D2S, "good"]["rescored"] == "yes"


def test_a_damaged_set_beside_the_results_is_noted_once_and_not_used(results: Path, town: Path) -> None:
    beside = results.parent / "town"
    shutil.copytree(town, beside)
    image = min(beside.glob("test/query_drone/*/*.png"))
    image.unlink()
    image.symlink_to("nowhere.png")
    kept = Notes()
    board = load_board(RETRIEVAL, results, datasets=DatasetLookup(results, (), kept))
    assert board is not None
    assert {rescored_text(row, table) for table in board.sets[0].tables for row in table.rows} == {"no"}
    assert [note.startswith(f"not scored again with {beside}") for note in kept.notes] == [True]
    with pytest.raises(DatasetError):
        load_board(RETRIEVAL, results, datasets=DatasetLookup(results, [beside]))


def test_no_images_kept_and_ranks_without_an_answer_are_refused(results: Path, town: Path) -> None:
    folder = only_set(results).method("few")
    kept = folder.run_yaml.read_text()
    change_yaml(folder.run_yaml, lambda record: record.update(keep=0))
    assert refused_file(results, "keep") == folder.run_yaml
    folder.run_yaml.write_text(kept)
    change_yaml(folder.run_yaml, lambda record: record.update(keep=2))
    reseal(folder)
    assert refused_file(results, 2, "run.yaml", dataset=town) == folder.predictions(D2S)
    folder.run_yaml.write_text(kept)
    folder.predictions(D2S).unlink()
    assert refused_file(results, "missing") == folder.predictions(D2S)


def test_a_summary_that_is_not_that_of_the_table_is_refused(results: Path) -> None:
    folder = only_set(results).method("good")
    change_yaml(folder.scores_yaml, lambda scores: scores["tasks"][D2S].update({"AP": 1.0}))
    assert refused_file(results, "AP", D2S, 1.0) == folder.scores_yaml


def test_a_keyframe_at_the_radius_is_right_whatever_the_last_digits() -> None:
    gallery = np.array([[3.0 + 1e-13, 4.0, 0.0], [5.0 + 1e-6, 0.0, 0.0]])
    assert relevance_within(np.zeros((1, 3)), gallery, 5.0).of(0).tolist() == [0]


def test_a_set_beside_the_results_is_used_unasked(results: Path, town: Path, tmp_path: Path) -> None:
    shutil.copytree(town, results.parent / "town")
    assert rows_of(results, tmp_path / "out" / "board")[D2S, "good"]["rescored"] == "yes"

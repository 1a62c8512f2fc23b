"""A submission becomes a row whole or not at all, replaces nothing unasked, and stands on the boards with its card."""

from __future__ import annotations

import fcntl
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from board_pages import board_pages
from command_line import Outcome, relocbench
from forgery import change_yaml, reseal
from refusals import assert_names, refused
from small_dataset import ACROSS, make_small_dataset
from submissions import blind_export, change_card, salt_file, submit

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.submission import add
from relocbench.evaluation.submission.check import check_submission
from relocbench.evaluation.submission.contract import SubmissionOptions
from relocbench.geometry import make_transform
from relocbench.leaderboard.tracking.load import load_results
from relocbench.progress import Silent


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("town") / "ds", frames=4, size=(24, 18))


@pytest.fixture(scope="module")
def blind(town: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return blind_export(town, tmp_path_factory.mktemp("blind") / "b")


def adding(root: Path, results: Path, *datasets: Dataset, options: tuple[str, ...] = ()) -> Outcome:
    named = [word for dataset in datasets for word in ("-d", dataset.root)]
    salt = ("--salt-file", salt_file(root.parent))
    return relocbench("leaderboard", "add", root, "--to", results, *named, "-q", *salt, *options)


def row_of(results: Path, town: Dataset, label: str = "my-method") -> MethodResults:
    return MethodResults(results / f"{town.name}@{town.fingerprint[:12]}" / label)


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_blind_answers_are_scored_as_the_same_answers_with_times_are(
    town: Dataset, blind: Dataset, tmp_path: Path
) -> None:
    constant = make_transform(np.eye(3), [0.05, 0.0, -0.12])
    for name, asked in (("real", town), ("blind", blind)):
        submitted = submit(tmp_path / name, asked, lambda pair: constant, lambda pair: 0.5)
        outcome = adding(submitted, tmp_path / f"r-{name}", town)
        assert outcome.status == 0, outcome
    real, through = (row_of(tmp_path / f"r-{name}", town) for name in ("real", "blind"))
    assert through.score_record().pair_sets == real.score_record().pair_sets
    assert through.predictions(ACROSS).read_text() == real.predictions(ACROSS).read_text()
    run = through.run_record()
    assert (run.made_elsewhere, run.answered_blind, real.run_record().answered_blind) == (True, blind.name, "")
    assert set(run.submitted) == set(contents(tmp_path / "blind"))
    assert (through.root / "card.yaml").read_bytes() == (tmp_path / "blind" / "card.yaml").read_bytes()
    assert not (tmp_path / "r-blind" / ".adding").exists()


@pytest.mark.thorough
def test_the_board_shows_the_card_the_mark_and_what_is_odd(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", blind, lambda pair: np.eye(4), what="Guesses <b>boldly</b> | well.")
    assert adding(root, tmp_path / "r", town).status == 0
    assert relocbench("evaluate", "-d", town.root, "-m", "identity", "-o", tmp_path / "r", "-j", 1, "-q").status == 0
    board = ("leaderboard", tmp_path / "r", "-d", town.root, "-q")
    assert relocbench(*board, "--out", tmp_path / "b").status == 0
    pages = board_pages(tmp_path / "b")
    assert "² made elsewhere: `my-method`" in pages
    assert "Answered `" + blind.name in pages
    assert "<b>" not in pages
    assert "all answers are the identity" in pages
    assert "relocbench leaderboard add my-method --results RESULTS --dataset DATASET" in pages
    card = tmp_path / "b" / "cards" / f"{town.name}@{town.fingerprint[:12]}" / "my-method.yaml"
    assert card.read_bytes() == (root / "card.yaml").read_bytes()
    shutil.rmtree(row_of(tmp_path / "r", town).root)
    assert relocbench(*board, "--out", tmp_path / "b").status == 0
    assert not card.exists()


def test_a_row_with_errors_of_its_own_or_another_card_is_refused(town: Dataset, tmp_path: Path) -> None:
    assert adding(submit(tmp_path / "s", town), tmp_path / "r", town).status == 0
    row = row_of(tmp_path / "r", town)
    assert load_results(tmp_path / "r")[0].methods[0].card is not None
    card = row.root / "card.yaml"
    before = card.read_bytes()
    card.write_bytes(before.replace(b"my ", b"our "))
    with refused(PredictionError, card, None, "original"):
        load_results(tmp_path / "r")
    card.unlink()
    with refused(PredictionError, card, None, "missing"):
        load_results(tmp_path / "r")
    card.write_bytes(before)
    lines = row.predictions(ACROSS).read_text().splitlines()
    row.predictions(ACROSS).write_text("\n".join([*lines[:-1], " ".join([*lines[-1].split()[:2], *"0000001"])]) + "\n")
    reseal(row)
    outcome = relocbench("leaderboard", tmp_path / "r", "-d", town.root, "--out", tmp_path / "b", "-q")
    assert (outcome.status, "does not follow from predictions and truth" in outcome.complaint) == (2, True)


def test_what_has_a_fault_or_no_truth_is_not_added(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    (root / town.name / f"{ACROSS}.txt").write_text("1 2\n")
    outcome = adding(root, tmp_path / "r", town)
    assert outcome.status == 1
    assert "unknown pair 1 2" in outcome.out
    outcome = adding(submit(tmp_path / "b", blind), tmp_path / "r", blind)
    assert (outcome.status, "is withheld" in outcome.complaint) == (2, True)
    outcome = adding(submit(tmp_path / "real", town), tmp_path / "r", town, options=("--blind-only",))
    assert outcome.status == 1
    assert not (tmp_path / "r").exists()
    for inside in (town.root / "r", tmp_path / "s" / "r"):
        assert adding(submit(tmp_path / "s", town), inside, town).status == 2
        assert not inside.exists()


def test_no_row_is_replaced_unasked_and_the_same_submission_changes_nothing(town: Dataset, tmp_path: Path) -> None:
    results = tmp_path / "r"
    root = submit(tmp_path / "s", town)
    assert adding(root, results, town).status == 0
    first = contents(results)
    assert "there already" in adding(root, results, town).out
    assert contents(results) == first
    submit(tmp_path / "s2", town, lambda pair: make_transform(np.eye(3), [0.1, 0.0, 0.0]), method="another")
    refused = adding(tmp_path / "s2", results, town)
    assert (refused.status, "is taken by another submission" in refused.complaint) == (2, True)
    assert contents(results) == first
    assert "replaced" in adding(tmp_path / "s2", results, town, options=("--replace",)).out
    assert row_of(results, town).run_record().submitted != {}
    assert contents(results) != first
    assert not (results / ".adding").exists()


@pytest.mark.thorough
def test_labels_of_rows_that_were_run_here_stay_theirs(town: Dataset, tmp_path: Path) -> None:
    results = tmp_path / "r"
    run = ("evaluate", "-d", town.root, "-m", "floor=identity", "-o", results, "-j", 1, "-q")
    assert relocbench(*run).status == 0
    before = contents(results)
    for label, told in (("floor", "was not submitted, and is never replaced"), ("Floor", "capital letters only")):
        outcome = adding(submit(tmp_path / label, town, label=label), results, town, options=("--replace",))
        assert (outcome.status, told in outcome.complaint) == (2, True), outcome
    other = make_small_dataset(tmp_path / "other", frames=3, size=(24, 18), name="village")
    outcome = adding(submit(tmp_path / "v", other, label="floor"), results, other, options=("--replace",))
    assert "is that of another method here" in outcome.complaint
    assert contents(results) == before


@pytest.mark.parametrize("overwrite", ["always", "never"])
def test_no_run_takes_the_place_of_a_submission(town: Dataset, tmp_path: Path, overwrite: str) -> None:
    assert adding(submit(tmp_path / "s", town), tmp_path / "r", town).status == 0
    before = contents(tmp_path / "r")
    words = ("evaluate", "-d", town.root, "-m", "my-method=identity", "-o", tmp_path / "r", "-j", 0, "-q")
    outcome = relocbench(*words, "--overwrite", overwrite)
    assert (outcome.status, "holds a submission, which no run replaces" in outcome.complaint) == (2, True)
    assert contents(tmp_path / "r") == before


def test_one_method_may_have_rows_on_several_datasets(town: Dataset, tmp_path: Path) -> None:
    village = make_small_dataset(tmp_path / "village", frames=3, size=(24, 18), name="village")
    assert adding(submit(tmp_path / "s", town), tmp_path / "r", town).status == 0
    assert adding(submit(tmp_path / "v", village), tmp_path / "r", village).status == 0
    both = submit(tmp_path / "both", town)
    submit(both, village)
    entries = {d.name: {"fingerprint": d.fingerprint, "asked_once": True} for d in (town, village)}
    change_card(both, lambda card: card.update(datasets=entries))
    assert adding(both, tmp_path / "r2", town, village).status == 0
    assert [entry.record.name for entry in load_results(tmp_path / "r2")] == ["small", "village"]


def test_copies_of_another_row_are_named(town: Dataset, tmp_path: Path) -> None:
    assert adding(submit(tmp_path / "a", town), tmp_path / "r", town).status == 0
    outcome = adding(submit(tmp_path / "b", town, label="later"), tmp_path / "r", town)
    assert "answers are those of 'my-method'" in outcome.out
    assert any("'my-method'" in told for told in row_of(tmp_path / "r", town, "later").run_record().remarks)


def test_a_place_that_holds_no_results_is_refused(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    assert adding(root, tmp_path / "r", town).status == 0
    rows = row_of(tmp_path / "r", town).root.parent
    for place, what in (
        (root / "r", "inside the submission"),
        (town.root, "inside the dataset"),
        (rows, "results of one"),
    ):
        outcome = adding(root, place, town)
        assert outcome.status == 2
        assert_names(outcome.complaint, "", None, place, "--results", what)


def test_two_at_once_wait_for_no_one_and_break_nothing(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    checked = check_submission(root, SubmissionOptions((town.root,)), Silent())
    (tmp_path / "r").mkdir()
    descriptor = os.open(tmp_path / "r", os.O_RDONLY)  # as another process has it
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    with refused(PredictionError, tmp_path / "r", None, "lock"):
        add.add_submission(checked, tmp_path / "r", SubmissionOptions((town.root,)), Silent())
    os.close(descriptor)
    assert list((tmp_path / "r").iterdir()) == []


@pytest.mark.parametrize("moves", [1, 2])
def test_a_killed_command_loses_no_row_and_goes_on(
    town: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moves: int
) -> None:
    """Killed before the old row is moved aside, and between that and the new one's taking its place."""
    results, options = tmp_path / "r", SubmissionOptions((town.root,))
    assert adding(submit(tmp_path / "s", town), results, town).status == 0
    before = contents(results)
    root = submit(tmp_path / "s2", town, lambda pair: make_transform(np.eye(3), [0.1, 0.0, 0.0]))
    checked = check_submission(root, options, Silent())
    rename, recover, count = Path.rename, add._recover, []

    class KilledError(BaseException):
        pass

    def killed(path: Path, target: Path) -> Path:
        count.append(path)
        if len(count) == moves:
            raise KilledError
        return rename(path, target)

    def not_at_the_end(staging: Path, where: Path) -> None:
        if not count:
            recover(staging, where)

    monkeypatch.setattr(Path, "rename", killed)
    monkeypatch.setattr(add, "_recover", not_at_the_end)  # a process that is killed does no more
    with pytest.raises(KilledError):
        add.add_submission(checked, results, options, Silent(), replace=True)
    monkeypatch.undo()
    assert (results / ".adding").exists()
    refused = adding(root, results, town)  # without --replace: it puts right what was left, and refuses
    assert refused.status == 2
    assert contents(results) == before
    assert adding(root, results, town, options=("--replace",)).status == 0
    assert not (results / ".adding").exists()
    once = tmp_path / "once"
    assert adding(root, once, town).status == 0
    assert contents(once) == contents(results)


def test_a_retriever_is_submitted_in_the_same_way(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town, task="retrieval", label="lists")
    shutil.rmtree(root / town.name)
    (root / town.name).mkdir()
    times = {name: town.traversal(name).timestamps("cam0") for name in ("summer", "winter")}
    names = {name: [f"traversals/{name}/images/cam0/{t}.png" for t in found] for name, found in times.items()}
    lines = [f"{query} {image}" for query in names["winter"] for image in names["summer"][:2]]
    path = root / town.name / f"{ACROSS}.txt"
    path.write_text("\n".join([*lines, lines[0], "x y", f"{names['winter'][0]} y", "one"]) + "\n")
    outcome = relocbench("submit-check", root, "-d", town.root, "--radius", 0.2)
    assert outcome.status == 1
    for told in (":9: image", "occurs again", ":10: unknown query 'x'", ":11: image 'y' is not in", ":12: expected"):
        assert told in outcome.out
    path.write_text("\n".join(lines) + "\n")
    assert adding(root, tmp_path / "r", town, options=("--radius", "0.2")).status == 0
    assert "there already" in adding(root, tmp_path / "r", town, options=("--radius", "0.2")).out
    board = relocbench("leaderboard", tmp_path / "r", "-d", town.root, "--out", tmp_path / "b", "-q")
    assert board.status == 0, board
    page = (tmp_path / "b" / "retrieval.md").read_text()
    assert "Made elsewhere and imported, so that nobody here saw what made them or how long it took: `lists`." in page
    assert "all queries have one list" in page
    assert len(list((tmp_path / "b" / "cards").glob("*/lists.yaml"))) == 1
    ours = next((tmp_path / "r").glob("*/lists/scores.yaml")).read_text()
    theirs = ("evaluate-retrieval", "-d", town.root, "--radius", 0.2, "--predictions", path, "-m", "same", "-q")
    assert relocbench(*theirs, "-o", tmp_path / "r2").status == 0
    other = next((tmp_path / "r2").glob("*/same/scores.yaml")).read_text()
    assert ours.partition("denominator")[2] == other.partition("denominator")[2]


def test_an_imported_record_cannot_claim_to_be_a_submission(town: Dataset, tmp_path: Path) -> None:
    assert adding(submit(tmp_path / "s", town), tmp_path / "r", town).status == 0
    folder = row_of(tmp_path / "r", town).root
    given = ("evaluate", "-d", town.root, "--predictions", folder, "-m", "import", "-o", tmp_path / "r2", "-q")
    assert relocbench(*given).status == 0
    run = row_of(tmp_path / "r2", town, "import").run_record()
    assert (run.submitted, run.remarks, run.answered_blind) == ({}, (), "")
    change_yaml(folder / "run.yaml", lambda run: run.update(submitted={"card.yaml": "0" * 64}))
    reseal(MethodResults(folder))
    with refused(PredictionError, folder / "card.yaml", None, "original"):
        load_results(tmp_path / "r")

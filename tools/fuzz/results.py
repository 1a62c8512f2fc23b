"""Readers of results of trackers: records, scores, errors, answers, predictions, matching tables, journals."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path

from fuzz.asking import asks, command
from fuzz.datasets import ACROSS
from fuzz.parser import Parser, Place

_METHODS = ("-m", "identity", "-m", "m=trackers_for_tests:Matching")


def write_results(root: Path) -> None:
    """A dataset, and the results of two methods on it."""
    from small_dataset import make_small_dataset

    make_small_dataset(root / "ds", frames=3, size=(24, 18), correspondences=12)
    command("evaluate", "-d", root / "ds", *_METHODS, "--matching", "-o", root / "results", "-j", 1, "-q")
    (root / "theirs").mkdir()
    for path in (_folder(root) / "identity").glob(f"{ACROSS}.[ct]*"):
        shutil.copy(path, root / "theirs")
    shutil.copy(_folder(root) / "identity" / "run.yaml", root / "theirs")


def write_stopped(root: Path) -> None:
    """A dataset, and a run on it that was killed: pairs stand in the journal alone."""
    from small_dataset import make_small_dataset

    dataset = make_small_dataset(root / "ds", frames=3, size=(24, 18))
    command("evaluate", "-d", root / "ds", "-m", "identity", "-o", root / "results", "-j", 1, "-q")
    method = _folder(root) / "identity"
    entries = [
        {
            "key": list(pair.key),
            "pose": [0, 0, 0, 0, 0, 0, 1],
            "status": "ok",
            "seconds": 0.25,
            "confidence": None,
            "message": "",
            "info": "{}",
            "memory": None,
        }
        for pair in dataset.pair_set(ACROSS).pairs
    ]
    for path in [*method.glob(f"{ACROSS}.*"), method / "scores.yaml"]:
        path.unlink()
    journal = method / ".journal" / ACROSS / "1-1.jsonl"
    journal.parent.mkdir(parents=True)
    journal.write_text("".join(json.dumps(entry) + "\n" for entry in entries[:3]))


def _folder(root: Path) -> Path:
    return next((root / "results").glob("small@*"))


def _run_record(place: Place) -> None:
    from relocbench.evaluation.common.results import MethodResults
    from relocbench.leaderboard.tracking.method import evaluate_command

    evaluate_command(MethodResults(place.target.parent).run_record())


def _scores(place: Place) -> None:
    from relocbench.evaluation.common.results import MethodResults

    MethodResults(place.target.parent).score_record()


def _dataset_record(place: Place) -> None:
    from relocbench.evaluation.common.results import DatasetResults

    _ = DatasetResults(place.target.parent).record


def _errors(place: Place) -> None:
    from relocbench.evaluation.tables.errors import read_errors
    from relocbench.evaluation.tracking.score import summarize_rows

    summarize_rows(read_errors(place.target), "all")


def _answers(place: Place) -> None:
    from relocbench.evaluation.tables.answers import read_answers

    read_answers(place.target)


def _matching(place: Place) -> None:
    from relocbench.evaluation.tables.matching import MATCHING, summarize_matching

    summarize_matching(MATCHING.read(place.target))


def _predictions(place: Place) -> None:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.evaluation.tracking.score import read_predictions

    read_predictions(place.target, Dataset(place.root / "ds").pair_set(ACROSS))


def _journal(place: Place) -> None:
    from relocbench.evaluation.isolation.journal import journal_entries

    list(journal_entries(place.target.parent))


def _validate(place: Place) -> Iterable[str]:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.evaluation.tracking.validation import validate_results
    from relocbench.progress import Silent

    found = validate_results(place.root / "results", Dataset(place.root / "ds"), Silent())
    return [str(finding) for finding in (*found.faults, *found.notes)]


def _board(place: Place) -> None:
    from relocbench.leaderboard import write_leaderboard
    from relocbench.progress import Silent

    write_leaderboard(place.root / "results", place.out / "board", reporter=Silent())


SEEDS = {"results": write_results, "stopped": write_stopped}
_METHOD = "results/*/*"
_WHOLE = ("results/*/*.yaml", f"{_METHOD}/*")
PARSERS = (
    Parser("results-run.yaml", "results", (f"{_METHOD}/run.yaml",), _run_record, text=True),
    Parser("results-scores.yaml", "results", (f"{_METHOD}/scores.yaml",), _scores, text=True),
    Parser("results-dataset.yaml", "results", ("results/*/dataset.yaml",), _dataset_record, text=True),
    Parser("results-errors.csv", "results", (f"{_METHOD}/{ACROSS}.errors.csv",), _errors, text=True),
    Parser("results-answers.csv", "results", (f"{_METHOD}/{ACROSS}.csv",), _answers, text=True),
    Parser("results-matching.csv", "results", (f"{_METHOD}/{ACROSS}.matching.csv",), _matching, text=True),
    Parser("predictions", "results", ("theirs/*.txt",), _predictions, text=True),
    Parser("evaluation-journal", "stopped", ("results/*/*/.journal/*/*.jsonl",), _journal, text=True),
    Parser("leaderboard", "results", _WHOLE, _board, names=True, brief=False),
    Parser("validate-results", "results", _WHOLE, _validate, names=True),
    Parser(
        "leaderboard-command",
        "results",
        _WHOLE,
        asks("leaderboard", "{root}/results", "--out", "{out}/b", "-q"),
        names=True,
        brief=False,
    ),
    Parser(
        "predictions-command",
        "results",
        ("theirs/*",),
        asks(
            "evaluate", "-d", "{root}/ds", "--predictions", "{root}/theirs", "-m", "t", "-o", "{out}/r", "-q", "-j", 1
        ),
        names=True,
        brief=False,
    ),
    Parser(
        "resume-command",
        "stopped",
        ("results/*/*/*", "results/*/*/.journal/*/*", "results/*/*.yaml"),
        asks("evaluate", "-d", "{root}/ds", "-m", "identity", "-o", "{root}/results", "-q", "-j", 1),
        names=True,
        resumes=True,
        brief=False,
    ),
)

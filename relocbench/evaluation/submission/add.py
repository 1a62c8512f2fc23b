"""Bringing a submission that was checked into a results folder: each row appears scored and whole, or not at all.

Rows are made in ``RESULTS/.adding`` and moved to their places. What a killed command left there is put right by the
next one.
"""

from __future__ import annotations

import filecmp
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from relocbench.errors import ConfigError, PredictionError
from relocbench.evaluation.common.opening import check_outside
from relocbench.evaluation.common.results import (
    PREDICTIONS,
    MethodResults,
    write_record,
)
from relocbench.evaluation.retrieval.records import (
    SET_FILE,
    RetrieverResults,
)
from relocbench.evaluation.submission.card import CARD, Card, card_bytes
from relocbench.evaluation.submission.check import Checked
from relocbench.evaluation.submission.contract import AnsweredDataset, SubmissionOptions
from relocbench.evaluation.submission.folder import checksums
from relocbench.evaluation.submission.kept import kept_card, rows_of
from relocbench.files import locked_output, read_bytes, write_bytes
from relocbench.progress import Reporter

SUBMISSION = f"{PREDICTIONS}submission/"
"""prefix of the target of a submitted row; no imported folder is called so"""
_STAGING = ".adding"
State = Literal["added", "replaced", "there already"]


@dataclass(frozen=True)
class Added:
    """A row of the results folder."""

    folder: Path
    state: State
    remarks: tuple[str, ...]
    """what is odd about its answers"""


def add_submission(
    checked: Checked, results: Path, options: SubmissionOptions, reporter: Reporter, *, replace: bool = False
) -> list[Added]:
    """Score a submission that was checked, and put it into a results folder.

    Raises:
        PredictionError: the submission has faults, the truth is not available, the label is taken, or another process
            writes to the results.
        ConfigError: ``results`` lies inside a dataset or the submission.
    """
    card = checked.card
    if card is None or not checked.sound:
        raise PredictionError("has faults; see `relocbench submit-check`", checked.root)
    for path in options.datasets:
        check_outside(results, path, "--results")
    if results.resolve().is_relative_to(checked.root.resolve()):
        raise ConfigError("--results lies inside the submission; choose another folder", results)
    if (results / "dataset.yaml").exists() or (results / SET_FILE).exists():
        raise ConfigError("--results is a dataset, or the results of one; expected the folder above", results)
    with locked_output(results, PredictionError):
        staging = results / _STAGING
        _recover(staging, results)
        homes = [one.home(results) for one in checked.answered]
        targets = [home / card.label for home in homes]
        exist = [_check_label(checked, card, target, replace) for target in targets]
        _check_other_rows(card, results, targets)
        out = []
        try:
            with reporter.stage("scoring", len(homes)) as advance:
                for one, home, target, exists in zip(checked.answered, homes, targets, exist, strict=True):
                    made = staging / "new" / home.name
                    remarks = _make(checked, card, one, home, made)
                    out.append(Added(target, _move(one.record_file, made, target, staging, exists), remarks))
                    advance(1)
        finally:
            _recover(staging, results)
        return out


def _make(checked: Checked, card: Card, one: AnsweredDataset, home: Path, made: Path) -> tuple[str, ...]:
    """Make a row in a folder for the dataset. Returns what is odd about its answers."""
    remarks = (*_remarks(checked, one.folder.name), *one.same_as_others(home, card.label))
    row = one.write_row(home, made, card.label)
    fields = {
        "method": card.label,
        "target": f"{SUBMISSION}{card.label}",
        "machine": {"cpu": card.hardware},
        "uses_times": card.uses_times,
        "made_elsewhere": True,
        "answered_blind": "" if one.blind_export is None else str(one.blind_export),
        "submitted": checksums(checked.root, one.folder),
        "remarks": remarks,
    }
    write_bytes(row.root / CARD, card_bytes(checked.root))
    write_record(row.run_yaml, one.run_record(fields))
    one.score(row)
    return remarks


def _remarks(checked: Checked, name: str) -> tuple[str, ...]:
    """What was found odd about the answers to one dataset."""
    return tuple(
        suspicion.removeprefix(f"{name}: ") for suspicion in checked.suspicions if suspicion.startswith(f"{name}: ")
    )


def _check_label(checked: Checked, card: Card, target: Path, replace: bool) -> bool:
    """Whether a row is there that may be replaced. Raises PredictionError where one is that may not be."""
    if not target.exists():
        return False
    row: MethodResults = RetrieverResults(target) if (target.parent / SET_FILE).exists() else MethodResults(target)
    if not row.run_yaml.exists():
        raise PredictionError("exists, and is not a row of results; remove it, or choose another label", target)
    run = row.run_record()
    if not run.submitted:
        message = f"the label '{card.label}' is that of a row that was not submitted, and is never replaced"
        raise PredictionError(f"{message}; choose another label", target)
    mine = any(run.submitted == checksums(checked.root, one.folder) for one in checked.answered)
    if not mine and not replace:
        message = f"the label '{card.label}' is taken by another submission"
        raise PredictionError(f"{message}; choose another label, or replace it with --replace", target)
    return True


def _check_other_rows(card: Card, results: Path, targets: list[Path]) -> None:
    """Refuse a label that means another method on other datasets of the same results.

    Raises:
        PredictionError: the first row that has the label, or one that differs in capital letters only.
    """
    for row in rows_of(results):
        if row.root in targets or row.label.lower() != card.label.lower():
            continue
        if row.label != card.label:
            raise PredictionError(f"'{card.label}' and this label differ in capital letters only", row.root)
        kept = kept_card(row.root, row.run_record())
        if kept is None or (kept.card.method, kept.card.authors) != (card.method, card.authors):
            message = f"the label '{card.label}' is that of another method here; choose another label"
            raise PredictionError(message, row.root)


def _move(record_file: str, made: Path, target: Path, staging: Path, exists: bool) -> State:
    """Put a row that was made into its place."""
    row, home = made / target.name, target.parent
    if exists and _equal(row, target):
        return "there already"
    if not home.exists():
        made.rename(home)  # with the record of the dataset, in one step
        return "added"
    record = home / record_file
    text = read_bytes(made / record_file, "a record", PredictionError)
    if not record.exists() or read_bytes(record, "a record", PredictionError) != text:
        write_bytes(record, text)
    if exists:
        old = staging / "old" / home.name
        old.mkdir(parents=True, exist_ok=True)
        target.rename(old / target.name)
    row.rename(target)
    return "replaced" if exists else "added"


def _equal(ours: Path, theirs: Path) -> bool:
    """Whether two folders of a row hold the same files with the same bytes."""
    names = sorted(path.name for path in ours.iterdir())
    if names != sorted(path.name for path in theirs.iterdir()):
        return False
    return filecmp.cmpfiles(ours, theirs, names, shallow=False)[0] == names


def _recover(staging: Path, results: Path) -> None:
    """Put rows back that a killed command had moved aside and not replaced, and remove what it had begun."""
    if not staging.is_dir() or staging.is_symlink():
        return
    for row in sorted((staging / "old").glob("*/*")):
        place = results / row.parent.name / row.name
        if not place.exists():
            row.rename(place)
    shutil.rmtree(staging)

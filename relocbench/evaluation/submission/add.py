"""Bringing a submission that was checked into a results folder: each row appears scored and whole, or not at all.

Rows are made in ``RESULTS/.adding`` and moved to their places. What a killed command left there is put right by the
next one.
"""

from __future__ import annotations

import filecmp
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.errors import ConfigError, PredictionError
from relocbench.evaluation.common.opening import check_outside
from relocbench.evaluation.common.results import (
    PREDICTIONS,
    DatasetResults,
    MethodResults,
    RunRecord,
    dataset_results,
    write_dataset_record,
    write_record,
)
from relocbench.evaluation.retrieval.answers import write_answers as write_query_answers
from relocbench.evaluation.retrieval.answers import write_lists
from relocbench.evaluation.retrieval.external import answers_to
from relocbench.evaluation.retrieval.records import (
    SET_FILE,
    RetrievalRun,
    RetrieverResults,
    SetResults,
    set_results,
    write_set_record,
)
from relocbench.evaluation.retrieval.score import score_retriever
from relocbench.evaluation.submission.card import CARD, Card, card_bytes
from relocbench.evaluation.submission.check import Checked, RankedDataset, SubmissionOptions, TrackedDataset
from relocbench.evaluation.submission.folder import checksums
from relocbench.evaluation.submission.kept import kept_card, rows_of
from relocbench.evaluation.submission.suspicions import same_answers
from relocbench.evaluation.tables.answers import write_answers
from relocbench.evaluation.tracking.score import read_predictions, score_method
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


@dataclass(frozen=True)
class _Plan:
    """A row that is to be made."""

    target: Path
    make: Callable[[Path], tuple[str, ...]]
    """makes the row in a folder for the dataset, and returns the remarks"""
    record: str
    """name of the file that describes the dataset"""


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
        plans = [
            *(_tracked(checked, card, one, results) for one in checked.tracked),
            *(_ranked(checked, card, one, results) for one in checked.ranked),
        ]
        allowed = {plan.target: _check_label(checked, card, plan.target, replace) for plan in plans}
        _check_other_rows(card, results, [plan.target for plan in plans])
        out = []
        try:
            with reporter.stage("scoring", len(plans)) as advance:
                for plan in plans:
                    made = staging / "new" / plan.target.parent.name
                    remarks = plan.make(made)
                    out.append(Added(plan.target, _move(plan, made, staging, allowed[plan.target]), remarks))
                    advance(1)
        finally:
            _recover(staging, results)
        return out


def _tracked(checked: Checked, card: Card, one: TrackedDataset, results: Path) -> _Plan:
    dataset = one.asked.dataset
    withheld = [of.pair_set.name for of in one.pair_sets if not of.pair_set.has_truth]
    if withheld:
        message = f"the truth of '{withheld[0]}' is withheld; to score, name the dataset that the export was made of"
        raise ConfigError(message, dataset.root)
    root = dataset_results(results, dataset).root

    def make(folder: Path) -> tuple[str, ...]:
        row = MethodResults(folder / card.label)
        write_dataset_record(DatasetResults(folder), dataset)
        for of in one.pair_sets:
            if (checked.root / one.name / f"{of.pair_set.name}.txt").exists():
                lines = [PoseLine(*key, of.poses[key]) for key in of.pair_set.by_key if key in of.poses]
                write_pose_lines(row.predictions(of.pair_set.name), lines)
                write_answers(row.answers(of.pair_set.name), of.complete_answers())
        remarks = (*_remarks(checked, one.name), *_same_as_others(one, DatasetResults(root), card.label))
        run = RunRecord(
            **_provenance(checked, card, one.name, remarks),
            dataset=dataset.name,
            fingerprint=dataset.fingerprint,
            question=dataset.content_id,
            answered_on=one.asked.answered_on,
            answered_blind="" if one.asked.blind is None else str(one.asked.blind.name),
        )
        write_bytes(row.root / CARD, card_bytes(checked.root))
        write_record(row.run_yaml, run)
        score_method(dataset, dataset.pair_sets(), row)
        return remarks

    return _Plan(root / card.label, make, "dataset.yaml")


def _ranked(checked: Checked, card: Card, one: RankedDataset, results: Path) -> _Plan:
    opened = one.asked.images
    if opened.source is None:
        message = f"the truth of '{opened.name}' is withheld; to score, name the dataset that the export was made of"
        raise ConfigError(message, checked.root / one.name)
    set_folder = set_results(results, opened)
    answered = [of for of in one.tasks if (checked.root / one.name / f"{of.task.name}.txt").exists()]

    def make(folder: Path) -> tuple[str, ...]:
        made, row = SetResults(folder), RetrieverResults(folder / card.label)
        if (set_folder.root / SET_FILE).exists():  # other tasks of the same set may have been evaluated
            write_bytes(folder / SET_FILE, read_bytes(set_folder.root / SET_FILE, "a record", PredictionError))
        write_set_record(made, opened, [of.task for of in answered])
        for of in answered:
            gallery = {image.key: index for index, image in enumerate(of.task.gallery)}
            lists = {q.key: [gallery[key] for key in of.lists.get(q.key, ())] for q in of.task.queries}
            kept, answers = answers_to(of.task, lists)
            write_lists(row.predictions(of.task.name), kept)
            write_query_answers(row.answers(of.task.name), answers)
        remarks = _remarks(checked, one.name)
        run = RetrievalRun(
            **_provenance(checked, card, one.name, remarks),
            dataset=opened.name,
            fingerprint=opened.fingerprint,
            question=opened.content_id,
            answered_blind="" if one.asked.blind is None else str(one.asked.blind.name),
        )
        write_bytes(row.root / CARD, card_bytes(checked.root))
        write_record(row.run_yaml, run)
        score_retriever(made.record, row)
        return remarks

    return _Plan(set_folder.root / card.label, make, SET_FILE)


def _provenance(checked: Checked, card: Card, name: str, remarks: tuple[str, ...]) -> dict[str, Any]:
    """What both kinds of records say of a row that was submitted."""
    return {
        "method": card.label,
        "target": f"{SUBMISSION}{card.label}",
        "machine": {"cpu": card.hardware},
        "uses_times": card.uses_times,
        "made_elsewhere": True,
        "submitted": checksums(checked.root, checked.root / name),
        "remarks": remarks,
    }


def _remarks(checked: Checked, name: str) -> tuple[str, ...]:
    """What was found odd about the answers to one dataset."""
    return tuple(
        suspicion.removeprefix(f"{name}: ") for suspicion in checked.suspicions if suspicion.startswith(f"{name}: ")
    )


def _same_as_others(one: TrackedDataset, others: DatasetResults, label: str) -> Iterator[str]:
    """Other rows of the results folder that gave most of the same answers."""
    if not others.root.is_dir():
        return
    given = sum(len(of.poses) for of in one.pair_sets)
    for row in others.methods():
        if row.label != label:
            theirs = {
                of.pair_set.name: read_predictions(row.predictions(of.pair_set.name), of.pair_set)
                for of in one.pair_sets
                if row.predictions(of.pair_set.name).exists()
            }
            same = same_answers(one.pair_sets, theirs)
            if given and 2 * same > given:
                yield f"{same} of {given} answers are those of '{row.label}'"


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
    names = [*(one.name for one in checked.tracked), *(one.name for one in checked.ranked)]
    mine = any(run.submitted == checksums(checked.root, checked.root / name) for name in names)
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


def _move(plan: _Plan, made: Path, staging: Path, exists: bool) -> State:
    """Put a row that was made into its place."""
    row = made / plan.target.name
    if exists and _equal(row, plan.target):
        return "there already"
    if not plan.target.parent.exists():
        made.rename(plan.target.parent)  # with the record of the dataset, in one step
        return "added"
    record = plan.target.parent / plan.record
    text = read_bytes(made / plan.record, "a record", PredictionError)
    if not record.exists() or read_bytes(record, "a record", PredictionError) != text:
        write_bytes(record, text)
    if exists:
        old = staging / "old" / plan.target.parent.name
        old.mkdir(parents=True, exist_ok=True)
        plan.target.rename(old / plan.target.name)
    row.rename(plan.target)
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

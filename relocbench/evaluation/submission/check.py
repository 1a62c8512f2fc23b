"""Checking a submission: its card, its folders, and its answers against the datasets."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.common.opening import open_for_evaluation
from relocbench.evaluation.common.results import RunRecord
from relocbench.evaluation.retrieval.blind_export import BlindImages
from relocbench.evaluation.retrieval.opening import OpenedSet, SetOptions, open_set
from relocbench.evaluation.retrieval.records import RetrievalRun
from relocbench.evaluation.submission.card import CARD, Answered, Card, read_card
from relocbench.evaluation.submission.folder import RUN, answer_files, answer_folders, check_entries
from relocbench.evaluation.submission.poses import PairSetAnswers, read_answered
from relocbench.evaluation.submission.rankings import TaskLists, odd_lists, read_ranked
from relocbench.evaluation.submission.resolving import ResolvedDataset, ResolvedRetrievalSet, resolve, resolve_lists
from relocbench.evaluation.submission.suspicions import suspicions
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.files import YamlPlaces, load_yaml
from relocbench.progress import Reporter


@dataclass(frozen=True)
class SubmissionOptions:
    """What a submission is checked against."""

    datasets: tuple[Path, ...]
    blind_only: bool = False
    """whether only answers to blind exports are taken"""
    retrieval: SetOptions = field(default_factory=SetOptions)
    """which images are right, for lists of images along drives"""


@dataclass(frozen=True, eq=False)
class Opened:
    """A dataset that was named, opened for the task of the submission."""

    path: Path
    dataset: Dataset | None
    """None for places by several views, and for a blind export of images"""
    retrieval: OpenedSet | None

    @property
    def name(self) -> str:
        """What the card calls it."""
        if self.dataset is not None:
            return self.dataset.name
        assert self.retrieval is not None
        return self.retrieval.name

    @property
    def fingerprint(self) -> str:
        if self.dataset is not None:
            return self.dataset.fingerprint
        assert self.retrieval is not None
        return self.retrieval.fingerprint


@dataclass(frozen=True, eq=False)
class TrackedDataset:
    """The answers of a tracker to one dataset."""

    name: str
    """in the submission"""
    asked: ResolvedDataset
    pair_sets: list[PairSetAnswers]


@dataclass(frozen=True, eq=False)
class RankedDataset:
    """The lists of a retriever for one dataset."""

    name: str
    """in the submission"""
    asked: ResolvedRetrievalSet
    tasks: list[TaskLists]


@dataclass(frozen=True)
class Row:
    """What was found of one pair set or task, in numbers."""

    dataset: str
    asked: str
    """pair set or task"""
    pairs: int
    """or queries"""
    answered: int
    missing: int
    unknown: int
    duplicate: int
    invalid: int


@dataclass(eq=False)
class Checked:
    """A submission that was looked at; its answers are to be used only where there is no fault."""

    root: Path
    found: Findings = field(default_factory=Findings)
    card: Card | None = None
    tracked: list[TrackedDataset] = field(default_factory=list)
    ranked: list[RankedDataset] = field(default_factory=list)
    suspicions: list[str] = field(default_factory=list)

    @property
    def blind_exports(self) -> list[BlindKeys | BlindImages | None]:
        """The blind export that each dataset was answered on; None for the dataset itself."""
        return [*(one.asked.blind for one in self.tracked), *(one.asked.blind for one in self.ranked)]

    @property
    def sound(self) -> bool:
        return not self.found.faults

    @cached_property
    def rows(self) -> list[Row]:
        """Every pair set and task of the datasets that were found, whether it is answered or not."""
        out = []
        for tracked in self.tracked:
            for a in tracked.pair_sets:
                asked = len(a.pair_set.evaluated)
                counts = len(a.poses), a.missing, a.unknown, a.duplicate, a.invalid
                out.append(Row(tracked.name, a.pair_set.name, asked, *counts))
        for ranked in self.ranked:
            for t in ranked.tasks:
                counts = len(t.lists), t.missing, t.unknown, t.duplicate, t.invalid
                out.append(Row(ranked.name, t.task.name, len(t.task.queries), *counts))
        return out

    def to_dict(self) -> dict[str, Any]:
        """Everything that was found, as plain values for scripts."""
        found = self.found.by_place()
        listed = {
            name: [{"path": str(f.path) if f.path else None, "line": f.line, "message": f.message} for f in findings]
            for name, findings in (("faults", found.faults), ("notes", found.notes))
        }
        return {
            "submission": str(self.root),
            "valid": self.sound,
            "card": None if self.card is None else self.card.model_dump(mode="json"),
            "answers": [vars(row) for row in self.rows],
            "suspicions": self.suspicions,
            **listed,
        }


def check_submission(root: Path, options: SubmissionOptions, reporter: Reporter) -> Checked:
    """Look at all of a submission; nothing is written.

    Raises:
        PredictionError: there is no submission.
        DatasetError, ConfigError: a dataset that was named is bad, or an option does not fit.
    """
    checked = Checked(root)
    findings = checked.found
    may_open = check_entries(root, findings)
    checked.card, places = read_card(root, findings) if may_open or not (root / CARD).is_symlink() else (None, None)
    retrieval = checked.card is not None and checked.card.task == "retrieval"
    opened = [_open(path, root, options, reporter, retrieval=retrieval) for path in options.datasets]
    if checked.card is None or places is None or not may_open:
        return checked
    _check_folders(root, checked.card, places, findings)
    in_folders = [(name, one) for name, one in checked.card.datasets.items() if (root / name).is_dir()]
    with reporter.stage("checking answers", len(in_folders)) as advance:
        for name, answered in in_folders:
            place = root / CARD, places.line(("datasets", name, "fingerprint"))
            try:
                if retrieval:
                    _check_lists(checked, name, answered, opened, options)
                else:
                    _check_poses(checked, name, answered, opened, options)
            except PredictionError as bad:
                at = (bad.path, bad.line) if bad.path is not None else place
                findings.fault(bad.expected, *at)
            advance(1)
    _tell(checked, checked.card, places)
    return checked


def _open(path: Path, root: Path, options: SubmissionOptions, reporter: Reporter, *, retrieval: bool) -> Opened:
    if path.resolve() == root.resolve():
        raise ConfigError("is the submission itself; --dataset is what it answers", path)
    if retrieval:
        opened = open_set(path, root, options.retrieval, reporter)
        return Opened(path, opened.source.dataset if isinstance(opened.source, StreetPlaces) else None, opened)
    return Opened(path, open_for_evaluation(path, root), None)


def _check_folders(root: Path, card: Card, places: YamlPlaces, findings: Findings) -> None:
    """Faults of datasets without a folder and of folders without a dataset."""
    for name in card.datasets:
        if not (root / name).is_dir():
            message = f"'{name}' is answered by no folder of that name"
            findings.fault(message, root / CARD, places.line(("datasets", name)))
    for folder in answer_folders(root):
        if folder.name not in card.datasets:
            findings.fault(f"is not among the datasets of {CARD}{available(folder.name, card.datasets)}", folder)


def _check_poses(
    checked: Checked, name: str, answered: Answered, opened: Sequence[Opened], options: SubmissionOptions
) -> None:
    folder, findings = checked.root / name, checked.found
    run = _run_record(folder, answered, findings)
    datasets = [one.dataset for one in opened if one.dataset is not None]
    resolved = resolve(name, answered.fingerprint, "" if run is None else run.question, datasets)
    _check_blind_only(name, folder, options, is_blind=resolved.blind is not None)
    files = {path.stem: path for path in answer_files(folder)}
    known = resolved.dataset.pair_set_names
    for stem, path in files.items():
        if stem not in known:
            findings.fault(f"no pair set '{stem}' in {name}{available(stem, known)}", path)
    for path in answer_files(folder, ".csv"):
        if path.stem not in files:
            findings.fault("has no predictions (.txt) of that name beside it", path)
    pair_sets = [
        read_answered(files[s.name], s, resolved, findings) if s.name in files else PairSetAnswers(s)
        for s in resolved.dataset.pair_sets()
    ]
    if not any(s.name in files for s in resolved.dataset.pair_sets()):
        findings.fault("holds no predictions (PAIRSET.txt)", folder)
    checked.tracked.append(TrackedDataset(name, resolved, pair_sets))
    answered_sets = [of for of in pair_sets if of.pair_set.name in files]
    checked.suspicions += _grouped(name, {of.pair_set.name: list(suspicions(of)) for of in answered_sets})


def _check_blind_only(name: str, folder: Path, options: SubmissionOptions, *, is_blind: bool) -> None:
    if options.blind_only and not is_blind:
        message = f"answers '{name}', where names, times or truth are visible; expected answers to a blind export of it"
        raise PredictionError(message, folder)


def _run_record(folder: Path, answered: Answered, findings: Findings) -> RunRecord | None:
    """The record that `relocbench evaluate` wrote beside the answers, if there is one."""
    path = folder / RUN
    if not path.exists():
        return None
    try:
        run = load_yaml(path, RunRecord, "the record of a run", PredictionError)
    except PredictionError as bad:
        findings.fault(bad.expected, bad.path, bad.line)
        return None
    if run.fingerprint != answered.fingerprint:
        message = f"names the fingerprint {run.fingerprint[:SHORT]}, {CARD} names {answered.fingerprint[:SHORT]}"
        findings.fault(message, path)
    return run


def _check_lists(
    checked: Checked, name: str, answered: Answered, opened: Sequence[Opened], options: SubmissionOptions
) -> None:
    folder, findings = checked.root / name, checked.found
    sets = {one.name: (one.fingerprint, one.retrieval) for one in opened if one.retrieval is not None}
    resolved = resolve_lists(name, answered.fingerprint, sets)
    _check_blind_only(name, folder, options, is_blind=resolved.blind is not None)
    if (folder / RUN).exists():
        with findings.catching():
            run = load_yaml(folder / RUN, RetrievalRun, "the record of a retrieval run", PredictionError)
            expected, of = (resolved.images.fingerprint, resolved.images.name)
            if resolved.blind is not None:
                expected, of = answered.fingerprint, name
            if run.fingerprint != expected:
                message = f"is of the set {run.dataset}@{run.fingerprint[:SHORT]}, expected {of}"
                raise PredictionError(f"{message}@{expected[:SHORT]}", folder / RUN)
    tasks = {task.name: task for task in resolved.images.tasks()}
    files = {path.stem: path for path in answer_files(folder)}
    for stem, path in files.items():
        if stem not in tasks:
            findings.fault(f"no task '{stem}' in {name}{available(stem, tasks)}", path)
    lists = [read_ranked(files[n], t, resolved, findings) if n in files else TaskLists(t) for n, t in tasks.items()]
    if not files:
        findings.fault("holds no lists of images (TASK.txt)", folder)
    checked.ranked.append(RankedDataset(name, resolved, lists))
    checked.suspicions += _grouped(name, {of.task.name: odd_lists(of) for of in lists if of.task.name in files})


def _grouped(name: str, oddities: Mapping[str, Sequence[str]]) -> list[str]:
    """One sentence for each thing that is odd, with the pair sets that it is odd of."""
    sets: dict[str, list[str]] = {}
    for asked, sentences in oddities.items():
        for sentence in sentences:
            sets.setdefault(sentence, []).append(asked)
    return [f"{name}: {'' if len(of) == len(oddities) else ', '.join(of) + ': '}{odd}" for odd, of in sets.items()]


def _tell(checked: Checked, card: Card, places: YamlPlaces) -> None:
    """Notes on what is no fault, and on what the card itself says that a reader would ask about."""
    for row in checked.rows:
        if row.missing:
            message = f"{row.missing} of {row.pairs} are not answered and count as failures"
            checked.found.note(f"{row.asked}: {message}", checked.root / row.dataset)
    for name, answered in card.datasets.items():
        if not answered.asked_once:
            checked.suspicions.append(f"{name}: was evaluated more than once, as the card says")
    for name in card.datasets:
        named = re.compile(rf"(?<![\w.+-]){re.escape(name.partition('.blind')[0])}(?![\w+-]|\.\w)")
        seen = [split for split in card.weights.splits_seen if named.search(split)]
        if seen:
            checked.suspicions.append(f"{name}: training or tuning has seen '{seen[0]}', as the card says")
    if card.uses_times and any(blind is not None for blind in checked.blind_exports):
        line = places.line(("uses_times",))
        checked.found.fault("uses_times is true, and a blind export has no times", checked.root / CARD, line)

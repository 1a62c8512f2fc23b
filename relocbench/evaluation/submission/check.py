"""Checking a submission: its card, its folders, and its answers against the datasets."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from relocbench.datasets.checks.faults import Findings
from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.submission.card import CARD, Card, read_card
from relocbench.evaluation.submission.contract import AnsweredDataset, SubmissionOptions, SubmissionTask
from relocbench.evaluation.submission.folder import answer_folders, check_entries
from relocbench.evaluation.submission.ranked import Retrieval
from relocbench.evaluation.submission.tracked import Tracking
from relocbench.files import YamlPlaces
from relocbench.progress import Reporter

TASKS: Mapping[str, type[SubmissionTask]] = {"tracking": Tracking, "retrieval": Retrieval}
"""by what a card calls them"""


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
    answered: list[AnsweredDataset] = field(default_factory=list)
    suspicions: list[str] = field(default_factory=list)

    @property
    def sound(self) -> bool:
        return not self.found.faults

    @cached_property
    def rows(self) -> list[Row]:
        """Every pair set and task of the datasets that were found, whether it is answered or not."""
        return [
            Row(of.folder.name, u.name, u.asked, u.answered, u.missing, u.unknown, u.duplicate, u.invalid)
            for of in self.answered
            for u in of.units
        ]

    def to_dict(self) -> dict[str, Any]:
        """Everything that was found, as plain values for scripts."""
        return {
            "submission": str(self.root),
            "valid": self.sound,
            "card": None if self.card is None else self.card.model_dump(mode="json"),
            "answers": [vars(row) for row in self.rows],
            "suspicions": self.suspicions,
            **self.found.by_place().to_dict(),
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
    for path in options.datasets:
        if path.resolve() == root.resolve():
            raise ConfigError("is the submission itself; --dataset is what it answers", path)
    task = TASKS["tracking" if checked.card is None else checked.card.task](root, options, reporter)
    if checked.card is None or places is None or not may_open:
        return checked
    _check_folders(root, checked.card, places, findings)
    in_folders = [(name, one) for name, one in checked.card.datasets.items() if (root / name).is_dir()]
    with reporter.stage("checking answers", len(in_folders)) as advance:
        for name, answered in in_folders:
            try:
                checked.answered.append(task.read(root / name, answered, findings))
            except PredictionError as bad:
                place = root / CARD, places.line(("datasets", name, "fingerprint"))
                findings.fault(bad.expected, *((bad.path, bad.line) if bad.path is not None else place))
            advance(1)
    for of in checked.answered:
        oddities = {unit.name: list(unit.oddities()) for unit in of.units if unit.given}
        checked.suspicions += _grouped(of.folder.name, oddities)
    _tell(checked, checked.card, places)
    return checked


def _check_folders(root: Path, card: Card, places: YamlPlaces, findings: Findings) -> None:
    """Faults of datasets without a folder and of folders without a dataset."""
    for name in card.datasets:
        if not (root / name).is_dir():
            message = f"'{name}' is answered by no folder of that name"
            findings.fault(message, root / CARD, places.line(("datasets", name)))
    for folder in answer_folders(root):
        if folder.name not in card.datasets:
            findings.fault(f"is not among the datasets of {CARD}{available(folder.name, card.datasets)}", folder)


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
    scored = {of.folder.name: of.resolved.name for of in checked.answered}
    for name in card.datasets:
        named = re.compile(rf"(?<![\w.+-]){re.escape(scored.get(name, name))}(?![\w+-]|\.\w)")
        seen = [split for split in card.weights.splits_seen if named.search(split)]
        if seen:
            checked.suspicions.append(f"{name}: training or tuning has seen '{seen[0]}', as the card says")
    if card.uses_times and any(of.blind_export is not None for of in checked.answered):
        line = places.line(("uses_times",))
        checked.found.fault("uses_times is true, and a blind export has no times", checked.root / CARD, line)

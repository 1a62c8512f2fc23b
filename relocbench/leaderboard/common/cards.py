"""Predictions that were made elsewhere: their cards beside the pages that show their rows, and copies they answered."""

from __future__ import annotations

import shlex
from collections.abc import Container, Iterable, Sequence
from pathlib import Path
from typing import Protocol
from urllib.parse import quote

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.common.results import RunRecord
from relocbench.evaluation.submission.kept import KeptCard
from relocbench.files import write_bytes

_FOLDER = "cards"


class MayHaveCard(Protocol):
    """A method that may have been submitted."""

    @property
    def label(self) -> str: ...

    @property
    def card(self) -> KeptCard | None: ...


class Ran(MayHaveCard, Protocol):
    """The same with how it was run."""

    @property
    def run(self) -> RunRecord: ...


def shown_cards(title: str, methods: Iterable[Ran]) -> list[dict[str, object]]:
    """What a page shows of the cards of the methods of one dataset that have one.

    ``link`` leads there from the leaderboard's folder, and ``blind`` is the blind export that was answered.
    """
    return [
        {
            "label": method.label,
            "card": method.card.card,
            "link": quote(card_file(title, method.label)),
            "blind": method.run.answered_blind,
            "asked_once": all(answered.asked_once for answered in method.card.card.datasets.values()),
            "remarks": method.run.remarks,
        }
        for method in methods
        if method.card is not None
    ]


def card_file(title: str, label: str) -> str:
    """The path of a card, relative to the leaderboard's folder."""
    return f"{_FOLDER}/{title}/{label}.yaml"


def write_cards(out: Path, title: str, methods: Sequence[MayHaveCard]) -> list[Path]:
    """Write the cards of the methods of one dataset as they were handed in, and remove those of rows that are gone."""
    paths = []
    for method in methods:
        if method.card is not None:
            paths.append(out / card_file(title, method.label))
            write_bytes(paths[-1], method.card.data)
    for old in set((out / _FOLDER / title).glob("*.yaml")) - set(paths):
        old.unlink()
    return paths


def add_command(label: str, *, results: str = "RESULTS", dataset: str = "DATASET") -> str:
    """The command that brings a submission in again."""
    return shlex.join(["relocbench", "leaderboard", "add", label, "--results", results, "--dataset", dataset])


def distinct_label(label: str, known: Container[str], fingerprint: str) -> str:
    """The label, or where another copy has the same one, the label with the fingerprint of its copy."""
    return f"{label}@{fingerprint[:SHORT]}" if label in known else label


def answers_on_copies(methods: Sequence[Ran], copies: Sequence[str]) -> list[tuple[list[str], str]]:
    """The labels of methods that answered on another copy, and the short fingerprint of that copy.

    Args:
        copies: fingerprints of the copies other than the first.
    """
    out = [([m.label for m in methods if m.run.fingerprint == copy], copy[:SHORT]) for copy in copies]
    return out + [([m.label], m.run.answered_on[:SHORT]) for m in methods if m.run.answered_on]

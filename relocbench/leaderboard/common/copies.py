"""Methods that answered on several copies of one question."""

from __future__ import annotations

from collections.abc import Container, Sequence

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.leaderboard.common.cards import Ran


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

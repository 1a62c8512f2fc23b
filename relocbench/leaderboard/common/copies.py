"""Words for a page on methods that answered on several copies of one question."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Protocol

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.common.results import RunRecord
from relocbench.leaderboard.common.text import code


class Answered(Protocol):
    """A method with its results on one dataset."""

    @property
    def label(self) -> str: ...

    @property
    def run(self) -> RunRecord: ...


def distinct_label(label: str, known: Container[str], fingerprint: str) -> str:
    """The label, or where another copy has the same one, the label with the fingerprint of its copy."""
    return f"{label}@{fingerprint[:SHORT]}" if label in known else label


def question_words(question: str) -> str:
    """The question, to follow a fingerprint; empty where results do not record it."""
    return f", question {code(question[:SHORT])}" if question else ""


def copies_words(methods: Sequence[Answered], copies: Sequence[str]) -> str:
    """A sentence on which methods answered on which other copy; empty where there is none.

    Args:
        copies: fingerprints of the copies other than the first.
    """
    parts = []
    for copy in copies:
        labels = ", ".join(code(m.label) for m in methods if m.run.fingerprint == copy)
        parts.append(f"{labels or 'no method'} on the copy {code(copy[:SHORT])}")
    parts += [f"{code(m.label)} on the copy {code(m.run.answered_on[:SHORT])}" for m in methods if m.run.answered_on]
    if not parts:
        return ""
    return (
        f" Answers were also given on other copies of the same question, whose images differ in the last digits of the "
        f"processor that made them: {'; '.join(parts)}."
    )

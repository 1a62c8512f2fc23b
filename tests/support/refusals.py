"""What an error of the family says apart from its wording: its class, its file, its line and the data it names.

Sentences are compared in one place (``tests/messages.txt``), so that a better one changes one line.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import Any, TypeVar

import pytest

from relocbench.errors import RelocbenchError
from relocbench.progress import Silent

E = TypeVar("E", bound=RelocbenchError | ValueError)
ErrorData = tuple[Any, ...]
"""place, line and data in a table of cases, for ``refused(DatasetError, *told)`` and ``assert_names(text, *told)``"""


@contextmanager
def refused(
    kind: type[E] | tuple[type[E], ...],
    place: Path | str = "",
    line: int | None = None,
    *names: object,
) -> Iterator[pytest.ExceptionInfo[E]]:
    """The block raises an error of class ``kind`` at ``place:line`` whose sentence names all of ``names``.

    Args:
        kind: class or classes of the error; ValueError where a parser leaves file and line to its caller.
        place: the end of the error's path, such as ``"poses.csv"``, or of a path in its text where it has none itself;
            empty if the error need not name one.
        line: 1-based line number in that file.
        names: what the sentence names, its own file and line aside: keys, options, numbers, values.
    """
    with pytest.raises(kind) as caught:
        yield caught
    error = caught.value
    if not isinstance(error, RelocbenchError) or error.path is None:
        assert_names(str(error), place, line, *names)
        return
    parts = PurePath(place).parts
    assert error.path.parts[-len(parts) :] == parts or not parts, f"is not at {place}: {error}"
    assert line is None or error.line == line, f"is not at line {line}: {error}"
    assert_names(error.expected, "", None, *names)


def assert_names(text: str, place: Path | str = "", line: int | None = None, *names: object) -> None:
    """The text of an error or of a command's stderr names the file and line, and beside them each of ``names``."""
    if place:
        where = re.escape(str(place)) + (r"(?!\w)" if line is None else rf":{line}(?!\d)")
        found = re.search(rf"[^\s']*(?<![\w.-]){where}", text)
        assert found, f"does not name {place}{'' if line is None else f':{line}'}: {text}"
        text = text[: found.start()] + text[found.end() :]
    for name in names:
        assert _holds(text, name), f"does not name {str(name)!r}: {text}"


class Notes(Silent):
    """A reporter that keeps its notes; ``words in notes`` tells whether one of them holds these words."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def note(self, message: str) -> None:
        self.notes.append(message)

    def __contains__(self, words: str) -> bool:
        return any(words in note for note in self.notes)


def noted(notes: Iterable[str], *names: object) -> bool:
    """Whether one of the notes names all of ``names``."""
    return any(all(_holds(note, name) for name in names) for note in notes)


def _holds(text: str, name: object) -> bool:
    """Whether the name stands in the text as a whole word, a number not as a part of another number."""
    return re.search(rf"(?<!\w)(?<!\d\.){re.escape(str(name))}(?!\w|\.\d)", text) is not None

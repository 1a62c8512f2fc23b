"""What an error of the family says apart from its wording: its class, its file, its line and the data it names.

Sentences are compared in one place (``tests/messages.txt``), so that a better one changes one line.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest

from relocbench.errors import RelocbenchError

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
    """The block raises an error of class ``kind`` that names all of ``place:line`` and ``names``.

    Args:
        kind: class or classes of the error; ValueError where a parser leaves file and line to its caller.
        place: the end of the path that the message names, such as ``"poses.csv"``; empty if it need not name one.
        line: 1-based line number in that file.
        names: what else the message names: keys, options, numbers, values.
    """
    with pytest.raises(kind) as caught:
        yield caught
    assert_names(str(caught.value), place, line, *names)


def assert_names(text: str, place: Path | str = "", line: int | None = None, *names: object) -> None:
    """The text of an error or of a command's stderr names the file and line, and each of ``names`` as a whole word."""
    if place:
        where = re.escape(str(place)) + (r"(?!\w)" if line is None else rf":{line}(?!\d)")
        assert re.search(where, text), f"does not name {place}{'' if line is None else f':{line}'}: {text}"
    for name in map(str, names):
        assert re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text), f"does not name {name!r}: {text}"


def noted(notes: Iterable[str], *names: object) -> bool:
    """Whether one of the notes names all of ``names`` as whole words."""
    return any(all(re.search(rf"(?<!\w){re.escape(str(name))}(?!\w)", note) for name in names) for note in notes)

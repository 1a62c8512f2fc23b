"""The one exception family for mistakes that a user can mend, and foreign text made fit for a message."""

from __future__ import annotations

import re
from pathlib import Path

USER_ERROR = 2
"""exit status of a command that was given what the user can mend"""
MOST_QUOTED = 200
"""characters of foreign text in a message"""
MOST_MESSAGE = 2000
"""characters of a message, its path aside"""
_ENDLESS = re.compile(rf"[^\s/]{{{MOST_QUOTED + 11},}}")
"""a word that is longer than what :func:`quoted` makes, with the marks around it; paths are words of short parts"""
_MARKED = re.compile(r"(?<!\w)'([^']*(?:(?<=\w)'(?=\w)[^']*)*)'(?!\w)")
"""what stands between quotation marks, a path or several words as well; an apostrophe within a word is no mark"""


class RelocbenchError(Exception):
    """Bad input or bad use. The command line prints it as one line and exits with 2.

    Whatever is given, its text is one printable line: control characters are written as escapes; what stands between
    quotation marks, words of more than :data:`MOST_QUOTED` characters and messages of more than :data:`MOST_MESSAGE`
    are cut.

    Args:
        expected: what is wrong and what was expected.
        path: the file or folder in question, if any.
        line: 1-based line number in ``path``, if any.
    """

    def __init__(self, expected: str, path: Path | str | None = None, line: int | None = None) -> None:
        marked = _MARKED.sub(lambda found: f"'{cut(found[1], MOST_QUOTED)}'", printable(expected))
        self.expected = cut(_ENDLESS.sub(lambda word: cut(word[0], MOST_QUOTED), marked), MOST_MESSAGE)
        self.path = None if path is None else Path(path)
        self.line = line
        super().__init__(str(self))

    def __reduce__(self) -> tuple[type, tuple[str, Path | None, int | None]]:
        return type(self), (
            self.expected,
            self.path,
            self.line,
        )  # survives the way back from a worker process

    def __str__(self) -> str:
        if self.path is None:
            return self.expected
        place = printable(str(self.path))
        return f"{place}: {self.expected}" if self.line is None else f"{place}:{self.line}: {self.expected}"


class DatasetError(RelocbenchError):
    """A recording or dataset on disk is missing something or holds something impossible."""


class PredictionError(RelocbenchError):
    """A predictions file or a results folder does not fit the dataset it claims to answer."""


class MethodError(RelocbenchError):
    """A method cannot be found, cannot be configured, or breaks the contract."""


class ConfigError(RelocbenchError):
    """A configuration file or a command-line value is not understood."""


def printable(text: str) -> str:
    """Text as one line that a terminal shows and does not obey: other characters become escapes, as ``\\x1b``."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def cut(text: str, most: int = MOST_QUOTED) -> str:
    """At most ``most`` characters; an ellipsis stands for those that were left out."""
    return text if len(text) <= most else text[: most - 1] + "…"


def quoted(text: object, most: int = MOST_QUOTED) -> str:
    """Foreign text for a message: in quotation marks, printable, of at most ``most`` characters between the marks."""
    # What is cut off anyway need not be made printable: the text may be a whole file.
    return f"'{cut(printable(str(text)[: most + 1]), most)}'"


MESSAGE_CHARACTERS = 500
"""what is kept of a message of code that is not ours"""


def one_line(thing: object, most: int = MESSAGE_CHARACTERS) -> str:
    """What code that is not ours says, as a table and a terminal can hold it: one printable line, cut to size.

    Whatever the object's ``__str__`` does, there is a line.
    """
    try:
        text = str.__str__(str(thing))  # a subclass of str may answer otherwise the next time
    except BaseException as bad:  # noqa: BLE001  the boundary to code that is not ours
        text = f"(an object of type {type(thing).__name__}, whose __str__ raised {type(bad).__name__})"
    words = " ".join(text[: 20 * most].split())[:most]
    return "".join(c if c.isprintable() else "?" for c in words)


def raised(bad: BaseException) -> str:
    """An exception of code that is not ours in one line: its type and what it says."""
    return one_line(f"{type(bad).__name__}: {one_line(bad)}")

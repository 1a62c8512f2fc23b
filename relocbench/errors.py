"""The exception family for errors that a user can fix, and untrusted text made safe for messages."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path

USER_ERROR = 2
"""exit status of a command whose input or use is wrong"""
MOST_QUOTED = 200
"""characters of untrusted text in a message"""
MOST_MESSAGE = 2000
"""characters of a message, without its path"""
_ENDLESS = re.compile(rf"[^\s/]{{{MOST_QUOTED + 11},}}")
"""a word longer than :func:`quoted` makes, with the marks around it; the parts of paths are shorter words"""
_MARKED = re.compile(r"(?<!\w)'([^']*(?:(?<=\w)'(?=\w)[^']*)*)'(?!\w)")
"""text between quotation marks, such as a path or several words; an apostrophe within a word is no quotation mark"""


class RelocbenchError(Exception):
    """Bad input or bad use. The command line prints it as one line and exits with status 2.

    Its text is always one printable line (:class:`ManyFaults` has several): control characters become escapes, and
    quoted text, words of more than :data:`MOST_QUOTED` characters and messages of more than :data:`MOST_MESSAGE`
    characters are truncated.

    Args:
        expected: what is wrong and what was expected.
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
    """A recording or dataset on disk lacks something or holds something invalid."""


class ManyFaults(DatasetError):
    """Several faults of an input, reported at once. Its text has one line for each."""

    def __init__(self, faults: Sequence[RelocbenchError]) -> None:
        self.faults = tuple(faults)
        super().__init__(f"{len(self.faults)} faults")

    def __reduce__(self) -> tuple[type, tuple[tuple[RelocbenchError, ...]]]:  # type: ignore[override]
        return type(self), (self.faults,)

    def __str__(self) -> str:
        return "\n".join(str(fault) for fault in self.faults)


def raise_all(faults: Sequence[RelocbenchError]) -> None:
    """Raise the one fault, or all of them at once; nothing if there is none."""
    if len(faults) == 1:
        raise faults[0]
    if faults:
        raise ManyFaults(faults)


class PredictionError(RelocbenchError):
    """A predictions file or a results folder does not fit its dataset."""


class MethodError(RelocbenchError):
    """A method cannot be found or configured, or it breaks the contract."""


class ConfigError(RelocbenchError):
    """A configuration file or a command-line value is not valid."""


def printable(text: str) -> str:
    """Text as one line that a terminal only shows: other characters become escapes such as ``\\x1b``."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def cut(text: str, most: int = MOST_QUOTED) -> str:
    """Text truncated to ``most`` characters, the last of which is then an ellipsis."""
    return text if len(text) <= most else text[: most - 1] + "…"


def quoted(text: object, most: int = MOST_QUOTED) -> str:
    """Untrusted text for a message: in quotation marks, printable, at most ``most`` characters between the marks."""
    # Text that is cut off need not be made printable: it may be a whole file.
    return f"'{cut(printable(str(text)[: most + 1]), most)}'"


def hint(name: str, known: Iterable[str], prefix: str = "") -> str:
    """A suggestion for a mistyped or shortened name, in parentheses; empty if no known name is similar."""
    names = list(known)
    close = get_close_matches(name, names, n=1) or [whole for whole in names if name and whole.startswith(name)]
    return f" (did you mean '{prefix}{close[0]}'?)" if close else ""


def available(name: str, known: Iterable[str], prefix: str = "") -> str:
    """What follows a name that is not known: a suggestion, and all known names."""
    names = list(known)
    return f"{hint(name, names, prefix)}; available: {', '.join(names) or 'none'}"


MESSAGE_CHARACTERS = 500
"""characters that are kept of a message of third-party code"""


def one_line(thing: object, most: int = MESSAGE_CHARACTERS) -> str:
    """A message of third-party code as one printable line of limited length, for a table or a terminal.

    The line is made whatever the object's ``__str__`` does.
    """
    try:
        text = str.__str__(str(thing))  # a subclass of str could return something else the next time
    except BaseException as bad:  # noqa: BLE001  the boundary to code that is not ours
        text = f"(an object of type {type(thing).__name__}, whose __str__ raised {type(bad).__name__})"
    words = " ".join(text[: 20 * most].split())[:most]
    return "".join(c if c.isprintable() else "?" for c in words)


def raised(bad: BaseException) -> str:
    """An exception of third-party code in one line: its type and its message."""
    message = one_line(bad)
    return one_line(f"{type(bad).__name__}: {message}" if message else type(bad).__name__)

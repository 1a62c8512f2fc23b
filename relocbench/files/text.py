"""Text files: UTF-8, of a limited size, and their lines."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from relocbench.errors import RelocbenchError, quoted
from relocbench.files.plain import MAX_BYTES, read_bytes

_WITH_DECIMAL_COMMAS = re.compile(r"[+-]?[0-9]+(,[0-9]+([eE][+-]?[0-9]+)?)?")


def read_text(
    path: Path, what: str, error: type[RelocbenchError] = RelocbenchError, most_bytes: int = MAX_BYTES
) -> str:
    """The text of a UTF-8 file, its lines ended by ``\\n``.

    Raises:
        RelocbenchError: (as ``error``) naming the file and what it should have been: missing, no UTF-8, more than
            ``most_bytes``, or with a NUL character, which no text has.
    """
    data = read_bytes(path, what, error, most_bytes)
    try:
        # Editors on Windows begin a file with a byte order mark, which is no part of its first word.
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as bad:
        raise error(f"not a text file (byte {bad.start} is not UTF-8); expected {what}", path) from None
    text = text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise error(f"holds a NUL character; expected {what}", path, line)
    return text


def lines_of(text: str) -> list[str]:
    """The lines as editors count them: only ``\\n`` ends one, which ``str.splitlines`` does not hold to."""
    lines = text.split("\n")
    if not lines[-1]:
        lines.pop()
    return lines


def read_rows(path: Path, what: str, error: type[RelocbenchError] = RelocbenchError) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of each line of a text table; commas or spaces part fields, ``#`` starts a comment.

    Raises:
        RelocbenchError: (as ``error``) as :func:`read_text`, or with the line where commas are decimal points.
    """
    for number, line in enumerate(lines_of(read_text(path, what, error)), start=1):
        content = fields_of(line.split("#", 1)[0], path, number, error)
        if content:
            yield number, content


def fields_of(text: str, path: Path, line: int, error: type[RelocbenchError] = RelocbenchError) -> list[str]:
    """The fields of a line, parted by commas or spaces. Raises ``error`` where commas are decimal points."""
    if "," not in text:
        return text.split()
    if "." not in text or ";" in text:
        words = text.replace(";", " ").split()
        if len(words) > 1 and all(map(_WITH_DECIMAL_COMMAS.fullmatch, words)):
            message = f"{quoted(next(word for word in words if ',' in word), 30)} has a decimal comma"
            raise error(f"{message}; expected numbers with decimal points, parted by commas or spaces", path, line)
    return text.replace(",", " ").split()

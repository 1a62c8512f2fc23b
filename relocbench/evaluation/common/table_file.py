"""Long tables of a results folder, some thousand rows at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from relocbench.errors import PredictionError
from relocbench.files import read_table

CHUNK_ROWS = 8192
"""rows that are converted at a time: their texts take some 10 MB, however long the table is"""


def table_chunks(path: Path, columns: Sequence[str]) -> Iterator[tuple[list[int], list[list[str]]]]:
    """The rows of a table, some thousand at a time: the lines they begin on, and their fields.

    Raises:
        PredictionError: with file and line: another header, a row of another length, a field that cannot be read.
    """
    rows = read_table(path, columns, error=PredictionError)
    while chunk := list(islice(rows, CHUNK_ROWS)):
        yield [number for number, _ in chunk], [row for _, row in chunk]

"""Reading long tables of a results folder in chunks of rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from relocbench.errors import PredictionError
from relocbench.files import read_table

CHUNK_ROWS = 8192
"""rows that are converted at a time: their text takes some 10 MB, however long the table is"""


def table_chunks(path: Path, columns: Sequence[str]) -> Iterator[tuple[list[int], list[list[str]]]]:
    """Yield the rows of a table in chunks: the line numbers that rows begin on, and their fields.

    Raises:
        PredictionError: with file and line: a wrong header, a row of another length, a field that cannot be read.
    """
    rows = read_table(path, columns, error=PredictionError)
    while chunk := list(islice(rows, CHUNK_ROWS)):
        yield [number for number, _ in chunk], [row for _, row in chunk]

"""``manifest.csv``: path, size and SHA-256 of the files that a fingerprint covers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from relocbench.errors import DatasetError
from relocbench.files import parse_count, read_table, sha256_file, write_table

_COLUMNS = ("path", "bytes", "sha256")

Row = tuple[str, int, str]
"""path relative to the root, bytes, SHA-256"""


def manifest_rows(root: Path, keys: Iterable[str]) -> list[Row]:
    """Rows of files given by their paths relative to the root, in the given order.

    Raises:
        DatasetError: a file cannot be read.
    """
    rows = []
    for key in keys:
        path = root / key
        try:
            rows.append((key, path.stat().st_size, sha256_file(path)))
        except OSError as bad:
            raise DatasetError(f"cannot be read ({bad.strerror})", path) from None
    return rows


def write_manifest(path: Path, rows: Sequence[Row]) -> None:
    """Write a manifest."""
    write_table(path, _COLUMNS, rows)


def read_manifest(path: Path) -> list[Row]:
    """Read a manifest. Raises DatasetError with file and line."""
    rows = []
    for number, (key, size, digest) in read_table(path, _COLUMNS, "a manifest", DatasetError):
        if len(digest) != 64:
            raise DatasetError("expected path, size in bytes, SHA-256", path, number)
        rows.append((key, parse_count(size, "bytes", path, number, DatasetError), digest))
    return rows

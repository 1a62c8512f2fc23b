"""The journal of a pair set: a folder that workers append to while they run, each to a file of its own."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from relocbench.datasets.core.pairfile import PairKey
from relocbench.files import read_journal


def journal_entries(journal: Path) -> Iterator[dict[str, Any]]:
    """What workers have written so far, with each entry's pair as a tuple under ``key``."""
    if not journal.is_dir():
        return
    for path in sorted(journal.glob("*.jsonl")):
        for entry in read_journal(path):
            if "key" in entry:
                yield {**entry, "key": tuple(entry["key"])}


def answered_keys(journal: Path) -> set[PairKey]:
    """The pairs that have an entry in a journal."""
    return {entry["key"] for entry in journal_entries(journal)}


def remove_journal(journal: Path) -> None:
    """Remove the journal of a complete pair set, and the folder of journals if it was the last."""
    shutil.rmtree(journal, ignore_errors=True)
    if journal.parent.is_dir() and not any(journal.parent.iterdir()):
        journal.parent.rmdir()


def append_entry(journal: Path, entry: Mapping[str, Any]) -> None:
    """Write a single entry to a journal."""
    with open_journal(journal) as stream:
        write_entry(stream, entry)


def write_entry(stream: IO[str], entry: Mapping[str, Any]) -> None:
    """Write an entry at once, so that it outlives the process."""
    stream.write(json.dumps(entry) + "\n")
    stream.flush()


@contextmanager
def open_journal(journal: Path) -> Iterator[IO[str]]:
    """Open a journal file that only this process writes: writers never interleave, and only a last line can be torn."""
    # The clock only orders the files: it may stand still or be set back, and two machines may use one process number.
    name = f"{time.time_ns()}-{os.getpid()}-{secrets.token_hex(4)}.jsonl"
    try:
        with (journal / name).open("x", encoding="utf-8") as stream:
            yield stream
    except OSError as bad:
        bad.filename = bad.filename or str(journal / name)  # the error of a full disk does not name the file
        raise

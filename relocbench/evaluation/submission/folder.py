"""The entries of a submission's folder: a card, and a folder of answers for each dataset; nothing is opened here."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from relocbench.datasets.checks.faults import Findings
from relocbench.errors import PredictionError
from relocbench.evaluation.submission.card import CARD
from relocbench.files import sha256_file

RUN = "run.yaml"
_MOST_ENTRIES = 10_000
_ANSWERS = (".txt", ".csv")


def check_entries(root: Path, found: Findings) -> bool:
    """Whether the entries of a submission can be opened; faults for links, pipes and the like, notes on the rest.

    Raises:
        PredictionError: no such folder.
    """
    if not root.is_dir():
        raise PredictionError("no such folder; expected a submission with card.yaml", root)
    if not (root / CARD).exists() and (root / "dataset.yaml").exists():
        raise PredictionError("is a dataset or a results folder; expected a submission with card.yaml", root)
    before = len(found.faults)
    for count, (path, mode, depth) in enumerate(_entries(root, found)):
        if count >= _MOST_ENTRIES:
            found.fault(f"holds more than {_MOST_ENTRIES} files; expected a card and answers", root)
            break
        if stat.S_ISLNK(mode):
            found.fault("is a link; expected the file itself in its place", path)
        elif stat.S_ISDIR(mode):
            if depth > 1:
                found.fault("is a folder within a dataset's folder; expected files alone", path)
        elif not stat.S_ISREG(mode):
            found.fault("is neither a file nor a folder; expected a card and answers", path)
        elif not _is_expected(path, depth):
            found.note("is none of the files of a submission, and is not looked at", path)
    return len(found.faults) == before


def answer_folders(root: Path) -> list[Path]:
    """The folders of answers, by name."""
    return sorted(path for path in root.iterdir() if path.is_dir())


def answer_files(folder: Path, suffix: str = ".txt") -> list[Path]:
    """The files of answers in a dataset's folder, by name."""
    return sorted(path for path in folder.iterdir() if path.suffix == suffix and path.name[0] != ".")


def checksums(root: Path, folder: Path) -> dict[str, str]:
    """SHA-256 of the card and of the files of one dataset, by their path in the submission."""
    files = [root / CARD, *sorted(path for path in folder.iterdir() if _is_expected(path, 2))]
    return {path.relative_to(root).as_posix(): sha256_file(path) for path in files}


def _is_expected(path: Path, depth: int) -> bool:
    if depth == 1:
        return path.name == CARD
    return path.name == RUN or (path.suffix in _ANSWERS and path.name[0] != ".")


def _entries(root: Path, found: Findings) -> Iterator[tuple[Path, int, int]]:
    """Path, mode and depth of every entry, whose links are not followed, down to folders within datasets' folders."""
    folders = [(root, 1)]
    while folders:
        folder, depth = folders.pop()
        try:
            with os.scandir(folder) as opened:
                entries = sorted(opened, key=lambda entry: entry.name)
        except OSError as bad:
            found.fault(f"cannot be read ({bad.strerror}); expected a folder", folder)
            continue
        for entry in entries:
            yield Path(entry.path), entry.stat(follow_symlinks=False).st_mode, depth
            if depth == 1 and entry.is_dir(follow_symlinks=False):
                folders.append((Path(entry.path), 2))

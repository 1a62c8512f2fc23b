"""Check that no method of an evaluation is given the path of the evaluated dataset, which holds the truth."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.errors import MethodError, RelocbenchError
from relocbench.methods import SUBPROCESS, MethodSpec

_LONGEST = 4096
_MOST_WORDS = 1000
_MOST_ENTRIES = 1000
"""of a folder that are looked at"""
_BETWEEN = re.compile(r"[\s:;,=|&<>\"'`\[\](){}]+")
"""what may stand around a path in a longer text: a list of paths, JSON, a command line"""


def check_blind(specs: Sequence[MethodSpec], root: Path) -> None:
    """Check that no parameter and no command line names the dataset.

    Args:
        root: the dataset's folder.

    Raises:
        MethodError: a parameter, or a word of a program's command line, names the dataset, a part of it or a copy of
            it; or a parameter names a folder around it.
    """
    evaluated = _EvaluatedDataset(root)
    for spec in specs:
        of_it = "names a file or folder of the evaluated dataset, which holds the truth"
        for name, value in spec.parameters.items():
            subject = f"{spec.kind.noun} '{spec.label}': parameter '{name}'"
            if any(_leads_to(text, evaluated) for text in _texts(value)):
                raise MethodError(f"{subject} {of_it}")
            if any(_leads_to(text, evaluated, around=True) for text in _texts(value)):
                raise MethodError(
                    f"{subject} names a folder that holds the evaluated dataset; name the file or folder itself "
                    "that the method needs"
                )
        if spec.target.startswith(SUBPROCESS) and _leads_to(spec.target.removeprefix(SUBPROCESS), evaluated):
            raise MethodError(f"{spec.kind.noun} '{spec.label}': its command line {of_it}")


class _EvaluatedDataset:
    """The dataset that methods are evaluated on."""

    def __init__(self, root: Path) -> None:
        self.root = root.resolve()
        self._fingerprint = _fingerprint(root)

    def is_at(self, folder: Path) -> bool:
        """Whether a folder is the dataset, by whatever link or mount, or another one with the same fingerprint."""
        try:
            same = folder.samefile(self.root)
        except OSError:
            return False
        return same or (self._fingerprint is not None and _fingerprint(folder) == self._fingerprint)


def _fingerprint(folder: Path) -> str | None:
    """The fingerprint that a dataset says it has; None for any other folder."""
    try:
        return Dataset(folder).fingerprint if DatasetLayout(folder).dataset_yaml.is_file() else None
    except (OSError, RelocbenchError):
        return None


def _texts(value: Any) -> Iterator[str]:
    """Every text in a parameter's value."""
    if isinstance(value, str | Path):
        yield str(value)
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _texts(key)
            yield from _texts(inner)
    elif isinstance(value, Iterable) and not isinstance(value, bytes):
        for inner in value:
            yield from _texts(inner)


def _leads_to(text: str, evaluated: _EvaluatedDataset, *, around: bool = False) -> bool:
    """Whether a text is, or holds, the path of a dataset, of something in it or of a copy of it.

    Args:
        around: the path of a folder that one of these is in, instead. A word alone, such as the name of a mode, is no
            such path even where there is a folder of that name.
    """
    words = dict.fromkeys((text, *islice(_BETWEEN.split(text), _MOST_WORDS)))
    if around:
        plain = (word for word in words if os.sep in word or word in (".", "..") or word.startswith(("~", "$")))
        return any(_holds(path, evaluated) for word in plain for path in _paths(word))
    return any(_is_of(path, evaluated) for word in words for path in _paths(word))


def _paths(word: str) -> Iterator[Path]:
    """The existing paths that a program might take a word for, without links: as it stands, expanded, and as a URL."""
    if not word or len(word) > _LONGEST or "\0" in word:
        return
    plain = re.sub(r"^(file:)?/{2,}(localhost(?=/))?", "/", word)
    for form in dict.fromkeys((word, plain, unquote(plain), os.path.expandvars(os.path.expanduser(word)))):  # noqa: PTH111
        try:
            path = Path(form).resolve()
            if path.exists():
                yield path
        except (OSError, RuntimeError, ValueError):
            continue


def _is_of(path: Path, evaluated: _EvaluatedDataset) -> bool:
    return any(evaluated.is_at(above) for above in (path, *path.parents))


def _holds(path: Path, evaluated: _EvaluatedDataset) -> bool:
    if path == Path(path.anchor):  # more often the bar of a fraction than a path
        return False
    return path in evaluated.root.parents or any(map(evaluated.is_at, _entries(path)))


def _entries(folder: Path) -> Iterator[Path]:
    try:
        with os.scandir(folder) as entries:
            yield from (Path(entry.path) for entry in islice(entries, _MOST_ENTRIES) if entry.is_dir())
    except OSError:
        return

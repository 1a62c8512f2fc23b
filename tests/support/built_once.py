"""What many tests begin with is built once a run, and copied for each that asks."""

from __future__ import annotations

import fcntl
import functools
import hashlib
import inspect
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Concatenate, Generic, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

FOLDER = "RELOCBENCH_TESTS_BUILT"
"""environment variable that names the folder of what was built in this run; ``conftest.py`` makes and removes it"""


class BuiltOnce(Generic[P, T]):
    """What :func:`built_once` makes of a function."""

    def __init__(self, write: Callable[Concatenate[Path, P], object], opened: Callable[[Path], T]) -> None:
        self._write, self._opened = write, opened
        functools.update_wrapper(self, write)

    def __call__(self, root: Path, /, *args: P.args, **kwargs: P.kwargs) -> T:
        """A copy at ``root``, to change as one likes."""
        if FOLDER in os.environ:
            shutil.copytree(self._made(*args, **kwargs), root, dirs_exist_ok=True)
        else:
            self._write(root, *args, **kwargs)
        return self._opened(root)

    def original(self, *args: P.args, **kwargs: P.kwargs) -> T:
        """The only one, which nobody may change: for what is built of it again, and remembers where it lay."""
        return self._opened(self._made(*args, **kwargs))

    def _made(self, *args: P.args, **kwargs: P.kwargs) -> Path:
        bound = inspect.signature(self._write).bind(Path(), *args, **kwargs)
        bound.apply_defaults()
        key = pickle.dumps((self._write.__module__, self._write.__qualname__, bound.arguments))
        made = Path(os.environ[FOLDER]) / hashlib.sha256(key).hexdigest()[:16]
        once(made, lambda folder: self._write(folder, *args, **kwargs))
        return made


def built_once(
    opened: Callable[[Path], T],
) -> Callable[[Callable[Concatenate[Path, P], object]], BuiltOnce[P, T]]:
    """Decorator of a function that writes a folder, its first argument, and depends on its arguments alone.

    All processes of a run of pytest call it once for the same arguments, which can be pickled; every caller gets a copy
    at the folder it named, to change as it likes, and ``opened(folder)``.
    """
    return lambda write: BuiltOnce(write, opened)


def once(made: Path, write: Callable[[Path], object]) -> None:
    with made.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        begun = made.with_suffix(".begun")
        if begun.exists() or not made.exists():
            shutil.rmtree(made, ignore_errors=True)  # of a process that was killed
            begun.touch()
            write(made)  # in its own place, since a dataset remembers where what it was built of lay
            begun.unlink()

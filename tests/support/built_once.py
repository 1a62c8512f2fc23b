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
from typing import Concatenate, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

FOLDER = "RELOCBENCH_TESTS_BUILT"
"""environment variable that names the folder of what was built in this run; ``conftest.py`` makes and removes it"""


def built_once(
    opened: Callable[[Path], T],
) -> Callable[[Callable[Concatenate[Path, P], object]], Callable[Concatenate[Path, P], T]]:
    """Decorator of a function that writes a folder, its first argument, and depends on its arguments alone.

    All processes of a run of pytest call it once for the same arguments, which can be pickled; every caller gets a copy
    at the folder it named, to change as it likes, and ``opened(folder)``.
    """

    def decorate(write: Callable[Concatenate[Path, P], object]) -> Callable[Concatenate[Path, P], T]:
        signature = inspect.signature(write)

        @functools.wraps(write)
        def copy(root: Path, /, *args: P.args, **kwargs: P.kwargs) -> T:
            if FOLDER in os.environ:
                bound = signature.bind(Path(), *args, **kwargs)
                bound.apply_defaults()
                key = pickle.dumps((write.__module__, write.__qualname__, bound.arguments))
                made = Path(os.environ[FOLDER]) / hashlib.sha256(key).hexdigest()[:16]
                _once(made, lambda folder: write(folder, *args, **kwargs))
                shutil.copytree(made, root, dirs_exist_ok=True)
            else:
                write(root, *args, **kwargs)
            return opened(root)

        return copy

    return decorate


def _once(made: Path, write: Callable[[Path], object]) -> None:
    with made.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            half = made.with_suffix(".half")
            shutil.rmtree(half, ignore_errors=True)  # of a process that was killed
            write(half)
            half.rename(made)

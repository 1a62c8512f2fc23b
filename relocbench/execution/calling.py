"""A call of a function in a worker: with one thread, and with what it prints redirected to standard error."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import TypeVar

Unit = TypeVar("Unit")
Result = TypeVar("Result")

_OF_CHILDREN = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "OPENCV_FOR_THREADS_NUM",
        "THP_MEM_ALLOC_ENABLE",  # torch's large tensors on huge pages: small ones cost a network a third of its time
    ),
    "1",
)


def pin_threads() -> None:
    """Limit each library that is loaded to one thread, so that N workers use N cores."""
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@contextmanager
def single_threaded_children() -> Iterator[None]:
    """Set thread counts in the environment of child processes, where libraries read them when they are loaded."""
    before = {name: os.environ.get(name) for name in _OF_CHILDREN}
    os.environ.update(_OF_CHILDREN)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def on_one_core(wanted: bool) -> Iterator[None]:
    """Bind this thread, and the processes that it starts meanwhile, to a single core where that is wanted.

    A process may unbind itself: nothing short of privileges forbids it.
    """
    if not wanted:
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def messages_to_stderr() -> Iterator[None]:
    """Redirect standard output to standard error while third-party code runs: only a command's result belongs on it.

    The file descriptor itself is redirected, so that native libraries and child processes are included.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def call(function: Callable[[Unit], Result], unit: Unit) -> Result:
    with messages_to_stderr():
        result = function(unit)
    pin_threads()
    return result

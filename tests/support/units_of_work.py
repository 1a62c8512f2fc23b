"""What workers do in tests of them: ``from units_of_work import square``.

They stand apart from the tests, so that a worker process need not import pytest.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from relocbench.errors import DatasetError

_MEETING_S = 60.0


def square(value: int) -> int:
    return value * value


def environment(_: int) -> tuple[int, str]:
    return os.getpid(), os.environ.get("OMP_NUM_THREADS", "")


def die_once(mark: str) -> str:
    path = Path(mark)
    if "die" in path.name and not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


def die(_: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def user_error(line: int) -> None:
    raise DatasetError("expected better", Path("file.txt"), line)


def count_alive(folder: str) -> int:
    mark = Path(folder) / f"{os.getpid()}-{time.time_ns()}"
    mark.touch()
    return len(list(Path(folder).iterdir()))


def meet(place: tuple[str, str, int]) -> tuple[str, int]:
    """The name and the process, once as many of the same round have begun: (folder, "ROUND-NAME", number of them)."""
    folder, name, others = place
    here, number = Path(folder), name.partition("-")[0]
    (here / name).touch()
    patience = time.monotonic() + _MEETING_S
    while len(list(here.glob(f"{number}-*"))) < others:
        assert time.monotonic() < patience, f"{name} is alone: the others of its round wait for this worker"
        time.sleep(0.005)
    return name, os.getpid()


def tell_and_sleep(folder: str) -> None:
    """A file named by the process, then nothing for long."""
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(3600)


def end_at_once(connection: object) -> None:
    """Instead of serving: what a worker does that is ended while it starts."""
    os._exit(3)

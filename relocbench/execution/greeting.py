"""What a Dask worker must have in common with this process: versions, one thread, and the folders of the work."""

from __future__ import annotations

import platform
import secrets
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from relocbench import version
from relocbench.errors import ConfigError
from relocbench.execution.scheduler import Scheduler

_PACKAGES = ("dask", "distributed", "numpy", "opencv-python-headless")
_LOOKS = 3
"""a shared file system may show a new file a moment later"""


@dataclass(frozen=True)
class Greeting:
    """What a worker answers."""

    versions: dict[str, str]
    unseen: list[str]


def greet(paths: Sequence[Path]) -> Greeting:
    """Runs on a worker: what it is made of, and which of the paths it does not see."""
    for look in range(_LOOKS):
        time.sleep(look)
        unseen = [str(path) for path in paths if not path.exists()]
        if not unseen:
            break
    return Greeting(versions_here(), unseen)


def versions_here() -> dict[str, str]:
    """Versions of what work depends on that is passed between processes."""
    return {
        "relocbench": version.__version__,
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: _version(name) for name in _PACKAGES},
    }


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "absent"


@contextmanager
def shown(scheduler: Scheduler) -> Iterator[list[Path]]:
    """The paths that a worker must see; in the folder that is written to, a file that was not there before.

    A folder of the same name on a worker's own disk would else pass for the shared one.
    """
    if scheduler.writes is None or not scheduler.writes.is_dir():
        yield list(scheduler.reads)
        return
    # Named as the part of a file: what a kill leaves behind is cleared away with those.
    token = scheduler.writes / f".cluster.{secrets.token_hex(8)}.part"
    token.touch()
    try:
        yield [token, *scheduler.reads]
    finally:
        token.unlink(missing_ok=True)


def refuse(worker: str, threads: int, greeting: Greeting, scheduler: Scheduler) -> None:
    """Raises ConfigError where work must not be sent to a worker."""
    if threads > 1:
        # Workers keep trackers, and a tracker need not be safe to call from two threads at once.
        raise ConfigError(f"workers of {scheduler} run several threads each; start them with --nthreads 1")
    different = differences(versions_here(), greeting.versions)
    if different:
        raise ConfigError(f"worker {worker} of {scheduler} runs other versions: {different}")
    if greeting.unseen:
        unseen = Path(greeting.unseen[0])
        folder = unseen.parent if unseen.name.startswith(".cluster.") else unseen
        raise ConfigError(
            f"not seen by worker {worker}; all workers must see the folders of dataset and results under the same path",
            folder,
        )


def differences(here: dict[str, str], there: dict[str, str]) -> str:
    """In words; empty where all that both know is the same."""
    return ", ".join(f"{k} {there[k]} there, {v} here" for k, v in here.items() if k in there and there[k] != v)

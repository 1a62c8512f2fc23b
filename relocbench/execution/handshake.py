"""What a Dask worker must share with this process: versions, a single thread, and the folders of the work."""

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
"""tries, since a shared file system may show a new file only a moment later"""


@dataclass(frozen=True)
class WorkerReport:
    """What a worker reports when it joins."""

    versions: dict[str, str]
    unseen: list[str]


def report(paths: Sequence[Path]) -> WorkerReport:
    """Report, from a worker, its versions and those of the paths that it does not see."""
    for look in range(_LOOKS):
        time.sleep(look)
        unseen = [str(path) for path in paths if not path.exists()]
        if not unseen:
            break
    return WorkerReport(versions_here(), unseen)


def versions_here() -> dict[str, str]:
    """The versions of packages that affect what is passed between processes."""
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
def shared_paths(scheduler: Scheduler) -> Iterator[list[Path]]:
    """The paths that a worker must see; for the folder that is written to, a new file in it.

    Otherwise a folder of the same name on a worker's own disk would pass for the shared one.
    """
    if scheduler.writes is None or not scheduler.writes.is_dir():
        yield list(scheduler.reads)
        return
    # It is named like an unfinished file, so that it is removed with those if this process is killed.
    token = scheduler.writes / f".cluster.{secrets.token_hex(8)}.part"
    token.touch()
    try:
        yield [token, *scheduler.reads]
    finally:
        token.unlink(missing_ok=True)


def check_worker(worker: str, threads: int, found: WorkerReport, scheduler: Scheduler) -> None:
    """Raise ConfigError if work must not be sent to a worker."""
    if threads > 1:
        # Workers keep trackers, which need not be safe to call from two threads.
        raise ConfigError(f"workers of {scheduler} run several threads each; start them with --nthreads 1")
    different = differences(versions_here(), found.versions)
    if different:
        raise ConfigError(f"worker {worker} of {scheduler} runs other versions: {different}")
    if found.unseen:
        unseen = Path(found.unseen[0])
        folder = unseen.parent if unseen.name.startswith(".cluster.") else unseen
        raise ConfigError(
            f"not seen by worker {worker}; all workers must see the folders of dataset and results under the same path",
            folder,
        )


def differences(ours: dict[str, str], theirs: dict[str, str]) -> str:
    """Describe where versions differ; empty where all packages that both sides know are the same."""
    return ", ".join(f"{k} {theirs[k]} there, {v} here" for k, v in ours.items() if k in theirs and theirs[k] != v)

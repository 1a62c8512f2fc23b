"""Fixtures shared by all tests."""

from __future__ import annotations

import gc
import itertools
import os
import re
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from browser_pages import browser, page  # noqa: F401  fixtures
from built_once import FOLDER
from hypothesis import HealthCheck, settings

# Hundreds of processes are started here, and without this each would compile what it imports anew (torch: 900 modules).
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# No test cuts the power, and waiting for the disk is a tenth of the run.
os.fsync = lambda fd: None

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts a job in the background so, and Python leaves it so; the tests press Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)


_built = pytest.StashKey[tempfile.TemporaryDirectory[str]]()


def pytest_configure(config: pytest.Config) -> None:
    """Make the folder of what is built once a run; worker processes inherit its name."""
    gc.disable()
    if not hasattr(config, "workerinput"):
        config.stash[_built] = tempfile.TemporaryDirectory(prefix="relocbench-tests-")
        os.environ[FOLDER] = config.stash[_built].name
    elif hasattr(os, "sched_setaffinity"):
        # A command without --workers starts one worker and not one for each core, which the other tests use as well.
        one = {min(os.sched_getaffinity(0))}
        os.sched_getaffinity = lambda pid: one


def pytest_collection_finish() -> None:
    """Keep what lives as long as the run out of the collector's way, which would walk through it again and again."""
    gc.enable()
    gc.freeze()


def pytest_unconfigure(config: pytest.Config) -> None:
    if _built in config.stash:
        config.stash[_built].cleanup()


# The same examples on every machine, whatever it was that failed there before and however long one takes.
settings.register_profile(
    "everywhere",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("everywhere")

REAL_DATA = Path(os.environ.get("RELOCBENCH_REAL_DATA", Path(__file__).parents[1] / ".." / "shared" / "data"))


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """``real_data("kitti_odometry")`` is that folder of real recordings; the test skips where it is absent."""

    def find(name: str) -> Path:
        folder = REAL_DATA / name
        if not folder.is_dir():
            pytest.skip(f"no real recordings '{name}' (set RELOCBENCH_REAL_DATA to the folder that holds them)")
        return folder.resolve()

    return find


@pytest.fixture(scope="session", autouse=True)
def writable(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Methods of tests keep logs among the tests' files: they may write to folders of caches that have a variable."""
    os.environ["OF_TESTS_CACHE_DIR"] = str(tmp_path_factory.getbasetemp())


_folders = itertools.count()


@pytest.fixture
def tmp_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """pytest's own counts the folders of the whole run for each new one, seconds of them in a run of thousands."""
    name = re.sub(r"\W", "_", request.node.name)[:26]
    return tmp_path_factory.mktemp(f"{name}_{next(_folders)}", numbered=False)


@pytest.fixture(scope="module")
def workers_kept() -> Iterator[None]:
    """Worker processes that live go on from test to test: a fresh one takes seconds to import what it works with.

    A test that needs processes of its own runs what starts them by ``contextvars.Context().run``.
    """
    from relocbench.execution import kept_workers

    with kept_workers():
        yield


@pytest.fixture(scope="module")
def towns_kept() -> Iterator[None]:
    """Jobs in this process render streets of which what takes seconds is made once a run."""
    from built_towns import keep_towns

    with pytest.MonkeyPatch.context() as patch:
        keep_towns(patch)
        yield


@pytest.fixture
def small_preview(monkeypatch: pytest.MonkeyPatch) -> None:
    """Previews of a small district: the light of a scene takes longer than its pictures, the more so in a large one."""
    monkeypatch.setattr("relocbench.datasets.synthetic.jobs.contact_sheet._EXTENT_M", 190.0)
    monkeypatch.setattr("relocbench.datasets.synthetic.jobs.contact_sheet._ROUTE_M", 100.0)

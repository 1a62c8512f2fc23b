"""Fixtures shared by all tests."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from browser_pages import browser, page  # noqa: F401  fixtures
from hypothesis import HealthCheck, settings

_compiled: tempfile.TemporaryDirectory[str] | None = None
if sys.dont_write_bytecode and sys.pycache_prefix is None:
    # Hundreds of processes are started here, and each would compile what it imports anew (torch: 900 modules). What is
    # compiled goes to a folder of its own instead of beside the modules, and goes with the tests.
    _compiled = tempfile.TemporaryDirectory(prefix="relocbench-tests-")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix = _compiled.name
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts a job in the background so, and Python leaves it so; the tests press Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_unconfigure() -> None:
    """Remove what was compiled."""
    if _compiled is not None:
        _compiled.cleanup()


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


@pytest.fixture(scope="module")
def workers_kept() -> Iterator[None]:
    """Worker processes that live go on from test to test: a fresh one takes seconds to import what it works with.

    A test that needs processes of its own runs what starts them by ``contextvars.Context().run``.
    """
    from relocbench.execution import kept_workers

    with kept_workers():
        yield


LONGEST = (
    "test_tutorials.py",
    "test_method_limits.py",
    "test_importer_robotcar.py",
    "test_cheats.py",
    "test_synthetic_build.py",
    "test_site.py",
    "test_groundtruth_graph.py",
    "test_importer_lidar_kinds.py",
    "test_feature_pnp_real.py",
    "test_groundtruth_submaps.py",
    "test_real_clouds.py",
    "test_lpn_network.py",
    "test_json.py",
    "test_groundtruth_registration.py",
    "test_probe.py",
    "test_groundtruth_registration_real.py",
    "test_train_command.py",
    "test_html_set_page.py",
    "test_html_other_tasks.py",
    "test_html_site.py",
    "test_gn_net_training.py",
    "test_cli.py",
    "test_published_sets.py",
    "test_feature_pnp.py",
    "test_synthetic_field.py",
    "test_light_install.py",
    "test_system_refusals.py",
    "test_importer_photographs.py",
    "test_synthetic_truth.py",
    "test_inspect.py",
    "test_retrieval_metrics.py",
    "test_cluster.py",
    "test_groundtruth_inspect.py",
    "test_synthetic_recording.py",
    "test_importer_tum.py",
    "test_lpn_rendered.py",
    "test_cross_view_rendered.py",
    "test_forgers.py",
    "test_validate.py",
    "test_lidar_odometry.py",
    "test_importer_kitti.py",
    "test_evaluation.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Quick tests first; beside other processes the files that take longest first, so that none is left alone with one
    at the end."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))
    else:
        items.sort(key=lambda item: item.get_closest_marker("slow") is not None)

"""Builds on a cluster, one of whose workers is killed in the middle, write the bytes of builds by local workers."""

from __future__ import annotations

from pathlib import Path

import pytest
from cluster_kills import OnCluster, differing, on_a_cluster
from command_line import relocbench
from robotcar_street import record_robotcar

from relocbench.execution import cluster, scheduler

pytest.importorskip("distributed")
pytestmark = pytest.mark.thorough
SMALL = ("--submap", 30, "--keyframe-distance", 1.5, "--query-distance", 3, "--max-distance", 3, "--matcher", "fgr")


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with much else to do takes long to start workers."""
    monkeypatch.setattr(cluster, "WORKER_TIMEOUT_S", 120.0)
    monkeypatch.setattr(scheduler, "SCHEDULER_TIMEOUT", "120s")


def test_ground_truth_on_a_cluster_whose_worker_is_killed_has_the_bytes_of_local_workers(tmp_path: Path) -> None:
    """The worker dies when it has registered two nodes of a drive; the other one goes on from its journal."""
    folders = [
        record_robotcar(tmp_path / "recording", number, condition, cameras=()).folder
        for number, condition in enumerate(("Sunny", "Overcast"))
    ]
    command = ["build-dataset", "robotcar", *folders, *SMALL, "--quiet"]
    assert relocbench(*command, "-j", 1, "-o", tmp_path / "local").status == 0
    ended = on_a_cluster([*command, "-o", tmp_path / "out"], r"\.journal$", 2, "append", tmp_path / "cluster")
    assert_one_died(ended)
    assert differing(tmp_path / "local", tmp_path / "out") == []


def test_images_rendered_on_a_cluster_whose_worker_is_killed_have_the_bytes_of_local_workers(tmp_path: Path) -> None:
    command = ["build-dataset", "synthetic", "--preset", "smoke", "--size", "48x36", "--quiet"]
    assert relocbench(*command, "-j", 1, "-o", tmp_path / "local").status == 0
    pattern = r"/images/.*\.png$"
    ended = on_a_cluster([*command, "-o", tmp_path / "out"], pattern, 3, "rename", tmp_path / "cluster")
    assert_one_died(ended)
    assert differing(tmp_path / "local", tmp_path / "out") == []


def assert_one_died(ended: OnCluster) -> None:
    assert ended.outcome.status == 0, ended.outcome.err
    assert ended.landed is not None
    assert ended.left == 1

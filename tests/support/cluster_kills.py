"""Jobs on a Dask cluster, one of whose workers is killed in the middle: ``from cluster_kills import on_a_cluster``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from command_line import Outcome, relocbench
from dask_processes import DaskProcesses
from kill_campaign import contents
from killing import Fault, fault_environment


@dataclass(frozen=True)
class OnCluster:
    """How a job on a cluster ended."""

    outcome: Outcome
    landed: dict[str, Any] | None
    """the event at which a worker died; None if the job ended before it"""
    left: int
    """workers that were left at the end"""


def on_a_cluster(command: Sequence[object], path: str, count: int, event: str, folder: Path) -> OnCluster:
    """Run a command on a cluster of two workers without nannies, one of which is killed (SIGKILL) at a point.

    Args:
        command: the words after ``relocbench``.
        path: regular expression of the files at which events count.
        count: the worker that comes to the ``count``-th event dies before it takes effect.
        event: see ``fault_points/sitecustomize.py``.
        folder: for the scheduler's file and log; made.
    """
    folder.mkdir(parents=True)
    trace = folder / "trace"
    processes = DaskProcesses(folder, environment=fault_environment(Fault(path, count, (event,), dies="worker"), trace))
    try:
        processes.add_workers(2)
        outcome = relocbench(*command, "--scheduler", processes.file)
        landed = trace / "landed.json"
        return OnCluster(outcome, json.loads(landed.read_text()) if landed.exists() else None, processes.alive)
    finally:
        processes.close()


def differing(one: Path, other: Path) -> list[str]:
    """Names of files that are not the same in two folders, byte by byte, or that are in one of them only."""
    a, b = dict(contents(one)), dict(contents(other))
    return sorted(name for name in a.keys() | b.keys() if a.get(name) != b.get(name))

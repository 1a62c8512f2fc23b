"""Jobs that are killed at a point that they reach: ``from killing import Fault, run_until_killed``.

A test that sleeps and then kills asks how fast the machine is. Here the job itself, in whichever of its processes,
counts what it does to files and sends the signal at the event that was asked for
(``fault_points/sitecustomize.py``).
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

FAULT_POINTS = Path(__file__).parent / "fault_points"
EVENTS = ("write", "rename", "append", "remove")
LONGEST_S = 3000.0
"""far more than a job takes on a machine that is ten times busier; only a hang gets there"""
WAIT_S = 300.0
"""far more than what happens at once takes on such a machine"""


@dataclass(frozen=True)
class Fault:
    """The ``count``-th of these events at files whose path matches is fatal; 0: events are counted only."""

    path: str
    """regular expression, searched in the whole path"""
    count: int
    events: tuple[str, ...] = ("rename",)
    dies: Literal["all", "main", "worker"] = "all"
    """the job with all that descends from it, the process that was started alone, or the worker that reached the
    point"""


@dataclass(frozen=True)
class Ended:
    """How a job with a fault point ended."""

    status: int
    """of the process that was started; ``-signal.SIGKILL`` when it was killed"""
    landed: Mapping[str, Any] | None
    """the event that was fatal; None when the job ended before it"""
    events: tuple[Mapping[str, Any], ...]
    """those that were counted, in their order"""
    stderr: str


def fault_environment(fault: Fault, trace: Path) -> dict[str, str]:
    """The variables that give a Python process, and those that it starts, a fault point.

    Args:
        trace: folder for what is counted; made, and must not exist.
    """
    trace.mkdir(parents=True)
    return {
        "PYTHONPATH": os.pathsep.join([str(FAULT_POINTS), *(path for path in sys.path if path)]),
        "FAULT_POINT": json.dumps({**asdict(fault), "trace": str(trace.resolve())}),
    }


def run_with_fault(command: Sequence[object], fault: Fault, trace: Path, **environment: str) -> Ended:
    """Run a command, with the importable paths of this process, to its end or to its fault point.

    All processes of the job have ended on return.

    Args:
        command: program and arguments; ``"python"`` in front is this interpreter.
        trace: folder for what is counted; made, and must not exist.
        environment: variables that are added.

    Raises:
        subprocess.TimeoutExpired: the job hangs.
    """
    words = [sys.executable if word == "python" else str(word) for word in command]
    variables = {**os.environ, **fault_environment(fault, trace), **environment}
    with (
        (trace / "stderr").open("wb") as errors,
        subprocess.Popen(
            words, env=variables, stdin=subprocess.DEVNULL, stdout=errors, stderr=errors, start_new_session=True
        ) as job,
    ):
        try:
            status = job.wait(LONGEST_S)
            _wait_for_all(variables["FAULT_POINT"])
        except BaseException:
            _kill_all(variables["FAULT_POINT"])
            raise
    landed = trace / "landed.json"
    events = trace / "events.jsonl"
    return Ended(
        status,
        json.loads(landed.read_text()) if landed.exists() else None,
        tuple(map(json.loads, events.read_text().splitlines())) if events.exists() else (),
        (trace / "stderr").read_text(errors="replace"),
    )


def run_until_killed(command: Sequence[object], fault: Fault, trace: Path, **environment: str) -> Ended:
    """As :func:`run_with_fault`, for a kill of the whole job or its first process that must land."""
    ended = run_with_fault(command, fault, trace, **environment)
    assert ended.landed is not None, f"{fault} was not reached; {len(ended.events)} events\n{ended.stderr}"
    assert ended.status == -signal.SIGKILL, ended.stderr
    return ended


def _wait_for_all(fault_point: str) -> None:
    """Wait for workers that end by themselves once their job was killed."""
    until = time.monotonic() + LONGEST_S
    while running := _running(fault_point):
        if time.monotonic() > until:
            raise subprocess.TimeoutExpired(f"processes {running}", LONGEST_S)
        time.sleep(0.01)


def _kill_all(fault_point: str) -> None:
    for process in _running(fault_point):
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
    _wait_for_all(fault_point)


def _running(fault_point: str) -> list[int]:
    """Processes of a job, wherever they have gone: they all have its variable, which names a folder of its own.

    One that has ended, but that nobody waited for, has none any more.
    """
    entry = f"FAULT_POINT={fault_point}".encode()
    found = []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):  # it ended just now, or belongs to someone else
            if entry in environment.read_bytes().split(b"\0"):
                found.append(int(environment.parent.name))
    return found


def running_with(argument: str) -> list[Path]:
    """The processes that have an argument, by their folders of ``/proc``."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            if argument.encode() in path.read_bytes().split(b"\0"):
                found.append(path.parent)
    return found


def is_running(pid: int) -> bool:
    """A process that nobody waited for yet does not run any more."""
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False


def wait_until(true: Callable[[], bool], process: subprocess.Popen[str] | None = None) -> None:
    """Raises AssertionError where it does not come true in time, or the process ends before."""
    until = time.monotonic() + WAIT_S
    while not true():
        assert time.monotonic() < until
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.02)

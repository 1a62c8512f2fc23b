"""The second door: a tracker that is a program of its own, in any language, under any licence.

The program reads one JSON object a line on standard input and answers each with one on standard output:

========================================================================= =======================================
relocbench writes                                                          the program answers
========================================================================= =======================================
``{"type": "start", "protocol": 1}``                                       ``{"type": "ready"}``
``{"type": "reference", "key", "image", "camera", "depth", "points"}``     ``{"type": "ready"}``
``{"type": "query", "key", "image", "camera", "prior"}``                   ``{"type": "result", "pose", ...}``
``{"type": "stop"}``                                                       (ends)
========================================================================= =======================================

``docs/add-a-method.md`` describes the fields. Images and depth are files in a scratch folder that holds nothing
else: the program sees no ground truth.
"""

from __future__ import annotations

import json
import queue
import shlex
import shutil
import subprocess
import tempfile
import threading
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from relocbench.datasets.images import write_depth, write_image, write_points
from relocbench.datasets.pairfile import QUATERNION_TOLERANCE
from relocbench.errors import MethodError
from relocbench.geometry import transform_from_tq, transform_to_tq
from relocbench.tracking import Query, Reference, TrackResult

PROTOCOL = 1
_STDERR_TAIL = 300
_STOP_GRACE_S = 2.0


class _Broken(Exception):
    """The program ended, was too slow, or spoke nonsense; it is gone, and the message says why."""


@dataclass(frozen=True)
class _Sent:
    """A reference as the program is told of it."""

    message: dict[str, Any]
    scratch: tempfile.TemporaryDirectory[str]


class SubprocessTracker:
    """Speaks the line protocol with one program, started again after it broke.

    Args:
        command: the program and its arguments.
        time_limit_s: the longest that one answer may take; then the program is killed and the pair has failed.
        start_limit_s: the longest that the program may take until it is ready.

    Raises:
        MethodError: the program cannot be started at all.
    """

    def __init__(self, command: str, time_limit_s: float = 60.0, start_limit_s: float = 120.0) -> None:
        self.words = shlex.split(command)
        if not self.words or shutil.which(self.words[0]) is None:
            raise MethodError(f"no program '{self.words[0] if self.words else ''}' to run as subprocess:{command}")
        self.time_limit_s = time_limit_s
        self.start_limit_s = start_limit_s
        self._program: _Program | None = None
        self._told: _Sent | None = None

    def prepare(self, reference: Reference) -> _Sent:
        """Write the keyframe where the program can read it."""
        scratch = tempfile.TemporaryDirectory(prefix="relocbench-")
        folder = Path(scratch.name)
        write_image(folder / "reference.png", reference.image)
        message: dict[str, Any] = {
            "type": "reference",
            "key": reference.key,
            "image": str(folder / "reference.png"),
            "camera": reference.camera.to_dict(),
            "depth": None,
            "points": None,
        }
        if reference.depth is not None:
            write_depth(folder / "depth.png", reference.depth)
            message["depth"] = str(folder / "depth.png")
            message["depth_sigma"] = list(reference.depth_sigma)
        if reference.sparse_points is not None:
            write_points(folder / "points.csv", reference.sparse_points)
            message["points"] = str(folder / "points.csv")
        return _Sent(message, scratch)

    def track(self, reference: _Sent, query: Query, prior: NDArray[np.float64] | None = None) -> TrackResult:
        """One question, one answer; a program that breaks costs this pair alone."""
        image = Path(reference.scratch.name) / "query.png"
        write_image(image, query.image)
        message = {
            "type": "query",
            "key": query.key,
            "image": str(image),
            "camera": query.camera.to_dict(),
            "prior": None if prior is None else np.concatenate(transform_to_tq(prior)).tolist(),
        }
        try:
            program = self._ready_program(reference)
            return _result(program.ask(message, "result", self.time_limit_s))
        except _Broken as bad:
            self._forget()
            return TrackResult.failure(str(bad), status="error")

    def close(self) -> None:
        """End the program."""
        if self._program is not None:
            self._program.stop()
        self._forget()

    def _ready_program(self, reference: _Sent) -> _Program:
        if self._program is None:
            self._program = _Program(self.words)
            self._program.ask({"type": "start", "protocol": PROTOCOL}, "ready", self.start_limit_s)
        if self._told is not reference:
            self._program.ask(reference.message, "ready", self.time_limit_s)
            self._told = reference
        return self._program

    def _forget(self) -> None:
        if self._program is not None:
            self._program.kill()
        self._program, self._told = None, None


class _Program:
    """A running program; its lines are read by a thread, so that waiting for one can end."""

    def __init__(self, words: list[str]) -> None:
        # Threads that read pipes must not keep the program alive: the finalizer knows the process alone.
        try:
            self.process = subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                encoding="utf-8",
                errors="replace",
            )
        except OSError as bad:
            raise MethodError(f"cannot start '{words[0]}' ({bad.strerror})") from None
        self.lines: queue.Queue[str | None] = queue.Queue()
        self.complaints: list[str] = []
        self._finalizer = weakref.finalize(self, _end, self.process)
        threading.Thread(target=_read_lines, args=(self.process.stdout, self.lines.put), daemon=True).start()
        threading.Thread(target=_keep_tail, args=(self.process.stderr, self.complaints), daemon=True).start()

    def ask(self, message: dict[str, Any], expected: str, limit_s: float) -> dict[str, Any]:
        """Send one line and wait for the answer. Raises _Broken."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(message) + "\n")
            self.process.stdin.flush()
            line = self.lines.get(timeout=limit_s)
        except queue.Empty:
            raise _Broken(f"no answer to '{message['type']}' within {limit_s:g} s") from None
        except OSError:
            line = None
        if line is None:
            raise _Broken(self._obituary(str(message["type"])))
        try:
            answer = json.loads(line)
        except json.JSONDecodeError:
            raise _Broken(f"answered '{message['type']}' with '{line.strip()[:80]}', expected a JSON object") from None
        if not isinstance(answer, dict) or answer.get("type") != expected:
            raise _Broken(
                f"answered '{message['type']}' with {line.strip()[:80]}, expected an object of type '{expected}'"
            )
        return answer

    def stop(self) -> None:
        """Ask the program to end, and see that it does."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps({"type": "stop"}) + "\n")
            self.process.stdin.close()
            self.process.wait(_STOP_GRACE_S)
        except (OSError, subprocess.TimeoutExpired):
            self.kill()

    def kill(self) -> None:
        self._finalizer()

    def _obituary(self, asked: str) -> str:
        try:
            code: object = self.process.wait(_STOP_GRACE_S)
        except subprocess.TimeoutExpired:
            code = "unknown"
        last = " ".join("".join(self.complaints).split())[-_STDERR_TAIL:]
        return f"the program ended (exit status {code}) when asked '{asked}'" + (f": {last}" if last else "")


def subprocess_tracker(command: str) -> Callable[..., SubprocessTracker]:
    """What makes trackers of a command line; its keyword arguments are the method's parameters."""

    def create(
        time_limit_s: Annotated[float, Field(gt=0)] = 60.0, start_limit_s: Annotated[float, Field(gt=0)] = 120.0
    ) -> SubprocessTracker:
        return SubprocessTracker(command, time_limit_s, start_limit_s)

    return create


def _result(answer: dict[str, Any]) -> TrackResult:
    """The pose of a ``result`` line. Raises _Broken where it is none."""
    pose, confidence = answer.get("pose"), answer.get("confidence")
    info = answer.get("info") or {}
    if not isinstance(info, dict) or not (confidence is None or isinstance(confidence, int | float)):
        raise _Broken("'info' must be an object and 'confidence' a number or null")
    message = str(answer.get("message", ""))
    if pose is None:
        return TrackResult(None, confidence, message or "the program reports a failure", info)
    values = np.array(pose, dtype=np.float64) if _is_numbers(pose) else np.zeros(0)
    if values.shape != (7,) or not np.all(np.isfinite(values)):
        raise _Broken(f"'pose' is {str(pose)[:80]}, expected seven finite numbers tx ty tz qx qy qz qw, or null")
    if abs(np.linalg.norm(values[3:]) - 1.0) > QUATERNION_TOLERANCE:
        raise _Broken(f"quaternion qx qy qz qw has norm {np.linalg.norm(values[3:]):.6g}, expected 1")
    return TrackResult(transform_from_tq(values[:3], values[3:]), confidence, message, info)


def _is_numbers(values: Any) -> bool:
    return isinstance(values, list) and all(isinstance(v, int | float) for v in values)


def _read_lines(stream: Any, put: Callable[[str | None], None]) -> None:
    for line in stream:
        put(line)
    put(None)


def _keep_tail(stream: Any, tail: list[str]) -> None:
    for line in stream:
        tail.append(line)
        del tail[:-20]


def _end(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()

"""A tracker in a process of its own, which is handed images, cameras and depth and nothing else.

A method that looks around in its process (the stack, the garbage collector, open files, arguments) finds what the
contract of trackers shows it, and no dataset, no truth and no folder of results. ``docs/blind-protocol.md`` says what
this does not prevent.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
import weakref
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import MethodError, RelocbenchError, one_line
from relocbench.evaluation.common.answers import CheckedAnswer, checked_answer, checked_pixels, error_answer
from relocbench.evaluation.common.framing import FramingFault, receive_answer, send_question
from relocbench.evaluation.common.handles import Declared
from relocbench.execution import end_descendants
from relocbench.methods import MethodSpec
from relocbench.tracking import Query, Reference, TrackResult

Array = NDArray[np.float64]

_ENDING_S = 1.0
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[3]); "
    "from relocbench.evaluation.common.isolated_process import main; main(int(sys.argv[1]), int(sys.argv[2]))"
)


class IsolatedTracker:
    """A tracker in a child process; it answers only to this object.

    If the child dies, this process ends in the same way: whoever watches over it then learns how the method ended.

    Raises:
        MethodError: the tracker cannot be made.
    """

    def __init__(self, spec: MethodSpec) -> None:
        self._connection, theirs = socket.socketpair()
        words = [sys.executable, "-c", _START, str(theirs.fileno()), str(os.getpid()), json.dumps(sys.path)]
        with theirs:
            self._process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=sys.__stderr__, pass_fds=(theirs.fileno(),)
            )
        self._finalizer = weakref.finalize(self, _end, self._process, self._connection)
        told, _ = self._exchange(spec)
        if "fault" in told:
            self.close()
            raise MethodError(one_line(told["fault"], 2000))
        self.declared = _declared(told.get("declared"))

    def prepare(self, keyframe: Reference) -> str | None:
        return _broke(self._exchange(("prepare", (keyframe,)))[0])

    def ask(
        self, views: Sequence[Query], priors: Sequence[Array | None] | None = None
    ) -> tuple[list[CheckedAnswer], float]:
        different = list({id(view): view for view in views}.values())
        places = {id(view): place for place, view in enumerate(different)}
        self._exchange(("show", (different,)))
        start = time.perf_counter()
        told, poses = self._exchange(
            ("ask", ([places[id(view)] for view in views], None if priors is None else list(priors)))
        )
        seconds = time.perf_counter() - start
        return _answers(told, poses, len(views)), seconds

    def match(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[Array | None, str | None]:
        self._exchange(("show", ([query],)))
        told, ends = self._exchange(("match", (uv_ref, uv_start)))
        return checked_pixels(ends[0] if ends else None, _broke(told), len(uv_ref))

    def match_levels(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[list[Array], str | None]:
        self._exchange(("show", ([query],)))
        told, levels = self._exchange(("match_levels", (uv_ref, uv_start)))
        found, broke = [], _broke(told)
        for ends in levels:
            pixels, fault = checked_pixels(ends, None, len(uv_ref))
            if pixels is None:
                return [], fault
            found.append(pixels)
        return found, broke

    def close(self) -> None:
        """End the process."""
        self._finalizer()

    def _exchange(self, question: Any) -> tuple[Any, list[Array]]:
        try:
            with suppress(BrokenPipeError, ConnectionResetError):  # what it had answered before is read below
                send_question(self._connection, question)
            return receive_answer(self._connection, lambda: self._process.poll() is None)
        except (EOFError, OSError):
            self._die_like_the_method()
        except FramingFault as bad:
            self.close()
            raise RelocbenchError(f"the process of the method sent no answer of relocbench's: {bad}") from None

    def _die_like_the_method(self) -> NoReturn:
        """End this process as the method has ended its own: by the same signal, or with the same status."""
        try:
            code = self._process.wait(_ENDING_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        end_descendants()
        if code < 0:
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            if -code != signal.SIGKILL:
                signal.signal(-code, signal.SIG_DFL)
            os.kill(os.getpid(), -code)
            time.sleep(_ENDING_S)  # a signal may be delivered a moment later
        os._exit(max(code, 0))


def _answers(told: Any, poses: list[Array], count: int) -> list[CheckedAnswer]:
    """The answers as they are after the same checks as in the method's process, where a method may have undone them."""
    if not isinstance(told, list) or len(told) != count:
        return [error_answer(f"{_FORGED}: not {count} answers")] * count
    left = iter(poses)
    return [checked_answer(_result(each, left)) for each in told]


_FORGED = "the method's process sent something else than answers"


def _result(told: Any, poses: Any) -> object:
    try:
        pose = next(poses) if told["posed"] else None
        return TrackResult(pose, told["confidence"], told["message"], json.loads(told["info"]))
    except (KeyError, TypeError, ValueError, StopIteration, RecursionError):
        return TrackResult.failure(_FORGED, status="error")


def _declared(told: Any) -> Declared:
    try:
        declared = Declared(**told)
        return Declared(
            bool(declared.batches),
            bool(declared.levels),
            max(0, int(declared.neighbours)),
            one_line(declared.neighbours_fault),
        )
    except (TypeError, ValueError):
        raise RelocbenchError(f"{_FORGED} when it started") from None


def _broke(told: Any) -> str | None:
    broke = told.get("broke") if isinstance(told, dict) else _FORGED
    return None if broke is None else one_line(broke)


def _end(process: subprocess.Popen[bytes], connection: socket.socket) -> None:
    connection.close()
    process.kill()
    process.wait()

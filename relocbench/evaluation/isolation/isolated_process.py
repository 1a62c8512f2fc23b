"""The process of a tracker: it is shown keyframes and queries, and answers; it holds no dataset and no truth.

Its only connection is a socket to the evaluator, over which it gets the method's specification, then images, cameras
and depth. It ends when the evaluator does.
"""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array
from relocbench.errors import RelocbenchError, raised
from relocbench.evaluation.isolation.answers import CheckedAnswer
from relocbench.evaluation.isolation.framing import receive_request, send_answer
from relocbench.evaluation.isolation.handles import LocalTracker
from relocbench.execution import pin_threads
from relocbench.methods import MethodSpec
from relocbench.tracking import Query, Reference

Arrays = Sequence[NDArray[np.floating]]


def main(descriptor: int) -> None:
    """Answer requests about a tracker from a socket, which the file descriptor names, until its other end is closed."""
    serve(descriptor, _made)


def serve(descriptor: int, make: Callable[[Any, Connection], tuple[object, dict[str, Any]]]) -> None:
    """Make a method and answer requests about it until the socket's other end is closed.

    Args:
        make: by what is sent first, which has the method's ``label``, returns an object whose methods are named as the
            requests, and what the method declares of itself.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pin_threads()
    connection = Connection(socket.socket(fileno=descriptor))
    try:
        spec = connection.request()
        try:
            handler, declared = make(spec, connection)
        except BaseException as bad:  # noqa: BLE001  the boundary to code that is not ours
            known = isinstance(bad, RelocbenchError)
            connection.answer({"fault": str(bad) if known else f"method '{spec.label}' cannot be made: {raised(bad)}"})
            return
        pin_threads()
        connection.answer({"declared": declared})
        while True:
            what, given = connection.request()
            answer: Callable[..., tuple[Any, Arrays]] = getattr(handler, what)
            connection.answer(*answer(*given))
    except (EOFError, OSError):
        os._exit(0)  # at once: libraries that a method has loaded may take seconds to tidy up


class Connection:
    """Questions and answers of this process alone: a child that a method forked and that returns here ends."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._pid, self._question = connection, os.getpid(), ""

    def request(self) -> Any:
        if os.getpid() != self._pid:
            os._exit(1)
        self._question, request = receive_request(self._connection)
        return request

    def answer(self, words: Any, arrays: Arrays = ()) -> None:
        if os.getpid() != self._pid:
            os._exit(1)
        send_answer(self._connection, self._question, words, arrays)


def _made(spec: MethodSpec, connection: Connection) -> tuple[object, dict[str, Any]]:
    tracker = LocalTracker(spec.create())
    return _RequestHandler(tracker), asdict(tracker.declared)


class _RequestHandler:
    """The requests of the protocol, by name."""

    def __init__(self, tracker: LocalTracker) -> None:
        self._tracker = tracker

    def prepare(self, keyframe: Reference) -> tuple[Any, Arrays]:
        crash = self._tracker.prepare(keyframe)
        return {"broke": crash, "batch": self._tracker.declared.batch}, []

    def ask(self, different: list[Query], order: list[int], priors: list[Array | None] | None) -> tuple[Any, Arrays]:
        """Answer one query for each place in ``order``, which may name a query several times, with several priors."""
        answers, _ = self._tracker.ask([different[index] for index in order], priors)
        poses = [answer.T_query_ref for answer in answers if answer.T_query_ref is not None]
        return {"answers": [_words(answer) for answer in answers], "batch": self._tracker.declared.batch}, poses

    def match(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[Any, Arrays]:
        ends, crash = self._tracker.match(query, uv_ref, uv_start)
        return {"broke": crash}, [] if ends is None else [ends]

    def match_levels(self, query: Query, uv_ref: Array, uv_start: Array) -> tuple[Any, Arrays]:
        levels, crash = self._tracker.match_levels(query, uv_ref, uv_start)
        return {"broke": crash}, levels


def _words(answer: CheckedAnswer) -> dict[str, Any]:
    return {
        "posed": answer.T_query_ref is not None,
        "confidence": answer.confidence,
        "message": answer.message,
        "info": answer.info,
    }

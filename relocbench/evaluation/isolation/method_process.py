"""The process of a method as the evaluator sees it: started, sent one request at a time, and ended.

A method that looks around in its process (the stack, the garbage collector, open files, arguments) finds what its
contract shows it, and no dataset, no truth and no folder of results. ``docs/blind-protocol.md`` says what this does
not prevent.
"""

from __future__ import annotations

import json
import os
import resource
import secrets
import signal
import socket
import subprocess
import sys
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from relocbench.errors import MethodError, one_line
from relocbench.evaluation.isolation.framing import FramingFault, receive_answer, send_request
from relocbench.execution import SIGNALLED, Sandbox, ScratchFolder, end_descendants, peak_resident_bytes, shared_folders
from relocbench.methods import MethodSpec, keeper

Arrays = list[NDArray[np.floating]]

FORGED = "the method's process sent something other than answers"
NEEDS = "needs"
"""key of an answer by which the method's process asks for something before it can answer"""
_ENDING_S = 1.0
_START = (
    "import importlib, json, sys; sys.path[:] = json.loads(sys.argv[3]); "
    "importlib.import_module(sys.argv[1]).main(int(sys.argv[2]))"
)


class MethodProcess:
    """A child process that holds one method and answers only to this object.

    Its home, caches and temporary files are in a folder of its own, which is removed with it.
    If the child dies, this process ends in the same way: whoever watches over it then learns how the method ended. If
    it sends what is no answer to the question, this process ends with the status ``EX_PROTOCOL``.

    Args:
        spec: the method, which the child makes: an object that can be pickled and has its ``label``.
        module: the module whose ``main`` the child runs.
        sandbox: where the child runs.

    Raises:
        MethodError: the method cannot be made.
    """

    def __init__(self, spec: Any, module: str, sandbox: Sandbox) -> None:
        self._connection, theirs = socket.socketpair()
        scratch = ScratchFolder()
        environment = scratch.environment()
        held, control = os.pipe()
        words = [sys.executable, "-c", _START, module, str(theirs.fileno()), json.dumps(sys.path)]
        self._sandboxed = sandbox.exists
        if not self._sandboxed:
            words = [sys.executable, "-I", "-S", str(keeper.__file__), str(held), str(os.getpid()), *words]
        trusted = isinstance(spec, MethodSpec) and spec.runs_only_our_code
        with theirs:
            self._process = replace(sandbox, hidden=(*sandbox.hidden, scratch.path.parent)).start(
                words,
                [scratch.path, *shared_folders(environment, kernels=trusted)],
                stdin=subprocess.DEVNULL,
                stdout=sys.__stderr__,
                pass_fds=(theirs.fileno(), held),
                env=environment,
            )
        os.close(held)
        self._finalizer = weakref.finalize(self, _end, self._process, self._connection, control, scratch)
        answer, _ = self.ask(spec)
        if not isinstance(answer, dict) or not isinstance(answer.get("declared"), dict):
            self.close()
            fault = answer.get("fault") if isinstance(answer, dict) else None
            fault = fault if isinstance(fault, str) else f"method '{spec.label}': {FORGED}"
            raise MethodError(one_line(fault, 2000))
        self.declared: dict[str, Any] = answer["declared"]
        """what the method declares of itself, as plain values that are not checked"""

    def ask(self, request: Any, needed: Callable[[Any], Any] | None = None) -> tuple[Any, Arrays]:
        """Send a request and wait for the answer.

        Args:
            request: any object that can be pickled.
            needed: returns what the child needs meanwhile, by what it names.

        Raises:
            Exception: whatever ``needed`` raises; the child is then ended.
        """
        try:
            question = self._send(request)
            while True:
                answer, arrays = receive_answer(self._connection, question, lambda: self._process.poll() is None)
                if needed is None or not isinstance(answer, dict) or NEEDS not in answer:
                    return answer, arrays
                question = self._send(self._needed(needed, answer[NEEDS]))
        except (EOFError, OSError):
            self._die_like_the_method()
        except FramingFault:
            self.close()
            end_descendants()
            os._exit(os.EX_PROTOCOL)

    @property
    def peak_memory_bytes(self) -> int | None:
        """The most resident memory of the method's process and its children so far; None where it is not told."""
        return peak_resident_bytes(self._process.pid, launchers=1 if self._sandboxed else 0)

    def close(self) -> None:
        """End the process."""
        self._finalizer()

    def _send(self, request: Any) -> str:
        """Send a request under a number that the child cannot have known before; returns it."""
        question = secrets.token_hex(8)
        with suppress(BrokenPipeError, ConnectionResetError):  # what it has answered before is still to be read
            send_request(self._connection, question, request)
        return question

    def _needed(self, needed: Callable[[Any], Any], named: Any) -> Any:
        try:
            return needed(named)
        except BaseException:
            self.close()
            raise

    def _die_like_the_method(self) -> NoReturn:
        """End this process as the method has ended its own: by the same signal, or with the same status."""
        try:
            code = self._process.wait(_ENDING_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        end_descendants()
        if self._sandboxed and code > SIGNALLED:
            code = SIGNALLED - code
        if code < 0:
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            if -code != signal.SIGKILL:
                signal.signal(-code, signal.SIG_DFL)
            os.kill(os.getpid(), -code)
            time.sleep(_ENDING_S)  # a signal may be delivered a moment later
        os._exit(max(code, 0))


def crash_of(answer: Any) -> str | None:
    """How the method crashed, of an answer that says so under ``broke``."""
    crash = answer.get("broke") if isinstance(answer, dict) else FORGED
    return None if crash is None else one_line(crash)


def _end(process: subprocess.Popen[bytes], connection: socket.socket, control: int, scratch: ScratchFolder) -> None:
    connection.close()
    os.close(control)
    process.kill()
    process.wait()
    scratch.remove()

"""A program that answers requests in JSON lines: started, called within a time limit, ended with its descendants.

Nothing that it writes makes memory grow: a line has a limit, only the end of its messages is kept, and what it writes
without being asked stays in the pipe.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from relocbench.errors import one_line
from relocbench.methods import keeper

LINE_BYTES = 2**20
"""length of the longest answer that is read"""
_STDERR_BYTES = 4096
_STDERR_TAIL = 300
_QUOTED = 80
_MOST_DIGITS = 300
_STOP_GRACE_S = 2.0
_ENDING_S = 10.0


class ProgramFault(Exception):
    """The program ended, was too slow or broke the protocol, as the message says; its further output is meaningless."""


class Program:
    """A running program in a session of its own.

    Args:
        words: the program and its arguments.
        environment: its variables.

    Raises:
        OSError: no process can be started.
    """

    def __init__(self, words: list[str], environment: Mapping[str, str]) -> None:
        held, control = os.pipe()
        try:
            script = [sys.executable, "-I", "-S", str(Path(keeper.__file__)), str(held), str(os.getpid())]
            self._process = subprocess.Popen(
                [*script, *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                pass_fds=(held,),
                start_new_session=True,
                env=environment,
            )
        except OSError:
            os.close(control)
            raise
        finally:
            os.close(held)
        streams = (self._process.stdin, self._process.stdout, self._process.stderr)
        self._in, self._out, self._err = (stream.fileno() for stream in streams if stream is not None)
        os.set_blocking(self._in, False)
        self._open = {self._out, self._err}
        self._answers = bytearray()
        self._stderr_tail = b""
        self._asked = 0
        self._finalizer = weakref.finalize(self, _end, self._process, control)

    def ask(self, message: dict[str, Any], expected: str, limit_s: float) -> dict[str, Any]:
        """Send one line with a new ``id``, and wait for the answer with the same id.

        Raises:
            ProgramFault: no valid answer arrived within ``limit_s`` seconds.
        """
        self._asked += 1
        question = str(message["type"])
        line = self._answer_line({**message, "id": self._asked}, question, limit_s)
        answer = _parsed(line, question)
        if answer.get("type") != expected:
            raise ProgramFault(f"answered '{question}' with {_quoted(line)}, expected an object of type '{expected}'")
        token = answer.get("id")
        if type(token) is not int or token != self._asked:
            said = f"with the id {one_line(json.dumps(token), 40)}" if "id" in answer else "without an id"
            raise ProgramFault(f"answered '{question}' {said}, expected the id of the question, {self._asked}")
        return answer

    def stop(self) -> None:
        """Ask the program to end, and make sure that it does."""
        try:
            self._send(json.dumps({"type": "stop"}).encode() + b"\n", time.monotonic() + _STOP_GRACE_S)
            self._wait_for_end(time.monotonic() + _STOP_GRACE_S)
        except (OSError, ProgramFault):
            pass  # it has ended, or does not read its input
        self.kill()

    def kill(self) -> None:
        """End the program, and every process that it started."""
        self._finalizer()

    def _answer_line(self, message: dict[str, Any], question: str, limit_s: float) -> bytes:
        until = time.monotonic() + limit_s
        try:
            self._send(json.dumps(message).encode() + b"\n", until)
            while b"\n" not in self._answers:
                if len(self._answers) > LINE_BYTES:
                    raise ProgramFault(
                        f"answered '{question}' with more than {LINE_BYTES} bytes without an end of line"
                    )
                if self._out not in self._open:
                    raise BrokenPipeError
                if not self._wait_for_output(until):
                    raise ProgramFault(f"no answer to '{question}' within {limit_s:g} s")
        except BlockingIOError:
            raise ProgramFault(f"does not read '{question}' within {limit_s:g} s") from None
        except OSError:
            raise ProgramFault(self._end_message(question)) from None
        line, _, rest = bytes(self._answers).partition(b"\n")
        if len(line) > LINE_BYTES:
            raise ProgramFault(f"answered '{question}' with {len(line)} bytes in a line, at most {LINE_BYTES} are read")
        self._answers = bytearray(rest)
        return line

    def _send(self, data: bytes, until: float) -> None:
        """Write all data. Raises BlockingIOError if it is not read in time, BrokenPipeError if the program is gone."""
        while data:
            try:
                data = data[os.write(self._in, data) :]
            except BlockingIOError:
                if not self._wait_for_output(until, writing=True):
                    raise

    def _wait_for_end(self, until: float) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        while self._open and self._wait_for_output(until):
            self._answers.clear()

    def _wait_for_output(self, until: float, writing: bool = False) -> bool:
        """Read available output, or wait for it; False when the time is over."""
        left = until - time.monotonic()
        if left <= 0:
            return False
        waiting = select.poll()
        for stream in self._open:
            waiting.register(stream, select.POLLIN)
        if writing:
            waiting.register(self._in, select.POLLOUT)
        ready = waiting.poll(1000 * min(left, 1e6))
        for stream, _ in ready:
            if stream == self._in:
                continue
            data = os.read(stream, 65536)
            if not data:
                self._open.discard(stream)
            elif stream == self._out:
                self._answers += data
            else:
                self._stderr_tail = (self._stderr_tail + data)[-_STDERR_BYTES:]
        return bool(ready)

    def _end_message(self, question: str) -> str:
        """The message for a program that ended, with the end of its standard error."""
        until = time.monotonic() + _STOP_GRACE_S
        while self._open and self._wait_for_output(until):
            self._answers.clear()
        try:
            code: object = self._process.wait(max(until - time.monotonic(), 0.1))
        except subprocess.TimeoutExpired:
            code = "unknown"
        words = one_line(self._stderr_tail.decode("utf-8", "replace"), _STDERR_BYTES)[-_STDERR_TAIL:]
        return f"the program ended (exit status {code}) when asked '{question}'" + (f": {words}" if words else "")


def _parsed(line: bytes, question: str) -> dict[str, Any]:
    """The JSON object in a line. Raises ProgramFault with what is wrong with it."""
    try:
        answer = json.loads(
            line.decode("utf-8"),
            object_pairs_hook=_object,
            parse_constant=_constant,
            parse_int=_integer,
        )
    except UnicodeDecodeError as bad:
        raise ProgramFault(
            f"answered '{question}' with text that is not UTF-8 (byte {bad.start} of the line)"
        ) from None
    except json.JSONDecodeError:
        raise ProgramFault(f"answered '{question}' with '{_quoted(line)}', expected a JSON object") from None
    except RecursionError:
        raise ProgramFault(f"answered '{question}' with JSON that is nested too deep") from None
    except ValueError as bad:
        raise ProgramFault(f"answered '{question}' with {bad}") from None
    if not isinstance(answer, dict):
        raise ProgramFault(f"answered '{question}' with {_quoted(line)}, expected a JSON object")
    return answer


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"a JSON object that has the key '{one_line(key, 40)}' twice")
        found[key] = value
    return found


def _constant(name: str) -> float:
    raise ValueError(f"{name}, which is not a number in JSON")


def _integer(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"an integer of {len(text.lstrip('-'))} digits")
    return int(text)


def _quoted(line: bytes) -> str:
    return one_line(line[: 4 * _QUOTED].decode("utf-8", "replace"), _QUOTED)


def _end(process: subprocess.Popen[bytes], control: int) -> None:
    """Close the keeper's pipe, upon which it ends all processes; if it does not end, kill its group."""
    os.close(control)
    try:
        process.wait(_ENDING_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    for stream in (process.stdin, process.stdout, process.stderr):
        if stream is not None:
            stream.close()

"""Readers with a fault each, which the harness has to find; they take the valid file and stumble over any other."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from fuzz.parser import Parser, Place, RefusedError
from relocbench.errors import DatasetError

VALID = b"a line that is right\n" * 3


def write_valid(root: Path) -> None:
    """One file."""
    (root / "file.txt").write_bytes(VALID)


def _stumbles(fault: Callable[[Place], Iterable[str] | None]) -> Callable[[Place], Iterable[str] | None]:
    def read(place: Place) -> Iterable[str] | None:
        target = place.target
        whole = target.is_file() and target.stat().st_size == len(VALID) and target.read_bytes() == VALID
        return None if whole else fault(place)

    return read


def _raises(_: Place) -> None:
    raise ValueError("no message for a user")


def _leaves(_: Place) -> None:
    raise SystemExit(3)


def _computes(_: Place) -> None:
    while True:
        pass


def _waits(_: Place) -> None:
    signal.pause()


def _dies(_: Place) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def _takes_memory(_: Place) -> None:
    np.ones(3 << 30, dtype=np.uint8)


def _says_two_lines(place: Place) -> None:
    raise RefusedError(f"{place.target}: one line\nand another")  # the project's own errors are one line


def _quotes(place: Place) -> None:
    raise RefusedError(f"{place.target}: {'x' * 300}")


def _tells_two_lines(_: Place) -> Iterable[str]:
    return ["one line\nand another"]


def _writes_beside(place: Place) -> None:
    (place.out.parent / "escaped").write_text("here\n")


def _changes(place: Place) -> None:
    (place.root / "note").write_text("was here\n")


def _refuses(place: Place) -> None:
    raise DatasetError("expected a line that is right", place.target, 1)


def _writes_out(place: Place) -> None:
    (place.out / "result").write_text("fine\n")


def _waits_for_its_child(_: Place) -> None:
    program = "import time\nwhile time.process_time() < 1.4: pass"
    subprocess.run([sys.executable, "-S", "-E", "-c", program], check=True)


SEEDS = {"valid": write_valid}
FAULTS = {
    "raises": (_raises, "traceback"),
    "leaves": (_leaves, "traceback"),
    "computes": (_computes, "hang"),
    "waits": (_waits, "hang"),
    "dies": (_dies, "death"),
    "takes-memory": (_takes_memory, "memory"),
    "says-two-lines": (_says_two_lines, "message"),
    "quotes": (_quotes, "message"),
    "tells-two-lines": (_tells_two_lines, "message"),
    "writes-beside": (_writes_beside, "wrote"),
    "changes": (_changes, "changed"),
    "refuses": (_refuses, "refused"),
    "writes-out": (_writes_out, "accepted"),
    "waits-for-its-child": (_waits_for_its_child, "accepted"),
}
"""name -> the fault, and what the harness is to call it"""
PARSERS = tuple(Parser(name, "valid", ("file.txt",), _stumbles(fault)) for name, (fault, _) in FAULTS.items())

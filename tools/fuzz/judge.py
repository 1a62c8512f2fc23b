"""What a reader made of one input, and whether it may.

Right is: it returns, or it raises a :class:`RelocbenchError` of one printable line that quotes little; nothing but its
output folder has changed.
"""

from __future__ import annotations

import errno
import os
import re
import time
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from fuzz.folders import difference, look
from fuzz.parser import Parser, Place, RefusedError
from relocbench.errors import RelocbenchError

ACCEPTED, REFUSED = "accepted", "refused"
FAULTS = ("traceback", "message", "wrote", "changed", "memory", "hang", "death", "seed")
"""an exception that is none of ours; a message of several lines, unprintable or long; a file written or changed where
none may be; too much memory; no end; the end of the process; valid files that were refused"""
MOST_MIB = 1024
_MOST_QUOTED = 200
_MOST_WORDS = 1500
_LONG_NAME = 100
_SURROUNDINGS = {
    getattr(errno, name)
    for name in ("EACCES", "EDQUOT", "EIO", "EISDIR", "ELOOP", "ENAMETOOLONG", "ENOSPC", "ENOTDIR", "EPERM", "EROFS")
}
"""what the system refuses, of which the command line makes one line"""


@dataclass(frozen=True)
class Verdict:
    """The outcome of one input."""

    kind: str
    """ACCEPTED, REFUSED or one of FAULTS"""
    where: str = ""
    """of a fault: what tells it from others, such as the place in the code"""
    detail: str = ""
    seconds: float = 0.0
    mib: float = 0.0

    @property
    def is_fault(self) -> bool:
        return self.kind in FAULTS


def judge(parser: Parser, place: Place, fences: Iterable[Path]) -> Verdict:
    """Let a parser read an input.

    Args:
        fences: folders in which nothing may change.
    """
    watched = [*fences] if parser.resumes else [place.root, *fences]
    before = {folder: look(folder) for folder in watched}
    start, resident = time.perf_counter(), _reset_peak()
    try:
        told = list(parser.read(place) or ())
        kind, where, detail = ACCEPTED, "", ""
    except RefusedError as refusal:
        kind, where, detail, told = REFUSED, "", "", [str(refusal)]
    except RelocbenchError as refusal:
        kind, where, detail, told = REFUSED, _location(refusal), "", [str(refusal)]
    except MemoryError as bad:
        kind, where, detail, told = "memory", _location(bad), _trace(bad), []
    except KeyboardInterrupt:
        raise
    except BaseException as bad:  # noqa: BLE001  whatever a reader raises is what is looked for
        if isinstance(bad, OSError) and bad.errno in _SURROUNDINGS:
            kind, where, detail, told = REFUSED, "", "", [str(bad.strerror)]
        else:
            kind, where, detail, told = "traceback", f"{type(bad).__name__} {_location(bad)}", _trace(bad), []
    seconds, mib = time.perf_counter() - start, _peak_mib(resident)
    if kind in (ACCEPTED, REFUSED):
        complaint = next((c for line in told if (c := _complaint(line, place))), "")
        if complaint:
            kind, detail = "message", complaint
            where = f"{complaint.split(':')[0]} {where}".strip()
        for folder in watched:
            changed = difference(before[folder], look(folder))
            if changed:
                kind = "changed" if folder == place.root else "wrote"
                where, detail = kind, changed
    if kind in (ACCEPTED, REFUSED) and mib > MOST_MIB:
        kind, where, detail = "memory", "peak", f"{mib:.0f} MiB at once"
    return Verdict(kind, where, detail, seconds, mib)


def _complaint(line: str, place: Place) -> str:
    """What is wrong with a line that a user is told; empty if nothing is."""
    said = line.replace(str(place.root), "").replace(str(place.out), "")
    for name in {path.name for path in place.root.rglob("*")}:  # the path of a file is said whole
        said = said.replace(name, "") if len(name) > _LONG_NAME else said
    if not all(c.isprintable() for c in said):
        return f"unprintable: {said[:300]!r}"
    if len(said) > _MOST_WORDS:
        return f"{'long'}: {len(said)} characters: {said[:300]!r}"
    if re.search(r"(.)\1{200}", said) or _quotes_too_much(said, place.target):
        return f"quotes too much: {said[:400]!r}"
    return ""


def _quotes_too_much(said: str, target: Path) -> bool:
    """Whether more than so many characters in a row are those of the file."""
    if len(said) <= _MOST_QUOTED:
        return False
    try:
        if not target.is_file() or target.stat().st_size > 4_000_000:
            return False
        foreign = target.read_bytes().decode("utf-8", "replace")
    except OSError:
        return False
    count = _MOST_QUOTED + 1
    return any(said[at : at + count] in foreign for at in range(len(said) - count + 1))


def _location(bad: BaseException) -> str:
    """Where in the project's code an exception came up: the innermost file, line and function of ours."""
    ours = [
        f
        for f in traceback.extract_tb(bad.__traceback__)
        if "/relocbench/" in f.filename or "/baselines/" in f.filename
    ]
    ours = [f for f in ours if "site-packages" not in f.filename]
    if not ours:
        return "outside"
    last = ours[-1]
    name = re.sub(r".*/((?:relocbench|baselines)/)", r"\1", last.filename)
    return f"{name}:{last.lineno} {last.name}"


def _trace(bad: BaseException) -> str:
    text = "".join(traceback.format_exception(type(bad), bad, bad.__traceback__, limit=-8))
    return text if len(text) < 6000 else f"{text[:3000]}\n...\n{text[-3000:]}"


def _reset_peak() -> float:
    """Start a new peak of resident memory; MiB that are resident now."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return -1.0
    return _resident("VmRSS")


def _peak_mib(resident: float) -> float:
    return max(_resident("VmHWM") - resident, 0.0) if resident >= 0 else 0.0


def _resident(name: str) -> float:
    descriptor = os.open("/proc/self/status", os.O_RDONLY)
    try:
        text = os.read(descriptor, 8192).decode()
    finally:
        os.close(descriptor)
    found = re.search(rf"{name}:\s+(\d+) kB", text)
    return int(found[1]) / 1024 if found else 0.0

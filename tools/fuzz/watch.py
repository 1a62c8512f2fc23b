"""Workers watched from outside: an input that hangs or kills its process costs that input, and is named."""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fuzz.case import Case
from fuzz.judge import Verdict

MOST_S = 5.0
"""of the processor's time, or of waiting for nothing"""
_OF_ALL = 3
"""so many times as much may be computed together with the processes that were started for it"""
_START_S = 120.0
"""the same for a process that loads its libraries"""
_ROOT = Path(__file__).parents[2]
_TICKS = os.sysconf("SC_CLK_TCK")
Tell = Callable[[Case, Verdict], None]


@dataclass
class Worker:
    """One worker process, started again after its death.

    Args:
        areas: of :class:`fuzz.catalogue.Catalogue`.
        seeds: the valid files of all parsers.
        scratch: a folder of its own.
        most_s: what an input may take.
    """

    areas: str
    seeds: Path
    scratch: Path
    most_s: float = MOST_S
    _process: subprocess.Popen[bytes] | None = None
    _report: int = -1
    _rest: bytes = b""
    _lines: list[bytes] = field(default_factory=list)

    def write_seeds(self, parsers: Sequence[str]) -> None:
        """Write the valid files of parsers; this process has then loaded most of what they are read with."""
        clock = _Clock(self._started().pid)
        self._ask({"write": list(parsers)})
        for line in self._told(clock):
            if line is None:
                raise AssertionError(f"valid files could not be written: {self._death(clock).detail}")
            if "done" in json.loads(line):
                return

    def work(self, parser: str, seed: int, first: int, count: int, tell: Tell) -> None:
        """Judge a stretch of inputs; ``tell`` gets each verdict. Number -1 are the valid files, if they are refused."""
        last = first + count
        while first < last:
            begun = self._stretch(parser, seed, first, last - first, tell)
            if begun is None:
                return
            first = max(begun + 1, first)
            if begun == -1:
                return

    def _stretch(self, parser: str, seed: int, first: int, count: int, tell: Tell) -> int | None:
        """The number of the input that the process died of; None where it did not."""
        clock = _Clock(self._started().pid)
        self._ask({"parser": parser, "seed": seed, "first": first, "count": count})
        begun = -1
        for line in self._told(clock):
            if line is None:
                tell(Case(parser, seed, begun), self._death(clock))
                return begun
            values = json.loads(line)
            if "done" in values:
                return None
            if "begin" in values:
                begun = values["begin"]
                clock.start(_START_S if begun == -1 else self.most_s)
            else:
                clock.start(_START_S)  # the next input is being made
                tell(Case(parser, seed, values.pop("end")), Verdict(**values))
        raise AssertionError("the worker said nothing more")

    def _ask(self, values: dict[str, object]) -> None:
        process = self._started()
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it is dead, which the end of its report says
            process.stdin.write(f"{json.dumps(values)}\n".encode())
            process.stdin.flush()

    def _told(self, clock: _Clock) -> Iterator[bytes | None]:
        """Lines of the worker's report; None when it is dead, or had to be killed."""
        while True:
            while self._lines:
                yield self._lines.pop(0)
            ready, _, _ = select.select([self._report], [], [], 0.25)
            if ready:
                data = os.read(self._report, 1 << 16)
                if not data:
                    yield None
                    return
                *lines, self._rest = (self._rest + data).split(b"\n")
                self._lines += lines
            elif clock.is_over():
                yield None
                return

    def _death(self, clock: _Clock) -> Verdict:
        """Say how the process ended, and see that it has."""
        assert self._process is not None
        if clock.over:
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGUSR1)  # it writes where it is
            time.sleep(0.3)
        code = self.close()
        text = self._log.read_text(errors="replace")
        frames = re.findall(r'File "[^"]*?((?:relocbench|baselines)/[^"]*)", line (\d+) in (\S+)', text)
        place = "{}:{} {}".format(*frames[0]) if frames else "outside"
        if clock.over:
            return Verdict("hang", place, f"{clock.over}\n{text[-3000:]}", clock.spent())
        return Verdict(
            "death", f"signal {-code} {place}" if code < 0 else f"status {code} {place}", text[-3000:], clock.spent()
        )

    @property
    def _log(self) -> Path:
        return self.scratch.with_suffix(".log")

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            read, write = os.pipe()
            environment = os.environ | {
                "PYTHONPATH": os.pathsep.join([str(_ROOT), str(_ROOT / "tools"), str(_ROOT / "tests" / "support")]),
                "PYTHONHASHSEED": "0",
                "OMP_NUM_THREADS": "1",
                "OPENBLAS_NUM_THREADS": "1",
                "COLUMNS": "200",
                "MALLOC_ARENA_MAX": "2",
            }
            with self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "fuzz.worker", self.areas, str(self.seeds), str(self.scratch), str(write)],
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=log,
                    pass_fds=[write],
                    env=environment,
                    start_new_session=True,
                )
            os.close(write)
            self._report, self._rest, self._lines = read, b"", []
        return self._process

    def close(self) -> int:
        """End the process and all that it started; its exit status, as far as it had one."""
        if self._process is None:
            return 0
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        if self._report >= 0:
            os.close(self._report)
            self._report = -1
        code, self._process = self._process.returncode, None
        return code


class _Clock:
    """How long an input has taken: its processor time, and the time for which it has waited for nothing.

    A process that a busy machine leaves without a processor is neither computing nor waiting; it is not held late.
    """

    def __init__(self, process: int) -> None:
        self._stat, self._process = Path(f"/proc/{process}/stat"), str(process)
        self.over = ""
        self._limit = _START_S
        self._began = self._last = time.monotonic()
        self._computed = self._used = self._idle = self._together = 0.0

    def start(self, limit_s: float) -> None:
        self._limit, self.over = limit_s, ""
        self._began = self._last = time.monotonic()
        self._idle = 0.0
        self._computed, _ = self._now()
        self._used = self._together = self._of_all()[0]

    def spent(self) -> float:
        return time.monotonic() - self._began

    def is_over(self) -> bool:
        now = time.monotonic()
        own, _ = self._now()
        used, sleeps = self._of_all()
        self._idle = self._idle + now - self._last if sleeps and used == self._used else 0.0
        self._last, self._used = now, used
        if own - self._computed > self._limit:
            self.over = f"computed for {own - self._computed:.1f} s"
        elif used - self._together > _OF_ALL * self._limit:
            self.over = f"computed for {used - self._together:.1f} s with the processes that it started"
        elif self._idle > self._limit:
            self.over = f"waited for {self._idle:.1f} s"
        return bool(self.over)

    def _now(self) -> tuple[float, bool]:
        """Seconds of the processor so far, and whether the process sleeps."""
        try:
            fields = self._stat.read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0, False
        return (int(fields[11]) + int(fields[12])) / _TICKS, fields[0] in "ST"

    def _of_all(self) -> tuple[float, bool]:
        """The same of the process and all that it started: who waits for one of them waits for something."""
        found: dict[str, list[str]] = {}
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):  # it ended meanwhile
                found[stat.parent.name] = stat.read_text().rpartition(")")[2].split()
        # Workers of a command have sessions of their own; what has lost its parent still has the session.
        family = {name for name, fields in found.items() if fields[3] == self._process}
        grown = True
        while grown:
            new = {name for name, fields in found.items() if fields[1] in family} - family
            grown, family = bool(new), family | new
        ticks = sum(int(field) for name in family for field in found[name][11:15])  # of those that ended as well
        return ticks / _TICKS, all(found[name][0] in "STZ" for name in family)

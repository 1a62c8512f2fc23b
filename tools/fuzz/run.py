"""Many inputs on several workers, what came of them, and the failing ones kept."""

from __future__ import annotations

import json
import queue
import shutil
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fuzz.case import Case, damage
from fuzz.catalogue import Catalogue
from fuzz.folders import copy_tree
from fuzz.judge import ACCEPTED, REFUSED, Verdict
from fuzz.parser import Parser
from fuzz.watch import MOST_S, Worker
from fuzz.worker import strangers, stretches

STRETCH = 25
"""inputs that a worker is asked for at once"""
_KEPT_OF_EACH = 3
_SAY_EVERY_S = 10.0


@dataclass
class Tally:
    """What came of the inputs of one parser."""

    outcomes: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    peak_mib: float = 0.0

    @property
    def inputs(self) -> int:
        return self.outcomes.total()

    @property
    def faults(self) -> int:
        return self.inputs - self.outcomes[ACCEPTED] - self.outcomes[REFUSED]


@dataclass
class Fault:
    """Inputs that one place of the code stumbles over."""

    kind: str
    where: str
    detail: str
    """of the first input"""
    parsers: Counter[str] = field(default_factory=Counter)
    cases: list[Case] = field(default_factory=list)
    """the first ones"""


@dataclass
class Outcome:
    """All of a run."""

    tallies: dict[str, Tally] = field(default_factory=dict)
    faults: dict[tuple[str, str], Fault] = field(default_factory=dict)
    seconds: float = 0.0

    def add(self, case: Case, verdict: Verdict) -> Fault | None:
        """Count a verdict; its fault, where there is one."""
        tally = self.tallies.setdefault(case.parser, Tally())
        tally.outcomes[verdict.kind] += 1
        if verdict.kind not in ("hang", "death"):
            tally.slowest_s = max(tally.slowest_s, verdict.seconds)
        tally.peak_mib = max(tally.peak_mib, verdict.mib)
        if not verdict.is_fault:
            return None
        fault = self.faults.setdefault(
            (verdict.kind, verdict.where), Fault(verdict.kind, verdict.where, verdict.detail)
        )
        fault.parsers[case.parser] += 1
        if len(fault.cases) < _KEPT_OF_EACH:
            fault.cases.append(case)
        return fault

    @property
    def total(self) -> int:
        return sum(tally.inputs for tally in self.tallies.values())

    @property
    def failed(self) -> int:
        return sum(tally.faults for tally in self.tallies.values())

    def table(self) -> str:
        """A line a parser."""
        head = (
            "parser",
            "inputs",
            "refused",
            "accepted",
            "tracebacks",
            "hangs",
            "deaths",
            "other",
            "slowest s",
            "peak MiB",
        )
        rows: list[tuple[str, ...]] = [head]
        for name, tally in sorted(self.tallies.items()):
            o = tally.outcomes
            other = tally.faults - o["traceback"] - o["hang"] - o["death"]
            numbers = (tally.inputs, o[REFUSED], o[ACCEPTED], o["traceback"], o["hang"], o["death"], other)
            rows.append((name, *map(str, numbers), f"{tally.slowest_s:.2f}", f"{tally.peak_mib:.0f}"))
        widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
        lines = [
            "  ".join(t.ljust(w) if i == 0 else t.rjust(w) for i, (t, w) in enumerate(zip(r, widths, strict=True)))
            for r in rows
        ]
        return "\n".join(lines)

    def summary(self) -> dict[str, Any]:
        """Plain values."""
        outcomes: Counter[str] = sum((t.outcomes for t in self.tallies.values()), Counter())
        return {
            "inputs": self.total,
            "refused": outcomes[REFUSED],
            "accepted": outcomes[ACCEPTED],
            "faults": {kind: n for kind, n in sorted(outcomes.items()) if kind not in (ACCEPTED, REFUSED)},
            "distinct_faults": len(self.faults),
            "parsers": len(self.tallies),
            "slowest_s": round(max((t.slowest_s for t in self.tallies.values()), default=0.0), 3),
            "peak_mib": round(max((t.peak_mib for t in self.tallies.values()), default=0.0)),
            "seconds": round(self.seconds, 1),
        }


def fuzz(
    known: Catalogue,
    seeds: Path,
    scratch: Path,
    parsers: Sequence[str],
    *,
    inputs: int,
    first: int = 0,
    seed: int = 0,
    jobs: int = 1,
    seconds: float | None = None,
    keep: Path | None = None,
    most_s: float = MOST_S,
    say: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Judge ``inputs`` inputs of each parser.

    Args:
        seeds: a folder for the valid files of the parsers; what is there is kept.
        scratch: a folder for the workers.
        first: number of the first input.
        seconds: no stretch of inputs is begun later.
        keep: a folder for failing inputs, three of each fault.
        most_s: what an input may take.
        say: is told how far it is.
    """
    outcome, lock, start = Outcome(), threading.Lock(), time.monotonic()
    work: queue.SimpleQueue[tuple[str, int, int]] = queue.SimpleQueue()
    for begin, count in stretches(inputs, STRETCH):
        for parser in parsers:
            work.put((parser, first + begin, count))
    scratch.mkdir(parents=True, exist_ok=True)
    workers = [Worker(known.areas, seeds, scratch / f"worker-{number}", most_s) for number in range(jobs)]
    workers[0].write_seeds(parsers)
    others = strangers(seeds)
    broken: list[BaseException] = []
    said = start

    def tell(case: Case, verdict: Verdict) -> None:
        nonlocal said
        with lock:
            fault = outcome.add(case, verdict)
            if fault is not None and keep is not None and case in fault.cases:
                keep_case(keep, known.parsers[case.parser], case, verdict, seeds, others)
            if time.monotonic() - said > _SAY_EVERY_S:
                said = time.monotonic()
                took = said - start
                say(f"{outcome.total} inputs, {outcome.failed} failed in {len(outcome.faults)} ways, {took:.0f} s")

    def serve(worker: Worker) -> None:
        try:
            while seconds is None or time.monotonic() - start < seconds:
                parser, begin, count = work.get_nowait()
                worker.work(parser, seed, begin, count, tell)
        except queue.Empty:
            pass
        except BaseException as bad:  # noqa: BLE001  of another thread
            broken.append(bad)
        finally:
            worker.close()

    threads = [threading.Thread(target=serve, args=(worker,)) for worker in workers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if broken:
        raise broken[0]
    outcome.seconds = time.monotonic() - start
    return outcome


def keep_case(folder: Path, parser: Parser, case: Case, verdict: Verdict, seeds: Path, others: list[bytes]) -> Path:
    """Keep an input whole, with what is needed to run it again."""
    kept = folder / f"{case.parser}-{case.seed}-{case.number}"
    shutil.rmtree(kept, ignore_errors=True)
    root = kept / "input"
    copy_tree(seeds / parser.seed, root)
    target = root
    if case.number >= 0:
        target = damage(parser, case, root, seeds / parser.seed, others, kept / "canary")
    about = {**asdict(case), "target": str(target.relative_to(root)), "kind": verdict.kind, "where": verdict.where}
    (kept / "case.json").write_text(json.dumps(about, indent=1) + "\n")
    (kept / "fault.txt").write_text(verdict.detail, errors="backslashreplace")
    return kept

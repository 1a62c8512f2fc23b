"""Kills jobs again and again at chosen points of their work, and compares what they leave with an undisturbed run.

``from kill_campaign import campaign``; ``benchmarks/truth/kills.py`` prints its table.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import yaml
from killing import EVENTS, Ended, Fault, run_with_fault

TIMED_COLUMNS = frozenset({"seconds"})
TIMED_KEYS = frozenset({"start", "end", "seconds", "hours", "median_seconds", "p95_seconds", "predictions"})
"""What the documentation names as different from one run to the next; ``predictions`` are digests of files with such a
column, which are compared themselves."""
MOST_KILLS_A_TREE = 5

Dies = Literal["all", "main", "worker"]


@dataclass(frozen=True)
class Job:
    """A command that can be killed and run again."""

    name: str
    command: Callable[[Path], Sequence[object]]
    """of the folder that it writes to"""
    has_workers: bool = True
    after: str = ""
    """regular expression of a file that must have its final name before the first kill of a tree: a checkpoint"""


@dataclass
class Outcome:
    """What the kills of a job came to."""

    job: str
    landed: int = 0
    resumptions: int = 0
    """runs that found another one's unfinished tree"""
    trees: int = 0
    differing: list[str] = field(default_factory=list)
    """files of a resumed tree that differ from the undisturbed one, are missing or too many"""
    broken: list[str] = field(default_factory=list)
    """runs that neither finished nor were killed by us, with what they said last"""
    died: Counter[str] = field(default_factory=Counter)
    """kills by who died"""
    at: Counter[str] = field(default_factory=Counter)
    """kills by event"""

    @property
    def right(self) -> bool:
        """Whether every tree was finished and is equal to the undisturbed one."""
        return not self.differing and not self.broken


def campaign(job: Job, kills: int, folder: Path, seed: int = 0) -> Outcome:
    """Kill a job ``kills`` times at seeded points of its work and resume it until it is done.

    A point is the number of an event that the undisturbed run reached as well: a write begun, a whole file not yet
    renamed, a line of a journal, a file about to be removed. A kill counts when the job wrote that it reached it.

    Args:
        folder: for the trees; made.
    """
    rng = np.random.default_rng([seed, *job.name.encode()])
    whole = folder / "whole"
    undisturbed = _run(job, whole, 0, "all", folder / "whole-trace")
    if undisturbed.status != 0:
        raise RuntimeError(f"{job.name} fails undisturbed: {undisturbed.stderr[-2000:]}")
    expected = dict(contents(whole))
    first = _first_point(job, undisturbed)
    outcome = Outcome(job.name)
    while outcome.landed < kills:
        out = folder / f"tree{outcome.trees}"
        _kill_and_resume(job, out, min(MOST_KILLS_A_TREE, kills - outcome.landed), undisturbed, first, rng, outcome)
        outcome.trees += 1
        found = dict(contents(out))
        outcome.differing += [
            f"{out.name}/{name}" for name in sorted(expected.keys() | found) if expected.get(name) != found.get(name)
        ]
        if not outcome.right:
            break
        shutil.rmtree(out)
    return outcome


def _first_point(job: Job, undisturbed: Ended) -> int:
    """The first event that may be fatal in a fresh tree."""
    for event in undisturbed.events:
        if job.after and event["event"] == "rename" and event["path"].endswith(job.after):
            return int(event["number"]) + 1
    return 1


def _kill_and_resume(
    job: Job, out: Path, most: int, undisturbed: Ended, first: int, rng: np.random.Generator, outcome: Outcome
) -> None:
    """Runs of one tree until one ends by itself."""
    total = len(undisturbed.events)
    in_workers = sum(not event["main"] for event in undisturbed.events)
    kills, run = 0, 0
    while True:
        choices: list[Dies] = ["all", "main", "worker"] if job.has_workers and in_workers else ["all"]
        dies = choices[int(rng.integers(len(choices)))]
        last = in_workers if dies == "worker" else total
        # A tree is killed several times: each time in the first part of what there was to do, as what is left shrinks.
        begin = min(first, last) if not run else 1
        count = int(rng.integers(begin, max(begin + 1, begin + (last - begin) // 2 + 1))) if kills < most else 0
        ended = _run(job, out, count, dies, out.with_name(f"{out.name}-trace{run}"))
        outcome.resumptions += run > 0
        run += 1
        if ended.landed is not None:
            kills += 1
            outcome.landed += 1
            outcome.died[dies] += 1
            outcome.at[ended.landed["event"]] += 1
        if ended.status == 0:
            return
        if ended.landed is None or dies == "worker":
            outcome.broken.append(f"{out.name} run {run}: status {ended.status}: {ended.stderr.strip()[-300:]}")
            return


def _run(job: Job, out: Path, count: int, dies: Dies, trace: Path) -> Ended:
    return run_with_fault(job.command(out), Fault(f"^{out.resolve()}/", count, EVENTS, dies), trace)


def contents(root: Path) -> Iterator[tuple[str, str]]:
    """Name and digest of each file under a folder, without what holds times, and without the folder's own name."""
    for path in sorted(root.rglob("*")):
        if path.is_symlink():
            yield str(path.relative_to(root)), f"-> {path.readlink()}"
        elif path.is_file():
            content = _without_times(path).replace(os.fsencode(root), b"OUT")
            yield str(path.relative_to(root)), hashlib.sha256(content).hexdigest()


def _without_times(path: Path) -> bytes:
    data = path.read_bytes()
    if path.suffix == ".csv":
        rows = csv.DictReader(io.StringIO(data.decode(), newline=""))
        return repr([[(k, v) for k, v in row.items() if k not in TIMED_COLUMNS] for row in rows]).encode()
    if path.suffix == ".yaml" and any(f"{key}:".encode() in data for key in TIMED_KEYS):
        return repr(_untimed(yaml.safe_load(data))).encode()
    if path.name == "MODEL_CARD.md":
        return b"".join(line for line in data.splitlines(True) if not line.startswith(b"| time |"))
    if path.suffix == ".pt":
        return repr(_untimed(_plain(torch.load(io.BytesIO(data), weights_only=True)))).encode()
    return data


def _plain(value: object) -> object:
    """What a checkpoint holds, its tensors as bytes."""
    if isinstance(value, torch.Tensor):
        return (str(value.dtype), tuple(value.shape), value.numpy().tobytes())
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return [_plain(inner) for inner in value] if isinstance(value, list | tuple) else value


def _untimed(value: object) -> object:
    if isinstance(value, dict):
        return {k: _untimed(v) for k, v in value.items() if k not in TIMED_KEYS}
    return [_untimed(v) for v in value] if isinstance(value, list) else value

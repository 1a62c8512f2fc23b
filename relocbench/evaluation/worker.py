"""What asking a method shares, whatever it is asked: units of work, and what a worker process keeps and writes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import IO, Any

from relocbench.datasets.dataset import Dataset, PairSet, Traversal
from relocbench.datasets.layout import DatasetLayout
from relocbench.datasets.pairfile import PairKey
from relocbench.execution import chunks
from relocbench.files import read_journal
from relocbench.methods import MethodSpec
from relocbench.tracking import Reference, SupportsPrepare

_PAIRS_A_UNIT = 16


@dataclass(frozen=True)
class Unit:
    """Some pairs of one reference, for one worker."""

    spec: MethodSpec
    dataset: Path
    reference: str
    query: str
    camera: str
    keys: tuple[PairKey, ...]
    journal: Path

    def __str__(self) -> str:
        return f"{self.spec.label} on {self.reference}__{self.query}__{self.camera}, pair {self.keys[0]}"


def units_of(
    dataset: Dataset, pair_set: PairSet, spec: MethodSpec, journal: Path, keys: Sequence[PairKey]
) -> list[Unit]:
    """Units that ask about the pairs of ``keys``, each of one reference."""
    ordered = sorted(keys)
    common = (spec, dataset.root.resolve(), pair_set.reference, pair_set.query, pair_set.camera)
    return [
        Unit(*common, tuple(chunk), journal.resolve())
        for _, group in groupby(ordered, key=lambda key: key[0])
        for chunk in chunks(group, _PAIRS_A_UNIT)
    ]


def prepared(unit: Unit, tracker: Any) -> tuple[Any, str | None]:
    """The unit's keyframe as the tracker wants it, or why its ``prepare`` broke."""
    neighbours = int(getattr(tracker, "neighbours", 0))
    keyframe: Reference = traversal_of(unit.dataset, unit.reference).reference(unit.camera, unit.keys[0][0], neighbours)
    return guarded(lambda: tracker.prepare(keyframe)) if isinstance(tracker, SupportsPrepare) else (keyframe, None)


def guarded(call: Callable[[], Any]) -> tuple[Any, str | None]:
    """The value of a method's own code, or what it raised: a method's bug costs its pair only."""
    try:
        return call(), None
    except (Exception, SystemExit) as bad:  # noqa: BLE001  the boundary to code that is not ours
        return None, f"{type(bad).__name__}: {bad}"


def journal_entries(journal: Path) -> Iterator[dict[str, Any]]:
    """What workers have written so far, the pair of each as a tuple under ``key``."""
    if not journal.is_dir():
        return
    for path in sorted(journal.glob("*.jsonl")):
        for entry in read_journal(path):
            yield {**entry, "key": tuple(entry["key"])}


def open_journal(journal: Path) -> IO[str]:
    """A file of this process alone: two writers never meet, and a torn line is always a file's last."""
    return (journal / f"{time.time_ns()}-{os.getpid()}.jsonl").open("x", encoding="utf-8")


@cache
def traversal_of(dataset: Path, name: str) -> Traversal:
    """One a process."""
    return Traversal(DatasetLayout(dataset).traversal(name))


_trackers: dict[str, Any] = {}


def tracker_of(spec: MethodSpec) -> Any:
    """One tracker a process and specification; building it may load weights."""
    if repr(spec) not in _trackers:
        _trackers[repr(spec)] = spec.create()
    return _trackers[repr(spec)]

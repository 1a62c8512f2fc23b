"""Asking methods, pair by pair, in workers; what is known goes to a journal at once, so that a killed run goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from relocbench.datasets.correspondences import read_correspondences
from relocbench.datasets.dataset import Dataset, PairSet
from relocbench.datasets.layout import DatasetLayout, pair_set_name
from relocbench.datasets.pairfile import PairKey
from relocbench.datasets.writer import versions
from relocbench.errors import PredictionError
from relocbench.evaluation.probe.pixels import probe_pixels, with_structure
from relocbench.evaluation.probe.poses import probe_poses
from relocbench.evaluation.probe.tally import Tally
from relocbench.evaluation.worker import (
    Unit,
    journal_entries,
    open_journal,
    prepared,
    tracker_of,
    traversal_of,
    units_of,
)
from relocbench.execution import default_workers, run_units
from relocbench.files import alone_in, sha256_file
from relocbench.methods import SUBPROCESS, MethodSpec, distribution_version, method_class
from relocbench.progress import Reporter

Asked = Sequence[tuple[PairSet, Sequence[PairKey]]]


@dataclass(frozen=True)
class Task:
    """What every pair is asked."""

    pixels: bool
    poses: bool
    per_pair: int
    structured: float
    directions: int
    seed: int


@dataclass(frozen=True)
class ProbeUnit:
    """Some pairs of one reference, for one worker."""

    unit: Unit
    task: Task

    def __str__(self) -> str:
        return str(self.unit)


@dataclass(frozen=True)
class Answered:
    """What came of one pair."""

    tallies: tuple[Tally, ...]
    message: str
    """how the method broke; empty if it did not"""


def task_for(spec: MethodSpec, wanted: Task) -> Task:
    """What of the wanted a method can be asked: pixels where it has ``match``, poses where it starts from a prior.

    Raises:
        MethodError: no such method.
    """
    can_match, can_start = _offers(spec)
    return replace(wanted, pixels=wanted.pixels and can_match, poses=wanted.poses and can_start)


def ask_pairs(
    dataset: Dataset,
    asked: Asked,
    spec: MethodSpec,
    task: Task,
    folder: Path,
    *,
    workers: int | None,
    scheduler: str | None,
    reporter: Reporter,
) -> dict[tuple[str, PairKey], Answered]:
    """By pair set and pair. What ``folder`` knows of the same method, dataset and task is not asked again.

    Raises:
        PredictionError: another process is writing to the folder.
        DatasetError: an image or a correspondence file is bad.
    """
    root = folder / f"{spec.label}-{_digest(dataset, spec, task)}"
    journals = {pair_set.name: root / pair_set.name for pair_set, _ in asked}
    for journal in journals.values():
        journal.mkdir(parents=True, exist_ok=True)
    with (
        alone_in(root, PredictionError),
        reporter.stage(f"{spec.label} on {dataset.name}", _left(asked, journals)) as advance,
    ):
        while _left(asked, journals):
            units = [
                ProbeUnit(unit, task)
                for pair_set, keys in asked
                for unit in units_of(
                    dataset, pair_set, spec, journals[pair_set.name], _open(keys, journals[pair_set.name])
                )
            ]
            count = default_workers() if workers is None else workers
            for _, done in run_units(_probe_unit, units, workers=count, scheduler=scheduler, on_lost=_lose_one):
                advance(done)
    return {
        (pair_set.name, entry["key"]): Answered(tuple(map(Tally.from_dict, entry["tallies"])), entry["message"])
        for pair_set, keys in asked
        for entry in journal_entries(journals[pair_set.name])
        if entry["key"] in set(keys)
    }


def _offers(spec: MethodSpec) -> tuple[bool, bool]:
    """Whether a method has ``match``, and whether it starts from a prior."""
    target: Any = method_class(spec.target)
    if spec.target.startswith(SUBPROCESS) or not isinstance(target, type):
        target = spec.create()
    return callable(getattr(target, "match", None)), bool(getattr(target, "uses_prior", False))


def _digest(dataset: Dataset, spec: MethodSpec, task: Task) -> str:
    """Of all that an answer depends on: a file that a parameter names is known by its content."""
    about = {
        "dataset": dataset.fingerprint,
        "target": spec.target,
        "parameters": {k: [str(v), _content(v)] for k, v in spec.parameters.items()},
        "versions": {**versions(), "method": distribution_version(spec.target)},
        "task": repr(task),
    }
    return hashlib.sha256(json.dumps(about, sort_keys=True, default=str).encode()).hexdigest()[:12]


def _content(value: Any) -> str:
    return sha256_file(value) if isinstance(value, Path) and value.is_file() else ""


def _open(keys: Sequence[PairKey], journal: Path) -> list[PairKey]:
    done = {entry["key"] for entry in journal_entries(journal)}
    return [key for key in keys if key not in done]


def _left(asked: Asked, journals: dict[str, Path]) -> int:
    return sum(len(_open(keys, journals[pair_set.name])) for pair_set, keys in asked)


def _probe_unit(work: ProbeUnit) -> int:
    """Ask about the pairs of a unit; returns how many. Runs in a worker."""
    tracker = tracker_of(work.unit.spec)
    reference, broke = prepared(work.unit, tracker)
    with open_journal(work.unit.journal) as stream:
        for key in work.unit.keys:
            answered = _ask(work, key, tracker, None if broke else reference)
            stream.write(json.dumps(_entry(key, answered[0], broke or answered[1])) + "\n")
            stream.flush()
    return len(work.unit.keys)


def _ask(work: ProbeUnit, key: PairKey, tracker: Any, reference: Any) -> tuple[list[Tally], str]:
    unit, task = work.unit, work.task
    query = traversal_of(unit.dataset, unit.query).query(unit.camera, key[1])
    name = pair_set_name(unit.reference, unit.query, unit.camera)
    tallies: list[Tally] = []
    messages: list[str] = []
    correspondences = DatasetLayout(unit.dataset).correspondence_file(name)
    if task.pixels and correspondences.exists():
        image = traversal_of(unit.dataset, unit.reference).image(unit.camera, key[0])
        known = with_structure(read_correspondences(correspondences, key), image, task.structured)
        found, message = probe_pixels(tracker, reference, query, known, key, task.per_pair, task.seed)
        tallies, messages = tallies + found, [*messages, message]
    if task.poses:
        truth = _pair_set(unit.dataset, name).by_key[key].T_query_ref
        assert truth is not None
        found, message = probe_poses(tracker, reference, query, truth, key, task.directions, task.seed)
        tallies, messages = tallies + found, [*messages, message]
    return tallies, next(filter(None, messages), "")


@cache
def _pair_set(dataset: Path, name: str) -> PairSet:
    return PairSet(DatasetLayout(dataset), name)


def _entry(key: PairKey, tallies: list[Tally], message: str) -> dict[str, Any]:
    return {"key": list(key), "tallies": [t.to_dict() for t in tallies], "message": " ".join(message.split())[:500]}


def _lose_one(work: ProbeUnit) -> int:
    """A worker died twice on this unit: its first pair without a result is the one that kills."""
    done = {entry["key"] for entry in journal_entries(work.unit.journal)}
    culprit = next(key for key in work.unit.keys if key not in done)
    message = "the worker process died twice on this pair (out of memory, or a crash in native code)"
    with open_journal(work.unit.journal) as stream:
        stream.write(json.dumps(_entry(culprit, _ask(work, culprit, None, None)[0], message)) + "\n")
    return 1

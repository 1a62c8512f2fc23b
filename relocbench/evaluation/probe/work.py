"""Probing methods pair by pair in workers; each result is written to a journal at once, so that killed runs resume."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.core.writer import versions
from relocbench.errors import PredictionError, one_line
from relocbench.evaluation.isolation.capabilities import Capabilities
from relocbench.evaluation.isolation.handles import TrackerHandle
from relocbench.evaluation.isolation.journal import (
    answered_keys,
    append_entry,
    journal_entries,
    open_journal,
    write_entry,
)
from relocbench.evaluation.isolation.losses import LossHandler, run_until_answered
from relocbench.evaluation.isolation.worker import (
    Assignment,
    Unit,
    query_of,
    show_keyframe,
    tracker_of,
    traversal_of,
)
from relocbench.evaluation.probe.pixels import probe_pixels, with_structure
from relocbench.evaluation.probe.poses import OFFSETS, probe_poses
from relocbench.evaluation.probe.starts import probe_starts
from relocbench.evaluation.probe.tally import Tally
from relocbench.execution import MANY_TIMES, Run, step
from relocbench.files import locked_folder, sha256_file
from relocbench.methods import MethodSpec, distribution_version
from relocbench.progress import Reporter

ChosenPairs = Sequence[tuple[PairSet, Sequence[PairKey]]]


@dataclass(frozen=True)
class Task:
    """The tasks that are run on every pair. Its ``repr`` is part of the digest by which a probe resumes."""

    pixels: bool
    poses: bool
    most_pixels: int
    """of a pair, each started from one offset"""
    structured: float
    directions: int
    seed: int
    keyframe: bool = False
    """whether the start is the keyframe's pose, beside others as far away"""


@dataclass(frozen=True)
class ProbeUnit(Unit):
    """Some pairs of one reference, to be probed by one worker."""

    task: Task


@dataclass(frozen=True)
class PairResult:
    """The result of one pair."""

    tallies: tuple[Tally, ...]
    message: str
    """how the method crashed; empty if it did not"""


def task_for(capabilities: Capabilities, wanted: Task) -> Task:
    """The wanted questions that a method can answer: pixels if it has ``match``, poses if it uses priors."""
    return replace(
        wanted,
        pixels=wanted.pixels and capabilities.match,
        poses=wanted.poses and capabilities.prior,
        keyframe=wanted.keyframe and capabilities.prior,
    )


def ask_pairs(
    dataset: Dataset,
    asked: ChosenPairs,
    spec: MethodSpec,
    task: Task,
    folder: Path,
    *,
    run: Run,
    reporter: Reporter,
) -> dict[tuple[str, PairKey], PairResult]:
    """Results by pair set and pair. What ``folder`` holds for the same method, dataset and task is not run again.

    Raises:
        PredictionError: another process is writing to the folder.
        DatasetError: an image or a correspondence file is bad.
    """
    assigned = Assignment.of(dataset, spec, run.hiding(dataset.root, folder))
    root = folder / f"{spec.label}-{_digest(dataset, spec, task)}"
    journals = {pair_set.name: root / pair_set.name for pair_set, _ in asked}
    for journal in journals.values():
        journal.mkdir(parents=True, exist_ok=True)

    def open_units() -> list[ProbeUnit]:
        return [
            ProbeUnit(**vars(unit), task=task)
            for pair_set, keys in asked
            for journal in (journals[pair_set.name],)
            for unit in assigned.units(pair_set, journal, _open(keys, journal))
        ]

    with (
        locked_folder(root, PredictionError),
        reporter.stage(f"{spec.label} on {dataset.name}", _left(asked, journals)) as advance,
    ):
        run_until_answered(_probe_unit, open_units, LossHandler(_write_crash), assigned.run, advance)
    return {
        (pair_set.name, entry["key"]): PairResult(tuple(map(Tally.from_dict, entry["tallies"])), entry["message"])
        for pair_set, keys in asked
        for entry in journal_entries(journals[pair_set.name])
        if entry["key"] in set(keys)
    }


def _digest(dataset: Dataset, spec: MethodSpec, task: Task) -> str:
    """A digest of all that an answer depends on; a file that a parameter names enters by its content."""
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
    done = answered_keys(journal)
    return [key for key in keys if key not in done]


def _left(asked: ChosenPairs, journals: dict[str, Path]) -> int:
    return sum(len(_open(keys, journals[pair_set.name])) for pair_set, keys in asked)


def _probe_unit(unit: ProbeUnit) -> int:
    """Probe the pairs of a unit in a worker; returns their number."""
    tracker = tracker_of(unit)
    crash = show_keyframe(unit, tracker)
    with open_journal(unit.journal) as stream:
        for key in unit.keys:
            answered = _ask(unit, key, None if crash else tracker)
            write_entry(stream, _entry(key, answered[0], crash or answered[1]))
    return len(unit.keys)


def _ask(unit: ProbeUnit, key: PairKey, tracker: TrackerHandle | None) -> tuple[list[Tally], str]:
    task = unit.task
    query = query_of(unit, key)
    tallies: list[Tally] = []
    messages: list[str] = []
    correspondences = DatasetLayout(unit.dataset).correspondence_file(unit.pair_set)
    if task.pixels and correspondences.exists():
        from relocbench.datasets.pairs.correspondence_file import read_correspondences  # needs pyarrow

        image = traversal_of(unit.dataset, unit.reference).image(unit.reference_camera, key[0])
        known = with_structure(read_correspondences(correspondences, key), image, task.structured)
        with step("", (key,), MANY_TIMES):  # one call for the pixels, and one for each level
            found, message = probe_pixels(tracker, query, known, key, task.most_pixels, task.seed)
        tallies, messages = tallies + found, [*messages, message]
    truth = _pair_set(unit.dataset, unit.pair_set).by_key[key].T_query_ref
    if task.keyframe:
        assert truth is not None
        with step("", (key,), task.directions + 2):
            tally, message = probe_starts(tracker, query, truth, key, task.directions, task.seed)
        tallies, messages = [*tallies, tally], [*messages, message]
    if task.poses:
        assert truth is not None
        with step("", (key,), task.directions * sum(map(len, OFFSETS.values()))):
            found, message = probe_poses(tracker, query, truth, key, task.directions, task.seed)
        tallies, messages = tallies + found, [*messages, message]
    return tallies, next(filter(None, messages), "")


@cache
def _pair_set(dataset: Path, name: str) -> PairSet:
    return PairSet(DatasetLayout(dataset), name)


def _entry(key: PairKey, tallies: list[Tally], message: str) -> dict[str, Any]:
    return {"key": list(key), "tallies": [t.to_dict() for t in tallies], "message": one_line(message)}


def _write_crash(unit: ProbeUnit, key: PairKey, message: str) -> None:
    """Write the entry of a lost pair."""
    append_entry(unit.journal, _entry(key, _ask(unit, key, None)[0], message))

"""Running a probe of several methods on a dataset, and writing its results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import ConfigError
from relocbench.evaluation.common.foreign import blind_methods
from relocbench.evaluation.common.opening import open_for_evaluation
from relocbench.evaluation.common.options import ExecutionOptions
from relocbench.evaluation.common.results import first_crash
from relocbench.evaluation.common.runs import made_by, run_each
from relocbench.evaluation.isolation.capabilities import capabilities_of
from relocbench.evaluation.probe.feature_maps import Picture, draw, lost_picture, places_of
from relocbench.evaluation.probe.starts import StartLine
from relocbench.evaluation.probe.table import Line, result_lines, start_lines
from relocbench.evaluation.probe.work import PairResult, Task, ask_pairs, task_for
from relocbench.evaluation.probe.write import write_probe
from relocbench.execution import Run, kept_workers, run_limited
from relocbench.methods import MethodSpec
from relocbench.progress import Reporter


class ProbeOptions(ExecutionOptions):
    """Fields are options of ``relocbench probe`` and keys of its YAML file."""

    dataset: Path
    methods: tuple[str, ...] = ()
    set: tuple[str, ...] = ()
    """key=value or LABEL.key=value"""
    out: Path
    split: str | None = None
    pair_sets: tuple[str, ...] = ()
    pixels: bool = True
    """whether single pixels are probed"""
    poses: bool = True
    """whether whole poses are probed, from priors off the truth"""
    start: Literal["offsets", "identity"] = "offsets"
    """``identity``: whole poses start at the keyframe's pose, and beside it equally far off in other directions"""
    pairs: int = Field(50, ge=1)
    """the largest number of pairs of each pair set, spread along the drive"""
    per_pair: int = Field(600, ge=1)
    """the largest number of correspondences of a pair, each started from one offset"""
    structured: float = Field(1.0, gt=0, le=1)
    """share of a pair's correspondences that is probed, those whose pixel has the most structure; 1 for all"""
    directions: int = Field(2, ge=1)
    """priors of a pair at each offset"""
    feature_maps: int = Field(0, ge=0)
    """number of places whose features are drawn"""
    seed: int = Field(0, ge=0)

    @model_validator(mode="after")
    def _something_to_do(self) -> Self:
        if not self.methods:
            raise ValueError("nothing to probe: give --method NAME")
        if not (self.pixels or self.poses or self.feature_maps):
            raise ValueError("nothing to probe: --no-pixels and --no-poses leave nothing")
        return self


@dataclass(frozen=True)
class ProbeReport:
    """The results of a probe."""

    lines: list[Line]
    files: list[Path]
    crashed: list[tuple[str, str]]
    """label and message of each method that crashed on pairs"""
    starts: Sequence[StartLine] = ()
    """convergence from the keyframe's pose, where that was probed"""

    def to_dict(self) -> dict[str, Any]:
        """The radii, files and broken methods as plain values for scripts."""
        return {
            "radii": [
                {
                    "method": line.method,
                    "what": line.what,
                    "level": line.level,
                    "conditions": line.conditions,
                    "criterion": line.criterion,
                    "pairs": line.pairs,
                    "radius": line.radius.value,
                    "beyond": line.radius.beyond,
                    "interval": _bounds(line.radius.interval),
                    "ratio": None if line.ratio is None else line.ratio.value,
                    "ratio_interval": None if line.ratio is None else _bounds(line.ratio.interval),
                }
                for line in self.lines
                if line.radius is not None
            ],
            "starts": [
                {
                    "method": line.method,
                    "conditions": line.conditions,
                    "criterion": line.criterion,
                    "pairs": line.pairs,
                    **line.shares,
                    "keyframe_less_random": line.ahead.mean,
                    "interval": _bounds(line.ahead.interval),
                }
                for line in self.starts
            ],
            "files": [str(path) for path in self.files],
            "broken": [{"method": label, "message": message} for label, message in self.crashed],
        }


ANSWERS = "answers"
"""folder of what methods answered, in that of a probe"""


@kept_workers()
def probe_methods(options: ProbeOptions, reporter: Reporter) -> ProbeReport:
    """Probe methods and write ``probe.csv``, ``radii.csv``, ``probe.md``, ``probe.yaml`` and the plots.

    Raises:
        RelocbenchError: a bad dataset, method or option, or nothing that can be probed.
    """
    dataset = open_for_evaluation(options.dataset, options.out)
    run = options.run.with_shared_folders(options.out, options.dataset).hiding(dataset.root, options.out / ANSWERS)
    specs = blind_methods(dataset.root, options.methods, options.set, options.seed, run)
    asked = chosen_pairs(dataset, options)
    dataset.require_images([pair_set for pair_set, _ in asked], "there are no pixels to probe")
    return _probe(dataset, specs, asked, options, run, reporter)


def _probe(
    dataset: Dataset,
    specs: Sequence[MethodSpec],
    asked: list[tuple[PairSet, list[PairKey]]],
    options: ProbeOptions,
    run: Run,
    reporter: Reporter,
) -> ProbeReport:
    tasks = _tasks(dataset, [pair_set for pair_set, _ in asked], specs, options, run, reporter)
    pictures = _draw(dataset, [pair_set for pair_set, _ in asked], specs, options, reporter)
    task_of = {spec.label: task for spec, task in tasks}
    folder = options.out / ANSWERS
    done, left_out = run_each(
        [spec for spec, _ in tasks],
        lambda spec: ask_pairs(dataset, asked, spec, task_of[spec.label], folder, run=run, reporter=reporter),
    )
    _note_left_out(left_out, reporter)
    answers = {spec.label: found for spec, found in done}
    tasks = [(spec, task_of[spec.label]) for spec, _ in done]
    if not answers:
        return ProbeReport([], pictures, [])
    conditions = {
        s.name: (str(dataset.traversal(s.reference).condition), str(dataset.traversal(s.query).condition))
        for s, _ in asked
    }
    lines, starts = result_lines(answers, conditions), start_lines(answers, conditions)
    if not lines and not starts:
        raise ConfigError("no pair has a visible correspondence: there is no pixel to probe", dataset.root)
    files = write_probe(options.out, dataset, lines, starts, _about(dataset, options, tasks))
    crashed = [b for label, found in answers.items() for b in _crashes(label, found)]
    return ProbeReport(lines, [*files, *pictures], crashed, starts)


def chosen_pairs(dataset: Dataset, options: ProbeOptions) -> list[tuple[PairSet, list[PairKey]]]:
    """Up to ``options.pairs`` pairs with ground truth of each pair set, evenly spread.

    Raises:
        ConfigError: there is no such pair.
    """
    chosen = dataset.pair_sets(options.split)
    if options.pair_sets:
        wanted = [dataset.pair_set(name).name for name in options.pair_sets]
        chosen = [s for s in chosen if s.name in wanted]
    out = []
    for pair_set in chosen:
        known = sorted(p.key for p in pair_set.pairs if p.T_query_ref is not None)
        rows = np.unique(np.rint(np.linspace(0, len(known) - 1, min(options.pairs, len(known)))).astype(int))
        if len(rows):
            out.append((pair_set, [known[row] for row in rows]))
    if not out:
        raise ConfigError("no pair with ground truth is left to probe", dataset.root)
    return out


def _tasks(
    dataset: Dataset,
    pair_sets: Sequence[PairSet],
    specs: Sequence[MethodSpec],
    options: ProbeOptions,
    run: Run,
    reporter: Reporter,
) -> list[tuple[MethodSpec, Task]]:
    """Each method with what it supports; whatever is left out is reported."""
    without = [s.name for s in pair_sets if not dataset.layout.correspondence_file(s.name).exists()]
    if options.pixels:
        for name in without:
            reporter.note(f"{name} has no correspondences: no single pixels (build-dataset --correspondences N)")
    pixels = options.pixels and len(without) < len(pair_sets)
    keyframe = options.poses and options.start == "identity"
    poses = options.poses and not keyframe
    wanted = Task(pixels, poses, options.per_pair, options.structured, options.directions, options.seed, keyframe)
    out = []
    known, left_out = run_each(specs, lambda spec: capabilities_of(spec, run))
    _note_left_out(left_out, reporter)
    for spec, capabilities in known:
        if capabilities.fault:
            reporter.note(f"{spec.label} is left out: {capabilities.fault}")
            continue
        task = task_for(capabilities, wanted)
        if pixels and not task.pixels:
            reporter.note(f"{spec.label} does not match single pixels (it has no match())")
        if options.poses and not (task.poses or task.keyframe):
            reporter.note(f"{spec.label} does not start from a prior (no uses_prior), so it has no basin of poses")
        if task.pixels or task.poses or task.keyframe:
            out.append((spec, task))
    if not out and not options.feature_maps:
        raise ConfigError("no method can be probed: one needs match() and correspondences, or a prior to start from")
    return out


def _note_left_out(left_out: Sequence[tuple[str, str]], reporter: Reporter) -> None:
    for label, why in left_out:
        reporter.note(f"{label} is left out: {why}")


def _draw(
    dataset: Dataset,
    pair_sets: Sequence[PairSet],
    specs: Sequence[MethodSpec],
    options: ProbeOptions,
    reporter: Reporter,
) -> list[Path]:
    """Draw the features of the methods that offer them; the other methods are reported."""
    if not options.feature_maps:
        return []
    places = places_of(dataset, pair_sets, options.feature_maps)
    pictures = [Picture(spec, place, options.out) for spec in specs for place in places]
    drawn: dict[int, Path] = {}
    notes: dict[str, None] = {}
    with reporter.stage("drawing features", len(pictures)) as advance:
        here = replace(options.run, scheduler=None)
        made = run_limited(draw, [pictures], here, on_loss=lost_picture)
        for index, (path, note) in made:
            if path is not None:
                drawn[index] = path
            if note:
                notes.setdefault(note)
            advance(1)
    for note in sorted(notes):
        reporter.note(note)
    return [drawn[index] for index in sorted(drawn)]


def _about(dataset: Dataset, options: ProbeOptions, tasks: Sequence[tuple[MethodSpec, Task]]) -> dict[str, Any]:
    return {
        "dataset": dataset.name,
        "fingerprint": dataset.fingerprint,
        "options": json.loads(options.model_dump_json(exclude={"dataset", "out", *ExecutionOptions.model_fields})),
        "methods": [
            {
                key: value
                for key, value in made_by(spec, options.run.workers, options.seed).items()
                if key in ("method", "target", "parameters", "versions")
            }
            for spec, _ in tasks
        ],
    }


def _crashes(label: str, found: dict[tuple[str, PairKey], PairResult]) -> list[tuple[str, str]]:
    crashed = [(f"{name} {key[0]} {key[1]}", r.message) for (name, key), r in sorted(found.items()) if r.message]
    return first_crash(label, f"crashed on {len(crashed)} of {len(found)} pairs, counted as not found", crashed)


def _bounds(interval: Any) -> list[float] | None:
    return None if interval is None else [interval.low, interval.high]

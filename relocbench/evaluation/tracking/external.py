"""Importing predictions made elsewhere into a results folder: files of nine columns, or of named absolute poses.

An absolute pose becomes a relative one by the map's pose of the keyframe:
``T_query_ref = T_query_world @ T_world_ref``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.named_poses import read_named_poses, read_words
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey, PoseLine, write_pose_lines
from relocbench.errors import PredictionError, quoted
from relocbench.evaluation.common.predictions import adopted_run, prediction_files
from relocbench.evaluation.common.results import (
    PREDICTIONS,
    DatasetResults,
    MethodResults,
    RunRecord,
    write_record,
)
from relocbench.evaluation.tables.answers import ANSWERS, Answer, read_answers
from relocbench.evaluation.tracking.score import read_predictions


def import_predictions(
    dataset: Dataset, pair_sets: list[PairSet], source: Path, label: str, results: DatasetResults
) -> MethodResults:
    """Check a folder of ``PAIRSET.txt`` (and optional ``PAIRSET.csv``), or one file, and copy it to the results.

    A file holds pairs with their relative poses, or names of queries with their absolute ones, as hloc writes them.
    A file is for the pair set that it is named after, or else for the only requested pair set.

    A ``run.yaml`` in the folder must name this dataset's fingerprint. Pairs of a set that its file does not answer
    have failed.

    Raises:
        PredictionError: with file and line: no prediction file, a file for an unknown pair set, an unknown or
            duplicate pair, another dataset's fingerprint, or a label that other predictions have.
    """
    theirs, ours = MethodResults(source), results.method(label)
    known = RunRecord.on(dataset, method=label, target=f"{PREDICTIONS}{source.name}")
    chosen = {s.name: s for s in pair_sets}
    files = prediction_files(source, chosen, dataset.pair_set_names, unit="pair set", name=dataset.name)
    record = adopted_run(ours, theirs.run_yaml, known, "the record of a run")
    if source.resolve() == ours.root.resolve():
        return ours
    checked = [(pair_set.name, *_checked(dataset, theirs, path, pair_set)) for pair_set, path in files]
    for name, lines, answers in checked:
        write_pose_lines(ours.predictions(name), lines)
        ANSWERS.write(ours.answers(name), answers)
    write_record(ours.run_yaml, record)
    return ours


def _checked(
    dataset: Dataset, theirs: MethodResults, path: Path, pair_set: PairSet
) -> tuple[list[PoseLine], list[Answer]]:
    named = is_named(path)
    poses = read_named_predictions(path, dataset, pair_set) if named else read_predictions(path, pair_set)
    table = theirs.answers(pair_set.name)
    given = read_answers(table) if table.exists() else {}
    for key in given:
        if key not in pair_set.by_key:
            raise PredictionError(f"unknown pair {key[0]} {key[1]}", table)
    lines = [PoseLine(*p.key, poses[p.key]) for p in pair_set.evaluated if p.key in poses]
    answers = [
        # What memory was taken elsewhere nobody here has measured.
        replace(given[p.key], peak_memory_bytes=None)
        if p.key in given
        else Answer(*p.key, "ok" if p.key in poses else "failed", message=_missing(p.key in poses))
        for p in pair_set.evaluated
    ]
    return lines, answers


def _missing(answered: bool) -> str:
    return "" if answered else "not in the prediction file"


_FIELDS = 8


def is_named(path: Path) -> bool:
    """Whether the first line of a prediction file has a name and a pose, as opposed to a pair and a pose."""
    first = next(iter(read_words(path, "predictions", PredictionError)), None)
    return first is not None and len(first[1]) == _FIELDS


def read_named_predictions(path: Path, dataset: Dataset, pair_set: PairSet) -> dict[PairKey, Array]:
    """``T_query_ref`` (4, 4) by pair, from lines ``name qw qx qy qz tx ty tz``, camera from world.

    A query is named as in the recording, or by the last part of its name where this is no other query's. All pairs of
    a query get its pose. Poses are in the unit of the model that the dataset was imported from.

    Raises:
        PredictionError: with file and line: a line that cannot be read; a name that no query has, or several; or the
            dataset's images have no names.
    """
    names = dataset.traversal(pair_set.query).names
    if not names:
        raise PredictionError(
            f"names images, and those of {dataset.name} have no names; expected lines 'ref_ts query_ts [tx ty tz qx qy "
            "qz qw]'",
            path,
        )
    by_name = {name: time for time, name in names.items()}
    by_last: dict[str, list[int]] = {}
    for time, name in names.items():
        by_last.setdefault(name.rpartition("/")[2], []).append(time)
    options = dataset.file.made_by.get("options")
    metres = float(options.get("metres_per_unit", 1.0)) if isinstance(options, dict) else 1.0
    poses: dict[int, Array] = {}
    for name, T_query_world in read_named_poses(path, PredictionError).items():
        times = [by_name[name]] if name in by_name else by_last.get(name, [])
        if len(times) != 1:
            raise PredictionError(f"{quoted(name)} names {len(times) or 'no'} queries of '{pair_set.name}'", path)
        if times[0] in poses:
            raise PredictionError(f"{quoted(name)} names a query for the second time", path)
        scaled = T_query_world.copy()
        scaled[:3, 3] *= metres
        poses[times[0]] = scaled
    reference = dataset.traversal(pair_set.reference)
    return {
        pair.key: poses[pair.query_timestamp_ns]
        @ reference.T_world_cam(pair_set.reference_camera, pair.ref_timestamp_ns)
        for pair in pair_set.evaluated
        if pair.query_timestamp_ns in poses
    }

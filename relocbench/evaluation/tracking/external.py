"""Importing predictions made elsewhere into a results folder: files of nine columns, or of named absolute poses."""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.errors import PredictionError
from relocbench.evaluation.common.predictions import adopted_run, prediction_files
from relocbench.evaluation.common.results import (
    PREDICTIONS,
    DatasetResults,
    MethodResults,
    RunRecord,
    write_record,
)
from relocbench.evaluation.tables.answers import Answer, read_answers, write_answers
from relocbench.evaluation.tracking.named import is_named, read_named_predictions
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
    known = RunRecord(
        method=label,
        target=f"{PREDICTIONS}{source.name}",
        dataset=dataset.name,
        fingerprint=dataset.fingerprint,
        question=dataset.content_id,
    )
    chosen = {s.name: s for s in pair_sets}
    files = prediction_files(source, chosen, dataset.pair_set_names, unit="pair set", name=dataset.name)
    record = adopted_run(ours, theirs.run_yaml, known, "the record of a run")
    if source.resolve() == ours.root.resolve():
        return ours
    checked = [(pair_set.name, *_checked(dataset, theirs, path, pair_set)) for pair_set, path in files]
    for name, lines, answers in checked:
        write_pose_lines(ours.predictions(name), lines)
        write_answers(ours.answers(name), answers)
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
        given.get(p.key) or Answer(*p.key, "ok" if p.key in poses else "failed", message=_missing(p.key in poses))
        for p in pair_set.evaluated
    ]
    return lines, answers


def _missing(answered: bool) -> str:
    return "" if answered else "not in the prediction file"

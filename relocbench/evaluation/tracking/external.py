"""Importing predictions made elsewhere into a results folder: files of nine columns, or of named absolute poses."""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.errors import PredictionError, available
from relocbench.evaluation.common.answer_table import Answer, read_answers, write_answers
from relocbench.evaluation.common.results import (
    PREDICTIONS,
    DatasetResults,
    MethodResults,
    RunRecord,
    adopted_run,
    write_record,
)
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
    if not source.exists():
        raise PredictionError("no such file or folder; expected prediction files PAIRSET.txt", source)
    theirs = MethodResults(source)
    known = RunRecord(
        method=label,
        target=f"{PREDICTIONS}{source.name}",
        dataset=dataset.name,
        fingerprint=dataset.fingerprint,
        question=dataset.content_id,
    )
    record = adopted_run(theirs.run_yaml, known, "the record of a run")
    files = [_single(pair_sets, source)] if source.is_file() else _in_folder(dataset, pair_sets, source)
    ours = results.method(label)
    if source.resolve() == ours.root.resolve():
        return ours
    if ours.run_yaml.exists() and ours.run_record().target != record.target:
        raise PredictionError(f"holds predictions of '{ours.run_record().target}'; choose another label", ours.run_yaml)
    checked = [(pair_set.name, *_checked(dataset, theirs, path, pair_set)) for pair_set, path in files]
    for name, lines, answers in checked:
        write_pose_lines(ours.predictions(name), lines)
        write_answers(ours.answers(name), answers)
    write_record(ours.run_yaml, record)
    return ours


def _single(pair_sets: list[PairSet], source: Path) -> tuple[PairSet, Path]:
    """The pair set that a single file answers. Raises PredictionError if that is not clear."""
    matching = [s for s in pair_sets if s.name == source.stem] or pair_sets
    if len(matching) != 1:
        names = ", ".join(s.name for s in matching)
        raise PredictionError(f"one file answers one pair set, and there are {names}; choose one: --pair-set", source)
    return matching[0], source


def _in_folder(dataset: Dataset, pair_sets: list[PairSet], source: Path) -> list[tuple[PairSet, Path]]:
    """The requested pair sets that a folder answers, each with its file. Raises PredictionError for an unknown one."""
    files = sorted(source.glob("*.txt"))
    if not files:
        raise PredictionError("holds no prediction file (PAIRSET.txt)", source)
    for path in files:
        if path.stem not in dataset.pair_set_names:
            others = available(path.stem, dataset.pair_set_names)
            raise PredictionError(f"no pair set '{path.stem}' in {dataset.name}{others}", path)
    wanted = {s.name: s for s in pair_sets}
    return [(wanted[path.stem], path) for path in files if path.stem in wanted]


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

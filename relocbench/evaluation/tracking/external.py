"""Importing predictions made elsewhere, in files of nine columns, into a results folder."""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import (
    PREDICTIONS,
    Answer,
    DatasetResults,
    MethodResults,
    RunRecord,
    adopted_run,
    read_answers,
    write_answers,
    write_record,
)
from relocbench.evaluation.tracking.score import read_predictions


def import_predictions(
    dataset: Dataset, pair_sets: list[PairSet], source: Path, label: str, results: DatasetResults
) -> MethodResults:
    """Check a folder of ``PAIRSET.txt`` (and optional ``PAIRSET.csv``) and copy it to the results under ``label``.

    A ``run.yaml`` in the folder must name this dataset's fingerprint. Pairs of a set that its file does not answer
    have failed.

    Raises:
        PredictionError: with file and line: no prediction file, a file for an unknown pair set, an unknown or
            duplicate pair, another dataset's fingerprint, or a label that other predictions have.
    """
    if not source.is_dir():
        raise PredictionError("no such folder; expected prediction files PAIRSET.txt", source)
    theirs = MethodResults(source)
    known = RunRecord(
        method=label,
        target=f"{PREDICTIONS}{source.name}",
        dataset=dataset.name,
        fingerprint=dataset.fingerprint,
        question=dataset.question,
    )
    record = adopted_run(theirs.run_yaml, known, "the record of a run")
    wanted = {s.name: s for s in pair_sets}
    files = sorted(source.glob("*.txt"))
    if not files:
        raise PredictionError("holds no prediction file (PAIRSET.txt)", source)
    for path in files:
        if path.stem not in dataset.pair_set_names:
            names = ", ".join(dataset.pair_set_names)
            raise PredictionError(f"no pair set '{path.stem}' in {dataset.name}; there is {names}", path)
    ours = results.method(label)
    if source.resolve() == ours.root.resolve():
        return ours
    if ours.run_yaml.exists() and ours.run_record().target != record.target:
        raise PredictionError(f"holds predictions of '{ours.run_record().target}'; choose another label", ours.run_yaml)
    checked = [(path.stem, *_checked(theirs, path, wanted[path.stem])) for path in files if path.stem in wanted]
    for name, lines, answers in checked:
        write_pose_lines(ours.predictions(name), lines)
        write_answers(ours.answers(name), answers)
    write_record(ours.run_yaml, record)
    return ours


def _checked(theirs: MethodResults, path: Path, pair_set: PairSet) -> tuple[list[PoseLine], list[Answer]]:
    poses = read_predictions(path, pair_set)
    table = theirs.answers(pair_set.name)
    given = read_answers(table) if table.exists() else {}
    for key in given:
        if key not in pair_set.by_key:
            raise PredictionError(f"unknown pair {key[0]} {key[1]}", table)
    lines = [PoseLine(*p.key, poses[p.key]) for p in pair_set.pairs if p.key in poses]
    answers = [
        given.get(p.key) or Answer(p.key, "ok" if p.key in poses else "failed", message=_missing(p.key in poses))
        for p in pair_set.pairs
    ]
    return lines, answers


def _missing(answered: bool) -> str:
    return "" if answered else "not in the prediction file"

"""Whether scores belong to the files beside them, and whether predictions and truth confirm them.

Digests recognise a file that was changed after scoring. Whoever changes a file on purpose can compute them again:
only scoring again, with the truth, shows that errors are those of the predictions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pair_table import MEASURES
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import MethodResults, RunRecord, ScoreRecord
from relocbench.evaluation.tables.errors import NUMBERS, ErrorTable
from relocbench.evaluation.tables.matching import MATCHING, MatchingRow, check_complete, summarize_matching
from relocbench.evaluation.tracking.score import (
    FORMULAS,
    groups_of,
    predictions_hash,
    score_pair_set,
    summarize_rows,
    truth_hash,
)
from relocbench.files import sha256_file

_SAME = (1e-9, 1e-6)
"""Relative and absolute difference that the last digits of another processor explain."""
_COPY = (1e-6, 1e-3)
"""The same where the truth is that of a copy of the dataset, whose poses are equal to a millionth."""


def faults_of_record(
    folder: MethodResults, run: RunRecord, scores: ScoreRecord, again: str
) -> Iterator[PredictionError]:
    """What is wrong with ``scores.yaml`` as a whole.

    Args:
        again: what scores the predictions again, in words.
    """
    path = folder.scores_yaml
    if scores.formulas != FORMULAS:
        message = f"was computed by version {scores.formulas} of the formulas, this is version {FORMULAS}"
        yield PredictionError(f"{message}; {again}", path)
        return
    if scores.fingerprint != run.fingerprint:
        theirs, ours = scores.fingerprint[:SHORT], run.fingerprint[:SHORT]
        yield PredictionError(f"was computed on the dataset {theirs}, the predictions are for {ours}; {again}", path)
    if scores.run != sha256_file(folder.run_yaml):
        yield PredictionError(
            "changed since the predictions were scored; put the original back, or run the method again with "
            "--overwrite always",
            folder.run_yaml,
        )


def faults_of_pair_set(folder: MethodResults, name: str, scores: ScoreRecord, again: str) -> Iterator[PredictionError]:
    """The files of a pair set that are not those that ``scores.yaml`` says it was computed from."""
    if name not in scores.predictions or name not in scores.pair_sets:
        yield PredictionError(f"holds no scores of '{name}', which was predicted; {again}", folder.scores_yaml)
        return
    if scores.predictions[name] != predictions_hash(folder, name):
        yield PredictionError(f"changed since it was scored; {again}", folder.predictions(name))
    if not folder.errors(name).exists():
        yield PredictionError(f"missing, but {folder.scores_yaml.name} summarises it; {again}", folder.errors(name))
    elif scores.errors.get(name) != sha256_file(folder.errors(name)):
        yield PredictionError(f"changed since the predictions were scored; {again}", folder.errors(name))


def matching_of_pair_set(
    folder: MethodResults, name: str, keys: Sequence[PairKey], scores: ScoreRecord, again: str
) -> list[MatchingRow]:
    """Read the matching quality of a pair set, which was measured according to the folder or to ``scores.yaml``.

    It cannot be computed anew: where a method's matches ended is not kept.

    Raises:
        PredictionError: the table is not the one that was scored, or not what ``scores.yaml`` summarises.
    """
    path = folder.matching(name)
    if not path.exists():
        raise PredictionError(f"missing, but {folder.scores_yaml.name} summarises it; {again}", path)
    rows = MATCHING.read(path)
    check_complete(rows, keys, path)
    if scores.matching_tables.get(name) != sha256_file(path):
        raise PredictionError(f"changed since it was scored; {again}", path)
    recorded = scores.matching.get(name, {})
    if any(recorded.get(group) != summarize_matching(rows, group) for group in groups_of(rows)):
        raise PredictionError(f"differs from what {folder.scores_yaml.name} summarises; {again}", path)
    return rows


def faults_of_summary(
    folder: MethodResults, name: str, rows: ErrorTable, scores: ScoreRecord, again: str
) -> Iterator[PredictionError]:
    """The first score of each group that is not the summary of the table of errors.

    Metrics that are not recorded are younger than the file: they follow from the table.
    """
    for group in groups_of(rows):
        recorded = scores.pair_sets[name].get(group)
        if recorded is None:
            yield PredictionError(f"no scores of '{name}' ({group}); {again}", folder.scores_yaml)
            continue
        for metric, value in summarize_rows(rows, group).to_dict().items():
            if metric in recorded and not _same(value, recorded[metric]):
                message = f"{metric} ({group}) is {value} here and {recorded[metric]} in {folder.scores_yaml.name}"
                yield PredictionError(f"{message}; {again}", folder.errors(name))
                break
    yield from _faults_of_different_places(folder, name, rows, scores, again)


def _faults_of_different_places(
    folder: MethodResults, name: str, rows: ErrorTable, scores: ScoreRecord, again: str
) -> Iterator[PredictionError]:
    """The first number of the pairs of different places that is not that of the table of errors."""
    different = rows.different_places
    if not different.pairs and name not in scores.elsewhere:
        return
    recorded = scores.elsewhere.get(name, {})
    for key, value in different.to_dict().items():
        if key not in recorded or not _same(value, recorded[key]):
            message = f"{key} of different places is {value} here and {recorded.get(key)} in {folder.scores_yaml.name}"
            yield PredictionError(f"{message}; {again}", folder.errors(name))
            return


def rescored(
    folder: MethodResults, pair_set: PairSet, rows: ErrorTable, scores: ScoreRecord, again: str, *, copy: bool = False
) -> ErrorTable:
    """Compute the errors of a pair set anew from predictions and truth, in the order of reference time.

    Args:
        rows: what ``PAIRSET.errors.csv`` claims, in the same order.
        copy: whether the truth is that of a copy of the dataset, from another processor.

    Raises:
        PredictionError: the table claims other errors, or the predictions were compared with another truth.
    """
    if not copy and scores.truth.get(pair_set.name) != truth_hash(pair_set):
        raise PredictionError(
            f"the predictions of '{pair_set.name}' were not compared with the truth of this dataset; {again}",
            folder.scores_yaml,
        )
    errors = score_pair_set(pair_set, folder).by_time()
    difference = _first_difference(rows, errors, *((_COPY, MEASURES) if copy else (_SAME, ())))
    if difference is not None:
        raise PredictionError(
            f"does not follow from predictions and truth: {difference}; {again}", folder.errors(pair_set.name)
        )
    return errors


def _first_difference(
    claimed: ErrorTable, computed: ErrorTable, tolerance: tuple[float, float], but: Sequence[str]
) -> str | None:
    """The first pair on which two tables differ other than in the columns ``but``, in words; None where they agree."""
    if not np.array_equal(claimed.keys, computed.keys):
        return f"the table has {len(claimed)} pairs, of which some are not among the {len(computed)} of the dataset"
    relative, absolute = tolerance
    differs = ~np.isclose(claimed.numbers, computed.numbers, rtol=relative, atol=absolute, equal_nan=True)
    differs[[NUMBERS.index(name) for name in but]] = False
    words = [(c, f) for c, f in zip(claimed.groups, computed.groups, strict=True)]
    status = claimed.status_index != computed.status_index
    group = np.array([c != f for c, f in words], dtype=bool)
    rows = np.flatnonzero(differs.any(axis=0) | status | group)
    if not rows.size:
        return None
    row = int(rows[0])
    place = f"pair {claimed.keys[row, 0]} {claimed.keys[row, 1]} has"
    if status[row]:
        return f"{place} the status {claimed.statuses[row]}, expected {computed.statuses[row]}"
    if group[row]:
        return f"{place} the group '{words[row][0]}', expected '{words[row][1]}'"
    column = int(np.flatnonzero(differs[:, row])[0])
    name, values = NUMBERS[column], (claimed.numbers[column, row], computed.numbers[column, row])
    return f"{place} {name} {values[0]:.6g}, expected {values[1]:.6g}"


def _same(a: float | None, b: float | None) -> bool:
    return a is b if a is None or b is None else math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12)

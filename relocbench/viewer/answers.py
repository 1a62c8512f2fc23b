"""The answers of methods to the pairs of a dataset, with errors computed anew from predictions and truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import PredictionError, available, quoted
from relocbench.evaluation.common.results import DatasetResults, MethodResults, all_results, check_made_for
from relocbench.evaluation.tables.answers import read_answers
from relocbench.evaluation.tracking.score import read_predictions, score_pair_set


@dataclass(frozen=True, eq=False)
class ShownAnswer:
    """What one method answered to one pair."""

    T_query_ref: Array | None
    """(4, 4); None without an answer"""
    translation_error_m: float | None
    """None where the truth is withheld; infinite without an answer"""
    rotation_error_deg: float | None
    confidence: float | None
    message: str = ""

    @property
    def words(self) -> str:
        """The errors in words, such as ``0.052 m, 0.31°``."""
        if self.T_query_ref is None:
            return f"no answer: {self.message}" if self.message else "no answer"
        if self.translation_error_m is None or self.rotation_error_deg is None:
            return "error unknown: the truth is withheld"
        return f"{self.translation_error_m:.3f} m, {self.rotation_error_deg:.3f}°"


MethodAnswers = dict[PairKey, ShownAnswer]
"""the answers of one method to one pair set"""


def results_of(results: Path, dataset: Dataset) -> DatasetResults:
    """The folder of a dataset's results. Raises PredictionError where there is none in ``results``."""
    found = all_results(results)
    for folder in found:
        if folder.record.fingerprint == dataset.fingerprint:
            return folder
    others = ", ".join(quoted(folder.root.name) for folder in found)
    raise PredictionError(
        f"holds no results of {dataset.name}@{dataset.fingerprint[:SHORT]}; available: {others}", results
    )


def chosen_methods(folder: DatasetResults, names: Sequence[str]) -> list[MethodResults]:
    """The named methods in that order, or all. Raises PredictionError for one that is not there."""
    known = {method.label: method for method in folder.methods()}
    for name in names:
        if name not in known:
            raise PredictionError(f"no results of a method {quoted(name)}{available(name, known)}", folder.root)
    return [known[name] for name in dict.fromkeys(names)] if names else list(known.values())


def answers_to(dataset: Dataset, pair_set: PairSet, method: MethodResults) -> MethodAnswers | None:
    """A method's answers to a pair set; None where its run of the set is not complete.

    Raises:
        PredictionError: the predictions are for another dataset, or a file is bad.
    """
    check_made_for(method.run_record(), dataset.name, dataset.fingerprint, method.run_yaml)
    if not method.predictions(pair_set.name).exists():
        return None
    poses = read_predictions(method.predictions(pair_set.name), pair_set)
    table = method.answers(pair_set.name)
    answers = read_answers(table) if table.exists() else {}
    errors = {row.key: row for row in score_pair_set(pair_set, method)} if pair_set.has_truth else {}
    out: MethodAnswers = {}
    for pair in pair_set.evaluated:
        answer, error = answers.get(pair.key), errors.get(pair.key)
        out[pair.key] = ShownAnswer(
            # A pose of which no error can be computed counts as none, as on leaderboards.
            poses.get(pair.key) if error is None or isfinite(error.translation_error_m) else None,
            None if error is None else error.translation_error_m,
            None if error is None else error.rotation_error_deg,
            None if answer is None else answer.confidence,
            "" if answer is None else answer.message,
        )
    return out

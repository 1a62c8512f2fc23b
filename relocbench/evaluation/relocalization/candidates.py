"""Running trackers against retrieved keyframes: each (keyframe, query) once, whichever retrievers propose it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair, PairKey
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import DatasetResults, MethodResults
from relocbench.evaluation.common.runs import Asking
from relocbench.evaluation.isolation.journal import journal_entries
from relocbench.evaluation.relocalization.pipeline import Tracked
from relocbench.evaluation.tables.answers import read_answers
from relocbench.evaluation.tracking.run import run_method
from relocbench.evaluation.tracking.score import read_predictions
from relocbench.methods import MethodSpec


class Candidates(PairSet):
    """Candidate pairs of a pair set's traversals that a tracker runs on, without ground truth."""

    def __init__(self, of: PairSet, keys: Iterable[PairKey]) -> None:
        super().__init__(of.layout, of.name)
        self._keys = sorted(set(keys))

    @cached_property
    def all_pairs(self) -> list[Pair]:
        return [Pair(*key, None) for key in self._keys]


def track_candidates(
    dataset: Dataset,
    wanted: Mapping[str, Iterable[PairKey]],
    spec: MethodSpec,
    results: DatasetResults,
    asking: Asking,
) -> MethodResults:
    """Ask a tracker about the candidate pairs that it has not answered yet; earlier answers are kept.

    Args:
        wanted: the pairs, by pair set.

    Raises:
        PredictionError: the folder holds answers of this label that were made differently, or is in use.
        DatasetError: an image, depth or description of the dataset is bad.
    """
    folder, keeps = results.method(spec.label), asking.overwrite != "always"
    pools: Sequence[PairSet] = [
        Candidates(dataset.pair_set(name), [*keys, *(_answered_pairs(folder, name) if keeps else ())])
        for name, keys in wanted.items()
    ]
    return run_method(dataset, pools, spec, results, asking)


def read_tracked(dataset: Dataset, folder: MethodResults, task: str) -> Tracked:
    """Read a tracker's answers on a task. Raises PredictionError."""
    path = folder.answers(task)
    answers = read_answers(path)
    poses = read_predictions(folder.predictions(task), Candidates(dataset.pair_set(task), answers))
    for key in poses:
        if answers[key].status != "ok":
            raise PredictionError(f"pair {key[0]} {key[1]} has a pose, but its status is not ok", path)
    return Tracked(answers, poses)


def _answered_pairs(folder: MethodResults, task: str) -> list[PairKey]:
    """The pairs that have an answer, from earlier calls or in the journal of a run that was stopped."""
    known = list(read_answers(folder.answers(task))) if folder.complete(task) else []
    return [*known, *(entry["key"] for entry in journal_entries(folder.journal(task)))]

"""The rankings that pipelines start from: those of retrievers, and the oracle's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from relocbench.evaluation.common.results import PREDICTIONS
from relocbench.evaluation.common.runs import Asking, run_each
from relocbench.evaluation.relocalization.pipeline import Retrieved
from relocbench.evaluation.relocalization.records import ORACLE
from relocbench.evaluation.relocalization.truth import MapTruth
from relocbench.evaluation.retrieval.answers import ANSWERS, read_task_lists
from relocbench.evaluation.retrieval.evaluate import KEEP
from relocbench.evaluation.retrieval.external import import_rankings
from relocbench.evaluation.retrieval.opening import OpenedSet
from relocbench.evaluation.retrieval.records import RetrievalRun, RetrieverResults, SetResults, write_set_record
from relocbench.evaluation.retrieval.run import run_retriever
from relocbench.evaluation.retrieval.score import score_retriever
from relocbench.methods import MethodSpec
from relocbench.retrieval import RetrievalTask


class RankingSource(Protocol):
    """The rankings of all tasks by one retriever."""

    @property
    def label(self) -> str: ...

    @property
    def run(self) -> RetrievalRun | None:
        """How the rankings were made; None for the oracle."""
        ...

    def of(self, task: RetrievalTask, truth: MapTruth, top: int) -> list[Retrieved]:
        """The first ``top`` keyframes of each query, in the order of the queries."""
        ...


class Oracle:
    """Rankings of the keyframes by the true poses: within the pairs' reach first, nearest first."""

    label = ORACLE
    run = None

    def of(self, task: RetrievalTask, truth: MapTruth, top: int) -> list[Retrieved]:
        return [Retrieved(truth.oracle(query, top)) for query in range(len(task.queries))]


@dataclass(frozen=True)
class StoredRankings:
    """Rankings read from a results folder."""

    folder: RetrieverResults

    @property
    def label(self) -> str:
        return self.folder.label

    @property
    def run(self) -> RetrievalRun:
        return self.folder.run_record()

    def of(self, task: RetrievalTask, truth: MapTruth, top: int) -> list[Retrieved]:
        lists = read_task_lists(self.folder.predictions(task.name), task)
        answers = {a.query: a for a in ANSWERS.read(self.folder.answers(task.name))}
        known = [(listed[:top], answers[key]) for key, listed in lists.items()]
        return [Retrieved(listed, answer.status, answer.seconds, answer.message) for listed, answer in known]


def run_retrievers(
    opened: OpenedSet,
    retrievers: Sequence[MethodSpec | str],
    results: SetResults,
    asking: Asking,
) -> tuple[list[RankingSource], list[tuple[str, str]]]:
    """Run retrievers as ``relocbench evaluate-retrieval --positives pairs`` does, unless they have answered.

    The results are the same files, with the same scores.

    Args:
        retrievers: a string is ``oracle``, or ``LABEL=predictions:PATH`` for rankings made elsewhere.

    Returns:
        the rankings, and the label and message of each retriever that cannot be made.

    Raises:
        RelocbenchError: no retriever can be made, a bad list, or answers that were made differently.
    """

    def rankings_of(retriever: MethodSpec | str) -> RankingSource:
        if retriever == ORACLE:
            return Oracle()
        if isinstance(retriever, str):
            path = Path(retriever.partition("=")[2].removeprefix(PREDICTIONS))
            folder = import_rankings(opened, opened.chosen, path, label_of(retriever), results)
        else:
            folder = run_retriever(opened, opened.chosen, retriever, results, KEEP, asking)
        write_set_record(results, opened, opened.chosen)
        score_retriever(results.record, folder)
        return StoredRankings(folder)

    done, left_out = run_each(retrievers, rankings_of)
    return [source for _, source in done], left_out


def label_of(retriever: MethodSpec | str) -> str:
    """The label that a retriever's results are kept under."""
    return retriever.partition("=")[0] if isinstance(retriever, str) else retriever.label

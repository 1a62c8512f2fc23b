"""Phase two: scores from ranks, and advice where they are no better than chance."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from relocbench import version
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import check_made_for, write_record
from relocbench.evaluation.retrieval.answers import ANSWERS, QueryAnswer, ranking_of
from relocbench.evaluation.retrieval.records import (
    METRICS,
    RetrieverResults,
    RetrieverScores,
    SetRecord,
    TaskRecord,
    TaskRun,
)
from relocbench.files import sha256_file
from relocbench.metrics import Denominator, mean_interval, per_group, score_retrieval
from relocbench.metrics.retrieval.measures import RetrievalScores

Values = dict[str, float | int | None]
_MOST_POSITIVES = 100_000_000
"""limit over all queries of a task: each position takes 8 bytes"""


def score_retriever(asked: SetRecord, folder: RetrieverResults) -> RetrieverScores:
    """Score every task that a retriever answered, and write ``scores.yaml``.

    Raises:
        PredictionError: the answers are for another set, or a file is bad.
    """
    check_made_for(folder.run_record(), asked.name, asked.fingerprint, folder.run_yaml)
    answers, lists, tasks = {}, {}, {}
    for name, record in asked.tasks.items():
        if folder.complete(name):
            answers[name], lists[name] = sha256_file(folder.answers(name)), sha256_file(folder.predictions(name))
            tasks[name] = summary(record, checked_answers(name, record, folder))
    scores = RetrieverScores(
        relocbench=version.__version__,
        run=sha256_file(folder.run_yaml),
        answers=answers,
        lists=lists,
        denominator=str(Denominator.ALL),
        tasks=tasks,
    )
    write_record(folder.scores_yaml, scores)
    return scores


def checked_answers(name: str, record: TaskRecord, folder: RetrieverResults) -> list[QueryAnswer]:
    """Read a task's table. Raises PredictionError unless it has a valid row for each query."""
    path = folder.answers(name)
    answers = ANSWERS.read(path)
    if len(answers) != record.queries:
        raise PredictionError(f"{len(answers)} rows, expected one for each of {record.queries} queries", path)
    for answer in answers:
        if answer.positives > record.most_positives or answer.positives > record.gallery:
            message = (
                f"query '{answer.query[:60]}' has {answer.positives} positives, the task's record says that no query"
            )
            raise PredictionError(f"{message} has more than {min(record.most_positives, record.gallery)}", path)
        if answer.ranks and answer.ranks[-1] > record.gallery:
            raise PredictionError(f"rank {answer.ranks[-1]} in a gallery of {record.gallery} images", path)
    if sum(answer.positives for answer in answers) > _MOST_POSITIVES:
        raise PredictionError(f"more than {_MOST_POSITIVES} positives in all", path)
    return answers


def scores_of(answers: Sequence[QueryAnswer], record: TaskRecord) -> RetrievalScores:
    """The scores of each query."""
    return score_retrieval(ranking_of(answers, record.gallery))


def summary(record: TaskRecord, answers: Sequence[QueryAnswer]) -> Values:
    """Counts, means over all queries, and their intervals."""
    scores = scores_of(answers, record)
    statuses = [a.status for a in answers]
    seconds = [a.seconds for a in answers if a.seconds is not None]
    values: Values = {
        "queries": len(answers),
        "without_positives": int(np.sum(scores.positives == 0)),
        "failed": statuses.count("failed"),
        "broke": statuses.count("error"),
        "gallery": record.gallery,
        "median_seconds": float(np.median(seconds)) if seconds else None,
    }
    drawn = {metric: resampled(scores.per_query(metric), answers) for metric in METRICS}
    for metric in METRICS:
        interval = mean_interval([drawn[metric]], [np.stack([*drawn.values()])], independent=record.grouped)
        values[metric] = float(np.mean(scores.per_query(metric)))
        values[f"{metric}_low"] = None if interval is None else interval.low
        values[f"{metric}_high"] = None if interval is None else interval.high
    return values


def unanswered(summaries: Iterable[Values]) -> dict[str, int]:
    """How many queries methods declined, and on how many they crashed, over all summaries."""
    known = list(summaries)
    return {name: int(sum(values[name] or 0 for values in known)) for name in ("failed", "broke")}


def resampled(per_query: np.ndarray, answers: Sequence[QueryAnswer]) -> np.ndarray:
    """The values that intervals are computed from: one for each group, or one for each query along the drive."""
    groups = [a.group for a in answers]
    return per_group(per_query, groups) if all(groups) else per_query


def suspicion(name: str, record: TaskRecord, values: Values, run: TaskRun | None) -> str | None:
    """What to check when R@1 is no better than chance; None if it is better."""
    recall, chance = values["R@1"], record.chance.get("R@1", 0.0)
    low = values["R@1_low"]
    if recall is None or (recall > chance and (low is None or low > chance)):
        return None
    answerable = record.queries - record.without_positives
    messages = [
        f"no significant gain over chance on {name}: R@1 is {100 * recall:.2f} %, a random order gives "
        f"{100 * chance:.2f} %"
    ]
    messages.append(f"{answerable} of {record.queries} queries have an image in the gallery that answers them")
    if run is not None:
        if run.descriptor_variance is not None:
            alike = (
                " (all images look alike to it: wrong or untrained weights?)" if run.descriptor_variance < 1e-3 else ""
            )
            messages.append(
                f"descriptors of {run.dimensions} numbers have variance {run.descriptor_variance:.2g} of 1{alike}"
            )
        messages.append(
            f"{run.queries_described} of {record.queries} queries and {run.gallery_described} of {record.gallery} "
            "gallery images were described"
        )
    return "; ".join(messages)

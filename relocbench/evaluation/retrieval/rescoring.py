"""Computing the ranks of positives anew from the images that a retriever retrieved and a set's truth.

Of each query the first images of the ranking are kept, 100 unless ``--keep`` says otherwise. What they hold decides the
ranks up to there; of the positives behind them only the number follows, and the ranks are those that the results claim.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Indices
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.errors import ConfigError, PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.retrieval.answers import QueryAnswer, read_task_lists
from relocbench.evaluation.retrieval.records import (
    METRICS,
    SET_FILE,
    RetrieverResults,
    SetRecord,
    SetResults,
    splits_of,
    task_record,
)
from relocbench.metrics import NEVER, Ranking, rank_lists, score_retrieval
from relocbench.retrieval import RetrievalTask

AGAIN = "run `relocbench evaluate-retrieval --overwrite always` to ask again"


@dataclass(frozen=True)
class Confirmed:
    """How far the ranks of a task follow from the images that were kept."""

    depth: int | None
    """the ranks up to here do; None: all of them"""
    believed: Mapping[str, float]
    """metric -> by how much its mean could be another one, given the images that were kept; 0 where it follows"""


class RetrievalTruth:
    """The tasks of a retrieval set that is available."""

    def __init__(self, folder: SetResults, places: StreetPlaces | CrossViewSet) -> None:
        """Check what the results folder says of the set.

        Raises:
            PredictionError: the folder says otherwise of a task than the set does.
            DatasetError: the set has no such tasks.
        """
        self.places = places
        self._tasks = {task.name: task for task in _tasks(places, folder.record)}
        difference = _first_difference(folder.record, places, self._tasks)
        if difference is not None:
            raise PredictionError(
                f"{difference} is not that of the dataset; `relocbench evaluate-retrieval` writes it again",
                folder.root / SET_FILE,
            )

    @property
    def tasks(self) -> Mapping[str, RetrievalTask]:
        """The tasks with their images, by name."""
        return self._tasks

    def confirmed(
        self, folder: RetrieverResults, name: str, keep: int | None, claimed: Sequence[QueryAnswer]
    ) -> Confirmed:
        """Compare the rows of a task with the images that were kept of each query.

        Args:
            keep: the number of images that are kept of a query, if so many were retrieved; None for all.
            claimed: the rows of ``TASK.csv``.

        Raises:
            PredictionError: a row is another one, or ``TASK.txt`` is bad.
        """
        task = self._tasks[name]
        kept_of = read_task_lists(folder.predictions(name), task)
        lists = [np.array(kept, dtype=np.int64) for kept in kept_of.values()]
        if keep is not None and any(len(kept) > keep for kept in lists):
            words = f"holds more images of a query than the {keep} that {folder.run_yaml.name} says are kept"
            raise PredictionError(f"{words}; {AGAIN}", folder.predictions(name))
        ranking = rank_lists(lists, task.relevance)
        live = int(np.sum(~task.relevance.junk))
        depth = _depths(lists, task, keep, live)
        if [row.query for row in claimed] != list(kept_of):
            raise PredictionError(f"has other queries than the dataset; {AGAIN}", folder.answers(name))
        for q, row in enumerate(claimed):
            fault = _fault(row, task.groups[q] if task.groups else "", ranking, q, int(depth[q]), live)
            if fault is not None:
                raise PredictionError(
                    f"query '{row.query}' {fault}, which {folder.predictions(name).name} and the dataset do not give; "
                    f"{AGAIN}",
                    folder.answers(name),
                )
        behind = depth < NEVER
        return Confirmed(int(depth[behind].min()) if np.any(behind) else None, _believed(ranking, depth))


def truth_of(folder: SetResults, lookup: DatasetLookup) -> RetrievalTruth | None:
    """The truth of a retrieval set; None where its dataset is not available.

    A copy of the dataset, from another processor, will do where labels or pairs decide which images are right. Where a
    radius does, the last digits of a pose can decide, and it will not.

    Raises:
        PredictionError: the results folder says otherwise of a task than the dataset does.
        DatasetError: a dataset that was named is damaged.
    """
    record = folder.record
    for is_it in (_has_fingerprint, _asks_the_same):
        places = _find(record, lookup, is_it)
        if places is not None:
            return RetrievalTruth(folder, places)
    return None


def belongs(dataset: Dataset | CrossViewSet, record: SetRecord) -> bool:
    """Whether results are of a dataset or of a copy of it."""
    if isinstance(dataset, CrossViewSet) and record.options:
        return False  # without reading its images
    places = street_places(dataset, record) if isinstance(dataset, Dataset) else dataset
    return places is not None and (
        _has_fingerprint(places, record) or (places.name == record.name and places.content_id == record.question)
    )


def _find(
    record: SetRecord, lookup: DatasetLookup, is_it: Callable[[StreetPlaces | CrossViewSet, SetRecord], bool]
) -> StreetPlaces | CrossViewSet | None:
    def has_places(dataset: Dataset) -> bool:
        places = street_places(dataset, record)
        return places is not None and is_it(places, record)

    if not record.options:
        return lookup.find_cross_view(lambda one: is_it(one, record))
    dataset = lookup.find(has_places)
    return None if dataset is None else street_places(dataset, record)


def street_places(dataset: Dataset, record: SetRecord) -> StreetPlaces | None:
    """The dataset as the retrieval set of the record's options; None where no set has such options."""
    if record.options == {"positives": "pairs"}:
        return StreetPlaces(dataset, rule="pairs")
    radius, heading = record.options.get("radius"), record.options.get("heading")
    if not isinstance(radius, float) or isinstance(heading, str):
        return None
    try:
        return StreetPlaces(dataset, radius, heading)
    except ConfigError:
        return None


def _has_fingerprint(places: StreetPlaces | CrossViewSet, record: SetRecord) -> bool:
    named = places.name == record.name or (isinstance(places, CrossViewSet) and places.is_plain)
    return named and places.fingerprint == record.fingerprint


def _asks_the_same(places: StreetPlaces | CrossViewSet, record: SetRecord) -> bool:
    if places.rule == "radius" if isinstance(places, StreetPlaces) else places.is_plain:
        return False
    return places.name == record.name and bool(record.question) and places.content_id == record.question


def _tasks(places: StreetPlaces | CrossViewSet, record: SetRecord) -> Sequence[RetrievalTask]:
    if isinstance(places, CrossViewSet):
        return places.tasks(by_condition=True)
    return [places.task(pair_set) for pair_set in places.pair_sets if pair_set.name in record.tasks]


def _first_difference(
    record: SetRecord, places: StreetPlaces | CrossViewSet, tasks: Mapping[str, RetrievalTask]
) -> str | None:
    """The first entry of a record that differs from the set's own, in words."""
    entries = {
        "question": (record.question, places.content_id),
        "positives": (record.positives, places.positives),
        "options": (record.options, places.options),
    }
    for entry, (recorded, true) in entries.items():
        if recorded != true:
            return f"the entry '{entry}'"
    for name, claimed in record.tasks.items():
        if name not in tasks:
            return f"the task '{name}'"
        expected = task_record(tasks[name])
        if claimed.model_copy(update={"chance": {}}) != expected.model_copy(update={"chance": {}}):
            return f"the entry of the task '{name}'"
        if claimed.chance.keys() != expected.chance.keys() or any(
            not math.isclose(value, expected.chance[metric], abs_tol=1e-6) for metric, value in claimed.chance.items()
        ):
            return f"the chance level of the task '{name}'"
    if record.splits != splits_of(places, record.tasks):
        return "the entry 'splits'"
    return None


def _depths(lists: Sequence[Indices], task: RetrievalTask, keep: int | None, live: int) -> Indices:
    """(Q,) the rank up to which a query's list tells all ranks; NEVER where it holds all that was retrieved.

    Args:
        live: number of images in the gallery without junk.
    """
    out = np.full(len(lists), NEVER)
    for q, listed in enumerate(lists):
        kept = int(np.sum(~task.relevance.junk[listed]))
        if keep is not None and keep <= kept < live:
            out[q] = kept
    return out


def _fault(row: QueryAnswer, group: str, ranking: Ranking, q: int, depth: int, live: int) -> str | None:
    """What the row of query q claims that does not follow, in words."""
    positions = ranking.of(q)
    listed = tuple(int(position) + 1 for position in positions if position != NEVER)
    if row.positives != len(positions):
        return f"has {row.positives} positives, expected {len(positions)}"
    if row.group != group:
        return f"has the group '{row.group}', expected '{group}'"
    if (row.status == "ok") != bool(ranking.answered[q]):
        return f"has the status {row.status}"
    if tuple(rank for rank in row.ranks if rank <= depth) != listed:
        return f"has the ranks {_words(row.ranks)}, expected {_words(listed)}"
    if row.ranks and row.status != "ok":
        return f"has ranks and the status {row.status}"
    if any(rank > live for rank in row.ranks):
        return f"has the ranks {_words(row.ranks)} among {live} images"
    return None


def _words(ranks: Sequence[int]) -> str:
    first = " ".join(map(str, ranks[:5]))
    return f"{first} ..." if len(ranks) > 5 else first or "(none)"


def _believed(ranking: Ranking, depth: Indices) -> dict[str, float]:
    """The width of each metric's mean between all missing positives right behind the kept images, and never found."""
    best = ranking.position.copy()
    for q in np.flatnonzero(depth < NEVER):
        of_query = best[ranking.starts[q] : ranking.starts[q + 1]]
        missing = of_query == NEVER
        of_query[missing] = depth[q] + np.arange(int(missing.sum()))
    least, most = (
        score_retrieval(Ranking(ranking.starts, position, ranking.answered, ranking.gallery))
        for position in (ranking.position, best)
    )
    return {metric: float(np.mean(most.per_query(metric) - least.per_query(metric))) for metric in METRICS}

"""Reading a results folder of trackers, and what a board asks of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.errors import PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup, Truth
from relocbench.evaluation.common.folders import SetFolder
from relocbench.evaluation.common.results import (
    DatasetRecord,
    DatasetResults,
    MethodResults,
    PairSetRecord,
    RunRecord,
    all_results,
)
from relocbench.leaderboard.common.loading import BoardTask, Loaded, Plan, Standing, load_sets
from relocbench.leaderboard.tracking.marks import is_ranked
from relocbench.leaderboard.tracking.method import Method, read_method
from relocbench.leaderboard.tracking.model import RANKING, DatasetEntry, Row
from relocbench.leaderboard.tracking.rows import errors_of, per_pair, present, row_of
from relocbench.metrics import METRICS, metric_named


def load_results(
    results: Path, split: str | None = None, *, datasets: DatasetLookup | None = None
) -> list[DatasetEntry]:
    """Read all results of trackers in a results folder.

    Where a dataset is available, all errors on it are computed anew from predictions and truth; elsewhere the results
    are believed as far as their digests agree.

    Args:
        results: ``RESULTS``, or one of its ``DATASET@FINGERPRINT`` folders.
        split: only the pair sets of this split; datasets without such a split are left out.
        datasets: with their truth; without them, those in folders beside ``RESULTS``.

    Raises:
        PredictionError: with file and line: no results, a bad file, scores that are missing or stale, or errors that
            are not those of the predictions.
        ConfigError: a split that no dataset has.
        DatasetError: a dataset that was named is damaged.
    """
    all_results(results)  # refuses a folder that holds none
    loaded = load_sets(Trackers(), results, split, datasets or DatasetLookup(results))
    if not any(of.methods for of in loaded):
        raise PredictionError("holds no method's predictions; expected results of `relocbench evaluate`", results)
    return [_entry(of, split) for of in loaded]


def load_methods(
    folder: DatasetResults, labels: Collection[str], pair_sets: Collection[str], truth: Truth
) -> DatasetEntry:
    """The results of some methods on some pair sets of a dataset, scored anew. Raises PredictionError."""
    trackers, record = Trackers(), folder.record
    units = {name: of for name, of in trackers.units(record).items() if name in pair_sets}
    methods = tuple(trackers.read(m, record, units, truth) for m in folder.methods() if m.label in labels)
    return _entry(Loaded(record, methods, units, truth=truth), None)


def _entry(loaded: Loaded[DatasetRecord, PairSetRecord, Method, Truth], split: str | None) -> DatasetEntry:
    record, units = loaded.record, loaded.units
    splits = {name: names for name, names in record.splits.items() if split in (None, name)} or {"": tuple(units)}
    return DatasetEntry(
        **loaded.parts,
        splits={name: kept for name, names in splits.items() if (kept := tuple(n for n in names if n in units))},
        withheld=tuple(name for name in _chosen(record, split) if name not in units),
    )


def _chosen(record: DatasetRecord, split: str | None) -> list[str]:
    """The pair sets of a split, or all of them, those of splits first."""
    if split is not None:
        return list(record.splits[split])
    return list(dict.fromkeys([name for names in record.splits.values() for name in names] + list(record.pair_sets)))


@dataclass(frozen=True)
class Trackers(BoardTask[MethodResults, DatasetRecord, PairSetRecord, Method, Truth, Row]):
    """The task of trackers: pairs of two images, whose relative pose is asked."""

    ranked_by: str = RANKING
    """the metric that ranks"""
    identity: Method | None = None
    """what every method is compared with"""

    what = "trackers"
    kind = DatasetResults
    rankable = tuple(metric.name for metric in METRICS if metric.per_pair is not None)
    ranking = RANKING
    with_interval = tuple(metric.name for metric in METRICS if metric.with_interval and metric.per_pair is not None)

    def units(self, record: DatasetRecord, split: str | None = None) -> Mapping[str, PairSetRecord]:
        known = {name: record.pair_sets[name] for name in _chosen(record, split)}
        return {name: of for name, of in known.items() if of.has_truth and of.pairs > 0}

    def is_of(self, dataset: Dataset | CrossViewSet, record: DatasetRecord) -> bool:
        same = dataset.fingerprint == record.fingerprint or dataset.content_id == record.question
        return dataset.name == record.name and same

    def truth(
        self, folder: SetFolder[DatasetRecord, MethodResults], record: DatasetRecord, lookup: DatasetLookup
    ) -> Truth | None:
        return lookup.of(record, folder.record_file)

    def read(
        self, folder: MethodResults, record: DatasetRecord, units: Mapping[str, PairSetRecord], truth: Truth | None
    ) -> Method:
        return read_method(folder, record, units, truth)

    def renamed(self, method: Method, label: str) -> Method:
        return replace(method, label=label, run=method.run.model_copy(update={"method": label}))

    def question(self, method: Method, unit: str) -> object:
        return [(table.keys.tobytes(), table.groups) for table in method.tables(unit)]

    def table_of(self, folder: MethodResults, unit: str) -> Path:
        return folder.errors(unit)

    def values(self, method: Method, plan: Plan, metric: str) -> list[Array]:
        return [per_pair(metric_named(metric), rows) for rows in present(method, plan)]

    def alike(self, method: Method, plan: Plan) -> list[Array]:
        return [errors_of(rows) for rows in present(method, plan)]

    def row(self, method: Method, plan: Plan, standing: Standing) -> Row:
        return row_of(method, plan, standing, metric_named(self.ranked_by), self.identity)

    def runs(self, method: Method) -> Sequence[RunRecord]:
        return [method.run]

    def is_ranked(self, method: Method) -> bool:
        return is_ranked(method)

    def stands_last(self, method: Method) -> tuple[bool, ...]:
        return method.is_baseline, not is_ranked(method)

    def higher_is_better(self, metric: str) -> bool:
        return metric_named(metric).higher_is_better

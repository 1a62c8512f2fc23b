"""relocbench in a notebook: open a dataset, look at its pairs, run methods, and get the numbers as DataFrames.

``import relocbench as rb`` offers all of it as ``rb.open_dataset``, ``rb.iterate_pairs``, ``rb.evaluate``,
``rb.read_leaderboard``, ``rb.read_errors``, ``rb.trackers`` and ``rb.retrievers``; nothing is imported before it is
used.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.progress import Reporter, Silent
from relocbench.tracking import Query, Reference

if TYPE_CHECKING:
    import pandas as pd

    from relocbench.leaderboard.tracking.model import DatasetEntry


@dataclass(frozen=True, eq=False)
class PairView:
    """A pair as a tracker sees it, together with its true pose."""

    pair_set: str
    """name of its pair set"""
    pair: Pair
    """keys, group, overlap, and the uncertainty of the true pose"""
    reference: Reference
    """the keyframe: image, camera, and depth in metres or sparse points"""
    query: Query
    """the query: image and camera"""

    @property
    def T_query_ref(self) -> Array | None:
        """(4, 4) true pose, query camera from reference camera, metres; None where it is withheld."""
        return self.pair.T_query_ref


def open_dataset(folder: Path | str) -> Dataset:
    """Open a dataset folder as ``relocbench build-dataset`` writes it. Only its descriptions are read yet.

    Raises:
        DatasetError: no such folder, no dataset, an unfinished one, or content that does not match its fingerprint.
    """
    return Dataset(folder)


def iterate_pairs(
    dataset: Dataset, *, split: str | None = None, pair_set: str | None = None, neighbours: int = 0
) -> Iterator[PairView]:
    """Iterate over the accepted pairs of a dataset; each is read when it is reached.

    Args:
        split: only the pair sets of this split.
        pair_set: only this pair set.
        neighbours: number of posed frames before and after each keyframe that come with it.

    Raises:
        DatasetError: an unknown split or pair set, or a damaged file, when it is reached.
    """
    chosen = dataset.pair_sets(split)
    if pair_set is not None:
        wanted = dataset.pair_set(pair_set).name
        chosen = [one for one in chosen if one.name == wanted]
    for one in chosen:
        for pair in one.pairs:
            yield PairView(one.name, pair, dataset.reference(one, pair, neighbours), dataset.query(one, pair))


def evaluate(
    dataset: Dataset | Path | str,
    methods: str | Sequence[str],
    *,
    out: Path | str = "results",
    settings: Mapping[str, Any] | None = None,
    split: str | None = None,
    workers: int | None = None,
    seed: int = 0,
    reporter: Reporter | None = None,
) -> pd.DataFrame:
    """Run trackers on a dataset, and compare all results on it that the results folder then holds.

    This does what ``relocbench evaluate`` and ``relocbench leaderboard`` do: existing answers are kept, and a run that
    was killed resumes.

    Args:
        methods: names, dotted paths ``package.module:Class`` or ``LABEL=TARGET``.
        out: the results folder.
        settings: parameters of the methods, ``{"iterations": 5}`` or ``{"LABEL.iterations": 5}``.
        split: only the pair sets of this split.
        workers: number of processes; None: one for each core; 0: this process, without limits, for a debugger.
        seed: for methods that take one.
        reporter: receives progress.

    Returns:
        the table of :func:`read_leaderboard` for this dataset.

    Raises:
        RelocbenchError: a bad dataset, method or setting.
    """
    from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods

    options = EvaluateOptions(
        dataset=dataset.root if isinstance(dataset, Dataset) else Path(dataset),
        methods=(methods,) if isinstance(methods, str) else tuple(methods),
        set=tuple(f"{key}={value}" for key, value in (settings or {}).items()),
        out=Path(out),
        split=split,
        workers=workers,
        seed=seed,
    )
    report = evaluate_methods(options, reporter or Silent())
    return read_leaderboard(report.results, split=split, datasets=[options.dataset])


def read_leaderboard(
    results: Path | str,
    *,
    split: str | None = None,
    metric: str | None = None,
    datasets: Sequence[Path | str] = (),
) -> pd.DataFrame:
    """Compare the trackers in a results folder: a row for each dataset, pair set, group and method, ranked.

    The columns are those of ``leaderboard.csv``: shares from 0 to 1, metres, degrees, seconds.

    Args:
        results: the results folder, or one of its ``DATASET@FINGERPRINT`` folders; it is only read.
        split: only the pair sets of this split.
        metric: the metric that ranks methods; by default that of ``relocbench leaderboard``.
        datasets: datasets of the results, or folders with datasets in them; those in folders beside the results folder
            need not be named. Where one is available, all errors are computed anew from predictions and truth.

    Raises:
        PredictionError: no results, a bad file, scores that are missing or stale, or errors that are not those of the
            predictions.
        ConfigError: an unknown metric or split, or a dataset that no result is of.
        DatasetError: a folder in ``datasets`` that holds no dataset, or a damaged one.
    """
    import pandas as pd

    from relocbench.leaderboard.tracking.long_form import leaderboard_rows
    from relocbench.leaderboard.tracking.model import RANKING
    from relocbench.leaderboard.tracking.tables import make_board, ranking_metric

    ranked_by = metric or RANKING
    ranking_metric(ranked_by)  # an unknown metric is reported before anything is read
    entries = _entries(Path(results), split, datasets)
    board = make_board(entries, metric=ranked_by, split=split)
    return pd.DataFrame(leaderboard_rows(board))


def read_errors(results: Path | str, *, split: str | None = None, datasets: Sequence[Path | str] = ()) -> pd.DataFrame:
    """Read the errors of every pair and every tracker in a results folder; a failure has infinite errors.

    The columns are those of ``errors.csv``: translation in metres, rotation in degrees. Pairs of different places have
    the group ``elsewhere``; shares, areas and medians of leaderboards are without them. Datasets are as for
    :func:`read_leaderboard`.

    Raises:
        PredictionError, ConfigError, DatasetError: as :func:`read_leaderboard`.
    """
    import pandas as pd

    from relocbench.evaluation.tables.errors import NUMBERS

    frames = []
    for entry in _entries(Path(results), split, datasets):
        for name in entry.pair_sets:
            for method in (method for method in entry.methods if name in method.errors):
                for table in method.tables(name):
                    columns = {
                        "dataset": entry.record.name,
                        "pair_set": name,
                        "method": method.label,
                        "ref_timestamp_ns": table.keys[:, 0],
                        "query_timestamp_ns": table.keys[:, 1],
                        "group": table.groups,
                        "status": table.statuses,
                        **{column: table.column(column) for column in NUMBERS},
                    }
                    frames.append(pd.DataFrame(columns))
    return pd.concat(frames, ignore_index=True)


def _entries(results: Path, split: str | None, datasets: Sequence[Path | str]) -> list[DatasetEntry]:
    """The results of trackers, rescored with these datasets."""
    from relocbench.evaluation.common.dataset_lookup import DatasetLookup
    from relocbench.leaderboard.tracking.load import load_results

    lookup = DatasetLookup(results, [Path(folder) for folder in datasets])
    entries = load_results(results, split, datasets=lookup)
    lookup.check_used()
    return entries


def trackers() -> dict[str, str]:
    """The installed trackers: name -> ``package.module:Class``."""
    return _installed("tracking")


def retrievers() -> dict[str, str]:
    """The installed retrievers: name -> ``package.module:Class``."""
    return _installed("retrieval")


def _installed(task: str) -> dict[str, str]:
    from relocbench.methods import KINDS, installed_methods

    (kind,) = (kind for kind in KINDS if kind.task == task)
    return {name: point.value for name, point in installed_methods(kind).items()}

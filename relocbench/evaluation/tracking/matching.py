"""Measuring matching quality: how often a method finds a pixel from a start at a known distance from it.

Each pixel is asked once, from one start: from several starts around one pixel the pixel itself could be worked out.
The starts depend on the pair alone, so that they are the same for every method and every run. As with answers to pairs,
results go to a journal at once, and the table of a complete pair set is written whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.pairs.correspondences import Correspondences
from relocbench.errors import PredictionError, one_line
from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.common.runs import Asking, refuse_mixture
from relocbench.evaluation.isolation.handles import TrackerHandle
from relocbench.evaluation.isolation.journal import (
    answered_keys,
    append_entry,
    journal_entries,
    open_journal,
    remove_journal,
    write_entry,
)
from relocbench.evaluation.isolation.losses import LossHandler, run_until_answered
from relocbench.evaluation.isolation.worker import (
    Assignment,
    Unit,
    query_of,
    show_keyframe,
    time_factor,
    tracker_of,
    traversal_of,
)
from relocbench.evaluation.tables.matching import MATCHING, OFFSETS_PX, MatchingRow, check_complete
from relocbench.evaluation.tracking.run import new_record
from relocbench.execution import step
from relocbench.files import locked_folder
from relocbench.geometry import Camera
from relocbench.methods import MethodSpec

PER_PAIR = 1000
"""the largest number of visible correspondences of a pair that are used, each from one offset"""
_SEED = 1


@dataclass(frozen=True, eq=False)
class Starts:
    """The starts of one pair, one for each pixel, and the true pixels, which the method does not see."""

    uv_ref: Array
    """(N, 2) pixels of the reference, no two of them the same"""
    uv_query: Array
    """(N, 2) the true pixels of the query"""
    offset_px: Indices
    """(N,) distance of the start from the true pixel"""
    uv_start: Array
    """(N, 2) start pixels of the query"""

    def __len__(self) -> int:
        return len(self.offset_px)


def draw_starts(
    known: Correspondences,
    query: Camera,
    key: PairKey,
    per_pair: int = PER_PAIR,
    offsets_px: Sequence[int] = OFFSETS_PX,
    seed: int = _SEED,
) -> Starts:
    """Draw up to ``per_pair`` of a pair's visible correspondences, each with a start at one offset, in any direction.

    The offsets are drawn as well, so that each of them is used for as many pixels, give or take one. A pixel of the
    reference that occurs several times is used once. A start outside the query's image is rotated about the true pixel
    in quarter turns until it lies inside, so that pixels near the border are not lost.
    """
    rng = np.random.default_rng([seed, *(time % 2**64 for time in key)])
    visible = np.nonzero(known.visible)[0]
    _, first = np.unique(known.uv_ref[visible], axis=0, return_index=True)
    rows = np.sort(rng.choice(visible[first], min(per_pair, len(first)), replace=False))
    uv_ref, uv_query = known.uv_ref[rows], known.uv_query[rows]
    in_turn = np.resize(rng.permutation(np.asarray(offsets_px, dtype=np.int64)), len(rows))
    offset = rng.permutation(in_turn)
    angle = rng.uniform(0.0, 2 * np.pi, len(rows))
    step = offset[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    limit = np.array([query.width - 1, query.height - 1])
    for _ in range(3):
        outside = np.any((uv_query + step < 0) | (uv_query + step > limit), axis=1)
        step[outside] = step[outside] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    return Starts(uv_ref, uv_query, offset, uv_query + step)


def match_method(
    dataset: Dataset,
    pair_sets: Sequence[PairSet],
    spec: MethodSpec,
    folder: MethodResults,
    asking: Asking,
) -> None:
    """Measure what is missing of a method's matching quality; pair sets without correspondences are skipped.

    Args:
        folder: the results of the method, which has answered the pairs before, asked in the same way.

    Raises:
        PredictionError: the folder was made with other parameters or versions, or holds a bad ``PAIRSET.matching.csv``.
        DatasetError: an image or a correspondence file is bad.
    """
    with_truth = [s for s in pair_sets if dataset.layout.correspondence_file(s.name).exists()]
    todo = {s.name: _open_pairs(folder, s) for s in with_truth}
    left = [s for s in with_truth if not folder.matching(s.name).exists()]
    if not left:
        return
    assigned = Assignment.of(dataset, spec, asking.run.hiding(dataset.root, folder.root.parent), asking.seed)
    refuse_mixture(folder, new_record(assigned), work_left=True)

    def open_units() -> list[Unit]:
        # Units of all pair sets together: starting worker processes for each set would take longer than the work.
        return [
            unit
            for pair_set in left
            for unit in assigned.units(pair_set, _journal(folder, pair_set), _open_pairs(folder, pair_set))
        ]

    with ExitStack() as alone:
        for pair_set in left:
            alone.enter_context(locked_folder(_journal(folder, pair_set), PredictionError))
        stage = asking.reporter.stage(f"{spec.label}, matching on {dataset.name}", sum(map(len, todo.values())))
        with stage as advance:
            run_until_answered(_match_unit, open_units, LossHandler(_write_crash), assigned.run, advance)
        for pair_set in left:
            _collect(pair_set, folder)


def _journal(folder: MethodResults, pair_set: PairSet) -> Path:
    journal = folder.matching_journal(pair_set.name)
    journal.mkdir(parents=True, exist_ok=True)
    return journal


def _collect(pair_set: PairSet, folder: MethodResults) -> None:
    """Turn the journal into ``PAIRSET.matching.csv``, in the pair set's order."""
    journal = folder.matching_journal(pair_set.name)
    entries = {entry["key"]: entry for entry in journal_entries(journal)}
    rows: list[list[Any]] = [
        [*pair.key, pair.group, *counts, entries[pair.key]["message"]]
        for pair in pair_set.pairs
        for counts in entries[pair.key]["found"]
    ]
    MATCHING.write(folder.matching(pair_set.name), [MatchingRow(*row) for row in rows])
    remove_journal(journal)


def _open_pairs(folder: MethodResults, pair_set: PairSet) -> list[PairKey]:
    """The pairs of a set that are still to be measured."""
    path = folder.matching(pair_set.name)
    if path.exists():
        check_complete(MATCHING.read(path), [p.key for p in pair_set.pairs], path)
        return []
    done = answered_keys(folder.matching_journal(pair_set.name))
    return [p.key for p in pair_set.pairs if p.key not in done]


def _match_unit(unit: Unit) -> int:
    """Measure the pairs of a unit in a worker; returns their number."""
    tracker = tracker_of(unit)
    crash = show_keyframe(unit, tracker)
    with open_journal(unit.journal) as stream:
        for key in unit.keys:
            starts = _starts(unit, key)
            ends, message = (None, crash) if crash else _ask(tracker, unit, key, starts)
            write_entry(stream, _entry(key, starts, ends, message))
    return len(unit.keys)


def _starts(unit: Unit, key: PairKey) -> Starts:
    from relocbench.datasets.pairs.correspondence_file import read_correspondences  # needs pyarrow

    known = read_correspondences(_correspondence_file(unit.dataset, unit.pair_set), key)
    return draw_starts(known, traversal_of(unit.dataset, unit.query).camera(unit.query_camera, key[1]), key)


def _correspondence_file(dataset: Path, pair_set: str) -> Path:
    return DatasetLayout(dataset).correspondence_file(pair_set)


def _ask(tracker: TrackerHandle, unit: Unit, key: PairKey, starts: Starts) -> tuple[Array | None, str | None]:
    """Return where the method's matches end (N, 2), or None and how it crashed."""
    if not len(starts):
        return None, None
    query = query_of(unit, key)
    with step("", (key,), time_factor("match", unit)):
        return tracker.match(query, starts.uv_ref, starts.uv_start)


def _entry(key: PairKey, starts: Starts, ends: Array | None, message: str | None) -> dict[str, Any]:
    """A line of the journal; a method that crashed has found nothing."""
    where = np.full((len(starts), 2), np.nan) if ends is None else ends
    counts = [_count(offset, starts, where) for offset in OFFSETS_PX]
    return {
        "key": list(key),
        "found": counts,
        "message": one_line(message or ""),
    }


def _count(offset: int, starts: Starts, ends: Array) -> tuple[int, ...]:
    """The counts of one row of :class:`MatchingRow`, from the offset on."""
    rows = starts.offset_px == offset
    count = int(rows.sum())
    if not count:
        return offset, 0, 0, 0, 0, 0, 0
    answered = int(np.isfinite(ends[rows]).all(axis=1).sum())
    # Rounded to 1e-6 px, so that a start drawn 1 px from the truth is within 1 px; NaN is near nothing.
    away = [np.round(np.linalg.norm((at - starts.uv_query)[rows], axis=1), 6) for at in (ends, starts.uv_start)]
    return offset, count, answered, *(int(np.sum(distance <= px)) for distance in away for px in (1, 3))


def _write_crash(unit: Unit, key: PairKey, message: str) -> None:
    """Write the entry of a lost pair."""
    append_entry(unit.journal, _entry(key, _starts(unit, key), None, message))

"""Which pairs are shown: every n-th, up to a limit, spread along the drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.errors import DatasetError


@dataclass(frozen=True, eq=False)
class ShownPair:
    """A pair that is shown, and its place among all that are."""

    index: int
    """counts all shown pairs from 0: the value on the timeline ``pair``"""
    pair_set: PairSet
    pair: Pair


def chosen_sets(dataset: Dataset, names: Sequence[str]) -> list[PairSet]:
    """The named pair sets, or all. Raises DatasetError for an unknown name, or where there is no pair at all."""
    sets = [dataset.pair_set(name) for name in dict.fromkeys(names)] or dataset.pair_sets()
    if not any(s.evaluated for s in sets):
        raise DatasetError("holds no accepted pairs: there is nothing to show", dataset.root)
    return sets


def chosen_pairs(pair_sets: Sequence[PairSet], every: int, limit: int) -> list[ShownPair]:
    """Every ``every``-th pair of each set in the order of queries, thinned out evenly to ``limit`` of them.

    Args:
        limit: most pairs of a set; 0 for no limit.
    """
    shown: list[ShownPair] = []
    for pair_set in pair_sets:
        pairs = sorted(pair_set.evaluated, key=lambda p: (p.query_timestamp_ns, p.ref_timestamp_ns))[::every]
        if limit and len(pairs) > limit:
            rows = np.rint(np.linspace(0, len(pairs) - 1, limit)).astype(int)
            pairs = [pairs[row] for row in rows]
        shown += [ShownPair(len(shown) + i, pair_set, pair) for i, pair in enumerate(pairs)]
    return shown


def one_pair(pair_sets: Sequence[PairSet], key: tuple[int, int]) -> tuple[PairSet, Pair]:
    """The pair with these times, and its set.

    Raises:
        DatasetError: no accepted pair has these times, or pairs of several sets do.
    """
    found = [(s, s.by_key[key]) for s in pair_sets if key in s.by_key]
    where = ", ".join(s.name for s in pair_sets)
    if not found:
        lost = next(((s, p) for s in pair_sets for p in s.rejected if p.key == key), None)
        if lost is not None:
            why = f" ({lost[1].reason})" if lost[1].reason else ""
            raise DatasetError(f"the pair {key[0]} {key[1]} of {lost[0].name} was rejected{why}, and has no true pose")
        raise DatasetError(f"no accepted pair of the times {key[0]} and {key[1]} (keyframe, query) in {where}")
    if len(found) > 1:
        names = ", ".join(s.name for s, _ in found)
        raise DatasetError(f"the pair {key[0]} {key[1]} is in several pair sets ({names}); choose one by --pair-set")
    return found[0]


def nth_pair(pair_sets: Sequence[PairSet], index: int) -> tuple[PairSet, Pair]:
    """The pair at a place in the file of the one set. Raises DatasetError if there are several sets, or fewer pairs."""
    if len(pair_sets) != 1:
        names = ", ".join(s.name for s in pair_sets)
        raise DatasetError(f"--pair-index counts within one pair set; choose it by --pair-set from {names}")
    pairs = pair_sets[0].evaluated
    if index >= len(pairs):
        raise DatasetError(f"no pair {index} in {pair_sets[0].name}; its {len(pairs)} pairs count from 0")
    return pair_sets[0], pairs[index]

"""The order in which pairs are drawn: evenly over combinations of conditions, then traversals, then pairs.

The n-th draw is a function of n and the seed alone. Draws go through the combinations round after round, each round in
a random order of its own, so that combinations are drawn equally often and neighbours in a batch show different
weather. Within a combination the same holds for pairs of traversals, and within those for pairs of images.
"""

from __future__ import annotations

from baselines.training.random_streams import shuffled_round
from relocbench.training import TrainingData

_CONDITIONS, _TRAVERSALS, _PAIRS = range(3)


class EvenDraw:
    """Draws indices of training pairs."""

    def __init__(self, data: TrainingData, seed: int) -> None:
        groups: dict[tuple[str, ...], dict[tuple[str, ...], list[int]]] = {}
        for index in range(len(data)):
            label = data.label(index)
            drives = (label.dataset, label.traversal_ref, label.traversal_query, label.camera)
            groups.setdefault((label.condition_ref, label.condition_query), {}).setdefault(drives, []).append(index)
        self._groups = [[by_drive[drives] for drives in sorted(by_drive)] for _, by_drive in sorted(groups.items())]
        self._seed = seed

    @property
    def combinations(self) -> int:
        """The number of combinations of a reference's and a query's condition."""
        return len(self._groups)

    def __getitem__(self, draw: int) -> int:
        """The index of the pair of the ``draw``-th draw, counted from 0."""
        turn, group = shuffled_round(self._seed, (_CONDITIONS,), draw, len(self._groups))
        drives = self._groups[group]
        turn, drive = shuffled_round(self._seed, (_TRAVERSALS, group), turn, len(drives))
        _, pair = shuffled_round(self._seed, (_PAIRS, group, drive), turn, len(drives[drive]))
        return drives[drive][pair]

"""The order in which pairs are drawn: evenly over combinations of conditions, then traversals, then pairs.

The n-th draw is a function of n and the seed alone. Draws go through the combinations round after round, each round in
a random order of its own, so that combinations are drawn equally often and neighbours in a batch show different
weather. Within a combination the same holds for pairs of traversals, and within those for pairs of images.

A dataset with a share of its own gets that share of the draws, in which its pairs are drawn in this way by themselves:
of the first n draws floor(share n).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from fractions import Fraction

from baselines.training.random_streams import shuffled_round
from relocbench.errors import ConfigError
from relocbench.training import TrainingData

_CONDITIONS, _TRAVERSALS, _PAIRS = range(3)


class EvenDraw:
    """Draws indices of training pairs.

    Args:
        shares: share of the draws by a dataset's name, with its fingerprint (NAME@FINGERPRINT) where several have the
            name; all others are drawn evenly in the rest.

    Raises:
        ConfigError: a share is of a dataset that has no pairs, or of several, or nothing is left for the others.
    """

    def __init__(self, data: TrainingData, seed: int, shares: Mapping[str, float] | None = None) -> None:
        by_dataset: dict[str, list[int]] = {}
        for index in range(len(data)):
            by_dataset.setdefault(data.label(index).dataset, []).append(index)
        shares = {_owners_text(name, by_dataset): share for name, share in (shares or {}).items()}
        left, parts = Fraction(1), []
        for name in sorted(shares):
            share = Fraction(str(shares[name]))
            parts.append((share / left, _Rounds(data, by_dataset.pop(name), seed)))
            left -= share
        others = sorted(index for of_dataset in by_dataset.values() for index in of_dataset)
        if bool(others) != (left > 0):
            rest = (
                f"nothing is left for {', '.join(sorted(by_dataset))}"
                if others
                else "every dataset has one, and expected is 1"
            )
            raise ConfigError(f"shares add up to {float(1 - left):g}, but {rest}")
        if others:
            parts.append((Fraction(1), _Rounds(data, others, seed)))
        self._parts = parts

    @property
    def combinations(self) -> int:
        """The number of combinations of a reference's and a query's condition, those of each part by themselves."""
        return sum(rounds.combinations for _, rounds in self._parts)

    def __getitem__(self, draw: int) -> int:
        """The index of the pair of the ``draw``-th draw, counted from 0."""
        for share, rounds in self._parts:
            before = int(share * draw)
            if int(share * (draw + 1)) > before:
                return rounds[before]
            draw -= before
        raise AssertionError("the last part takes every draw")


def _owners_text(name: str, datasets: Collection[str]) -> str:
    """The label of the dataset that a name, or a name with fingerprint, tells."""
    of_name = sorted(label for label in datasets if name in (label, label.rpartition("@")[0]))
    if len(of_name) == 1:
        return of_name[0]
    if of_name:
        raise ConfigError(f"shares.{name}: {len(of_name)} datasets have that name, such as {of_name[0]}; say which")
    raise ConfigError(f"shares.{name}: no dataset has that name; the data has pairs of {', '.join(sorted(datasets))}")


class _Rounds:
    """Draws from some of the pairs."""

    def __init__(self, data: TrainingData, indices: Sequence[int], seed: int) -> None:
        groups: dict[tuple[str, ...], dict[tuple[str, ...], list[int]]] = {}
        for index in indices:
            label = data.label(index)
            drives = (label.dataset, label.traversal_ref, label.traversal_query, label.camera)
            groups.setdefault((label.condition_ref, label.condition_query), {}).setdefault(drives, []).append(index)
        self._groups = [[by_drive[drives] for drives in sorted(by_drive)] for _, by_drive in sorted(groups.items())]
        self._seed = seed

    @property
    def combinations(self) -> int:
        return len(self._groups)

    def __getitem__(self, draw: int) -> int:
        turn, group = shuffled_round(self._seed, (_CONDITIONS,), draw, len(self._groups))
        drives = self._groups[group]
        turn, drive = shuffled_round(self._seed, (_TRAVERSALS, group), turn, len(drives))
        _, pair = shuffled_round(self._seed, (_PAIRS, group, drive), turn, len(drives[drive]))
        return drives[drive][pair]

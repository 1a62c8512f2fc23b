"""The pairs of two traversals of a dataset, read from disk on demand."""

from __future__ import annotations

from functools import cached_property

from relocbench.datasets.core.layout import DatasetLayout, pair_set_parts
from relocbench.datasets.core.pair_table import read_pairs
from relocbench.datasets.core.pairfile import Pair, PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.errors import DatasetError


class PairSet:
    """All pairs of one reference traversal and one query traversal, of one camera each, which is mostly the same."""

    def __init__(self, layout: DatasetLayout, name: str) -> None:
        try:
            parts = pair_set_parts(name)
        except ValueError as bad:
            raise DatasetError(str(bad), layout.pair_file(name)) from None
        self.layout = layout
        self.name = name
        self.reference, self.query, self.reference_camera, self.query_camera = parts

    @property
    def cameras(self) -> tuple[str, str]:
        """The cameras of keyframes and queries."""
        return self.reference_camera, self.query_camera

    @cached_property
    def query_traversal(self) -> Traversal:
        """The drive of the queries. Raises DatasetError where its description is bad."""
        return Traversal(self.layout.traversal(self.query))

    @cached_property
    def all_pairs(self) -> list[Pair]:
        """Accepted and rejected pairs, in the table's order."""
        return read_pairs(self.layout.pair_file(self.name), self.layout.pair_table(self.name))

    @cached_property
    def evaluated(self) -> list[Pair]:
        """The accepted pairs, negative pairs among them: what methods are evaluated on."""
        return [p for p in self.all_pairs if p.accepted]

    @cached_property
    def pairs(self) -> list[Pair]:
        """The accepted pairs of one place: those that errors are scored on, that have correspondences and train."""
        return [p for p in self.evaluated if not p.is_negative]

    @cached_property
    def negative_pairs(self) -> list[Pair]:
        """The accepted negative pairs, of two different places: only confidences are judged by them."""
        return [p for p in self.evaluated if p.is_negative]

    @property
    def rejected(self) -> list[Pair]:
        """Pairs whose ground truth was rejected. They are never scored, only counted."""
        return [p for p in self.all_pairs if not p.accepted]

    @property
    def has_truth(self) -> bool:
        """Whether every evaluated pair has its true pose, which challenges withhold."""
        return all(p.T_query_ref is not None for p in self.evaluated)

    @cached_property
    def by_key(self) -> dict[PairKey, Pair]:
        """The evaluated pairs, by their times."""
        return {p.key: p for p in self.evaluated}

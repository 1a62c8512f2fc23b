"""What boards of all tasks have in common: a method with its results, and its row in a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from relocbench.metrics import Interval


class Method(Protocol):
    """The results of one method on one set."""

    @property
    def label(self) -> str: ...

    @property
    def answers(self) -> Mapping[str, Any]:
        """By pair set or task; those without results are absent."""
        ...


M_co = TypeVar("M_co", bound=Method, covariant=True)


@dataclass(frozen=True, eq=False)
class Row(Generic[M_co]):
    """A row for one method; it has no values if the method misses a pair set or task."""

    method: M_co
    values: Mapping[str, float | None]
    """by metric: means over the pair sets or tasks of means over what is asked; medians are over all together"""
    intervals: Mapping[str, Interval | None]
    rank: int | None
    """None if one is missing, and for a method that is not ranked"""
    failed: int | None = None
    """number of answers that the method declined"""
    broke: int | None = None
    """number of answers on which it raised, crashed or broke the contract"""
    missing: tuple[str, ...] = ()
    """the pair sets or tasks that are missing"""

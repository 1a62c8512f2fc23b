"""The counts of one pair: how many starts at each offset from the truth ended near it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

What = Literal["pixels", "translation", "rotation", "start"]
UNITS: dict[What, str] = {"pixels": "px", "translation": "m", "rotation": "deg"}
"""of the offsets of starts that lie at known distances; ``start`` has kinds of starts in place of distances"""


@dataclass(frozen=True)
class Tally:
    """The counts of one pair, with one entry for each offset."""

    what: What
    level: int | None
    """pyramid level that was used alone, for single pixels; None where the method worked as usual"""
    offsets: tuple[float, ...]
    """distances of the starts from the truth: pixels, metres or degrees; or the kinds of starts by number"""
    count: tuple[int, ...]
    """number of starts"""
    answered: tuple[int, ...]
    hits: Mapping[str, tuple[int, ...]]
    """number of ends near the truth, by name of the criterion"""
    start_hits: Mapping[str, tuple[int, ...]]
    """number of starts that already satisfy the criterion, which a method that does not move would get"""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a journal."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Tally:
        """Read what :meth:`to_dict` returned, after its conversion to JSON and back."""
        offsets, count, answered = (tuple(values[name]) for name in ("offsets", "count", "answered"))
        hits, start_hits = ({k: tuple(v) for k, v in values[name].items()} for name in ("hits", "start_hits"))
        return cls(values["what"], values["level"], offsets, count, answered, hits, start_hits)

    def missed(self, level: int, names: Sequence[str]) -> Tally:
        """The tally of the same starts on one level, without any answer."""
        none = tuple(0 for _ in self.count)
        return Tally(
            self.what, level, self.offsets, self.count, none, dict.fromkeys(names, none), dict.fromkeys(names, none)
        )

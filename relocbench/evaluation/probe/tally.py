"""What is counted of one pair: from starts so far off the truth, how many ended near it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

What = Literal["pixels", "translation", "rotation"]
UNITS: dict[What, str] = {"pixels": "px", "translation": "m", "rotation": "deg"}


@dataclass(frozen=True)
class Tally:
    """Counts of one pair, one entry an offset."""

    what: What
    level: int | None
    """of single pixels: worked on this level alone; None where the method worked as it always does"""
    offsets: tuple[float, ...]
    """how far the starts are from the truth: pixels, metres or degrees"""
    count: tuple[int, ...]
    """starts"""
    answered: tuple[int, ...]
    hits: Mapping[str, tuple[int, ...]]
    """ends near the truth, by name of what is near"""
    start_hits: Mapping[str, tuple[int, ...]]
    """starts that were as near already: what a method gets that does not move"""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a journal."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Tally:
        """What :meth:`to_dict` gave, after its way through JSON."""
        offsets, count, answered = (tuple(values[name]) for name in ("offsets", "count", "answered"))
        hits, start_hits = ({k: tuple(v) for k, v in values[name].items()} for name in ("hits", "start_hits"))
        return cls(values["what"], values["level"], offsets, count, answered, hits, start_hits)

    def missed(self, level: int, names: Sequence[str]) -> Tally:
        """The same starts on one level with no answer at all."""
        none = tuple(0 for _ in self.count)
        return Tally(
            self.what, level, self.offsets, self.count, none, dict.fromkeys(names, none), dict.fromkeys(names, none)
        )

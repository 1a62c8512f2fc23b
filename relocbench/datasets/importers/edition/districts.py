"""Districts whose seeds follow from a phrase.

Who chooses seeds by hand can choose those on which a method looks well. A phrase that is written down before a method
is finished leaves no choice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

CONDITIONS = (
    "Fog",
    "Neutral",
    "Night",
    "Overcast",
    "Rain",
    "Snow",
    "SoftRainNoon",
    "Sunny",
    "WetCloudySunset",
    "WetNoon",
)
"""from which the conditions of a district are drawn"""
_DRAWN = 3


@dataclass(frozen=True)
class District:
    """One district."""

    number: int
    """from 1"""
    seed: int
    conditions: tuple[str, ...]
    """three different ones, each of which is a map for queries of all three"""


def districts(phrase: str, count: int) -> Iterator[District]:
    """Yield the districts of a phrase.

    The seed of district K is the number of the first seven hexadecimal digits of the SHA-256 of ``PHRASE / K``. Its
    conditions are the three whose ``PHRASE / K / NAME`` have the smallest SHA-256.
    """
    for number in range(1, count + 1):
        text = f"{phrase} / {number}"
        drawn = sorted(CONDITIONS, key=lambda name: _digest(f"{text} / {name}"))[:_DRAWN]
        yield District(number, int(_digest(text)[:7], 16), tuple(drawn))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()

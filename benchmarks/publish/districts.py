"""Test districts whose seeds follow from a phrase: print the seed and the conditions of each.

Who chooses seeds by hand can choose those on which a method looks well. The phrase of ``docs/test-districts.md`` was
written down before the methods that are tested on it were finished, and the districts follow from it.

    python benchmarks/publish/districts.py [--next]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass

PHRASE = "eleven umbrellas crossed the bridge before the lamps were lit"
NEXT_PHRASE = "nine ferries waited while the lighthouse keeper learned to whistle"
"""of districts that nobody was asked yet: those of the next publication"""
COUNT = 12
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
    """One test district."""

    number: int
    """from 1"""
    seed: int
    conditions: tuple[str, ...]
    """three different ones, each of which is a map for queries of all three"""


def districts(phrase: str = PHRASE, count: int = COUNT) -> Iterator[District]:
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--next", action="store_true", help="those of the phrase that was asked nothing yet")
    phrase = NEXT_PHRASE if parser.parse_args().next else PHRASE
    found = list(districts(phrase))
    for district in found:
        print(f"district {district.number:2d}: seed {district.seed}, {', '.join(district.conditions)}")
    print(json.dumps({"benchmark": "districts", "phrase": phrase, "seeds": [d.seed for d in found]}))


if __name__ == "__main__":
    main()

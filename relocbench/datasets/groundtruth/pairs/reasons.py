"""Reasons for rejection by kind: the same sentence with other numbers is the same kind."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_NUMBER = re.compile(r"\d+(\.\d+)?(e[-+]?\d+)?")
_LENGTH = re.compile(r"(?<![\w.])(\d+(?:\.\d+)?)(?= (?:m|cm|mm)\b)")
"""a number before a unit of length"""


def kind_of(reason: str) -> str:
    """The reason with its numbers replaced by dots: ``no keyframe within … m: nearest … m``."""
    return _NUMBER.sub("…", reason)


def common(reasons: Sequence[str]) -> str:
    """One sentence for several reasons of a kind; it keeps the numbers that all have in common, such as a limit.

    For example ``no keyframe within 5 m: nearest … m``.
    """
    numbers = [[match.group() for match in _NUMBER.finditer(reason)] for reason in reasons]
    same = [values[0] if len(set(values)) == 1 else "…" for values in zip(*numbers, strict=True)]
    left = iter(same)
    return _NUMBER.sub(lambda _: next(left), reasons[0])


def by_kind(reasons: Iterable[str]) -> dict[str, list[str]]:
    """kind -> its reasons, the most frequent kind first, in alphabetical order among equals."""
    kinds: dict[str, list[str]] = {}
    for reason in reasons:
        kinds.setdefault(kind_of(reason), []).append(reason)
    return dict(sorted(kinds.items(), key=lambda item: (-len(item[1]), item[0])))


def reduced_words(words: str, factor: float) -> str:
    """Words in which every length is divided by the factor, to two digits: with 8, ``12 m`` become ``1.5 m``."""
    if factor == 1.0:
        return words
    return _LENGTH.sub(lambda length: f"{float(f'{float(length.group()) / factor:.2g}'):g}", words)

"""Shares and radii of all methods, by the conditions of reference and query."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import PairKey
from relocbench.evaluation.probe.pixels import NEAR, NEAR_ON_LEVEL, level_names
from relocbench.evaluation.probe.poses import CONVERGED
from relocbench.evaluation.probe.starts import StartLine, start_line
from relocbench.evaluation.probe.tally import UNITS, Tally, What
from relocbench.evaluation.probe.work import PairResult
from relocbench.metrics import Radius, Ratio, radius_of, radius_ratio

Answers = Mapping[tuple[str, PairKey], PairResult]

ACROSS, SAME = "across conditions", "same condition"


@dataclass(frozen=True, eq=False)
class Line:
    """The results of one method on the pairs of one combination of conditions."""

    method: str
    what: What
    level: int | None
    conditions: str
    """``A → B`` of reference and query, :data:`ACROSS` or :data:`SAME`"""
    criterion: str
    pairs: int
    offsets: tuple[float, ...]
    counts: tuple[int, ...]
    """number of starts at each offset"""
    shares: Array
    """(K,) share of successes, mean over pair sets of the mean over their pairs"""
    start_shares: Array
    """(K,) the share that the starts themselves would get"""
    radius: Radius | None
    """where the share falls below a half; None unless ``criterion`` is the main one"""
    ratio: Ratio | None
    """of this radius to that of the first method"""
    half_left: Radius | None
    """where the share falls below half of the share from the truth: the width of the basin, whatever its height"""
    half_ratio: Ratio | None


def main_criterion(what: What, level: int | None) -> str:
    """The criterion of success where a single one is needed."""
    if what != "pixels":
        return CONVERGED
    return NEAR if level is None else NEAR_ON_LEVEL


def result_lines(answers: Mapping[str, Answers], conditions: Mapping[str, tuple[str, str]]) -> list[Line]:
    """All lines, in groups: all conditions together first, then each combination of conditions.

    Args:
        answers: by method; the other methods are compared with the first one.
        conditions: the conditions of each pair set's reference and query.
    """
    out: list[Line] = []
    first = next(iter(answers))
    whole = _whole(answers)
    for what, level in _kinds(whole):
        for group, names in _groups(conditions):
            base = _values(whole[first], names, what, level, main_criterion(what, level))
            for method in answers:
                out += _lines(method, whole[method], names, what, level, group, base if method != first else None)
    return out


def start_lines(answers: Mapping[str, Answers], conditions: Mapping[str, tuple[str, str]]) -> list[StartLine]:
    """The lines of the start from the keyframe's pose, in the same groups; none where it was not probed."""
    out = []
    for group, names in _groups(conditions):
        for method, found in _whole(answers).items():
            tallies = [
                [pair["start", None] for pair in found.get(name, ()) if ("start", None) in pair] for name in names
            ]
            if any(tallies):
                out.append(start_line(method, group, [some for some in tallies if some]))
    return out


def _whole(answers: Mapping[str, Answers]) -> dict[str, dict[str, list[dict[tuple[What, int | None], Tally]]]]:
    return {method: _completed(found) for method, found in answers.items()}


def _lines(
    method: str,
    found: Mapping[str, list[dict[tuple[What, int | None], Tally]]],
    names: Sequence[str],
    what: What,
    level: int | None,
    group: str,
    base: list[Array] | None,
) -> Iterator[Line]:
    tallies = [t[what, level] for name in names for t in found[name] if (what, level) in t]
    if not tallies:
        return
    main = main_criterion(what, level)
    offsets = tallies[0].offsets
    for criterion in tallies[0].hits:
        values = _values(found, names, what, level, criterion)
        starts = _values(found, names, what, level, criterion, of_starts=True)
        radius = ratio = half_left = half_ratio = None
        if criterion == main:
            radius, half_left = (radius_of(values, offsets, relative=relative) for relative in (False, True))
            if base:
                ratio, half_ratio = (
                    radius_ratio(values, base, offsets, relative=relative) for relative in (False, True)
                )
        yield Line(
            method,
            what,
            level,
            group,
            criterion,
            len(tallies),
            offsets,
            tuple(int(n) for n in np.sum([t.count for t in tallies], axis=0)),
            np.mean([v.mean(axis=1) for v in values], axis=0),
            np.mean([v.mean(axis=1) for v in starts], axis=0),
            radius,
            ratio,
            half_left,
            half_ratio,
        )


def _completed(answers: Answers) -> dict[str, list[dict[tuple[What, int | None], Tally]]]:
    """The tallies of each pair set by reference time; where asking for levels broke, nothing was found on them.

    A level on which no pixel of any pair was answered is one that the method does not have.
    """
    levels = {t.level for a in answers.values() for t in a.tallies if t.level is not None and any(t.answered)}
    out: dict[str, list[dict[tuple[What, int | None], Tally]]] = {}
    for (name, _), answered in sorted(answers.items()):
        found = {(t.what, t.level): t for t in answered.tallies if t.level is None or t.level in levels}
        whole = found.get(("pixels", None))
        if whole is not None:
            for level in levels:
                found.setdefault(("pixels", level), whole.missed(level, level_names()))
        out.setdefault(name, []).append(found)
    return out


def _kinds(
    whole: Mapping[str, Mapping[str, list[dict[tuple[What, int | None], Tally]]]],
) -> list[tuple[What, int | None]]:
    found = {kind for sets in whole.values() for pairs in sets.values() for pair in pairs for kind in pair}
    found = {kind for kind in found if kind[0] in UNITS}
    return sorted(found, key=lambda k: (list(UNITS).index(k[0]), -1 if k[1] is None else k[1]))


def _groups(conditions: Mapping[str, tuple[str, str]]) -> Iterator[tuple[str, list[str]]]:
    """The names of groups of conditions, each with its pair sets."""
    for title, alike in ((ACROSS, False), (SAME, True)):
        names = [name for name, (a, b) in conditions.items() if (a == b) == alike]
        if names:
            yield title, names
    for a, b in sorted(set(conditions.values())):
        yield f"{a} → {b}", [name for name, pair in conditions.items() if pair == (a, b)]


def _values(
    found: Mapping[str, list[dict[tuple[What, int | None], Tally]]],
    names: Sequence[str],
    what: What,
    level: int | None,
    criterion: str,
    *,
    of_starts: bool = False,
) -> list[Array]:
    """The share of successes of each pair at each offset, (K, N) for each pair set."""
    out = []
    for name in names:
        tallies = [t[what, level] for t in found[name] if (what, level) in t]
        if tallies:
            hits = [(t.start_hits if of_starts else t.hits)[criterion] for t in tallies]
            out.append(np.array(hits, dtype=np.float64).T / np.array([t.count for t in tallies], dtype=np.float64).T)
    return out

"""Statistics and tables of ``real_clouds.py``: agreement of methods, closure of triangles, and success by start."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from real_clouds_kitti import kitti_00
from real_clouds_methods import (
    OWN,
    Answers,
    Search,
    adjusted,
    allowed,
    apart,
    best,
    judged,
    methods,
    spread_m,
    turned_identities,
)
from real_clouds_scans import Pair, Scans

from relocbench.arrays import Array
from relocbench.datasets.importers.kitti.recording import REAL_ELEVATION_DEG
from relocbench.geometry import invert

CLOSE = (0.03, 0.15)
"""limits in metres and degrees that a registration should meet"""
RIGHT = (0.3, 1.0)
"""metres and degrees within which a registration is right"""


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def within(T: Array | None, other: Array, limits: tuple[float, float]) -> bool:
    if T is None:
        return False
    metres, degrees = apart(T, other)
    return metres <= limits[0] and degrees <= limits[1]


def far(differences: Iterable[tuple[float, float]]) -> dict[str, float]:
    """The root mean square and the maximum of errors in metres and degrees."""
    values = np.array(list(differences))
    rms, most = np.sqrt(np.mean(np.square(values), axis=0)), values.max(axis=0)
    names = ("rms_cm", "rms_deg", "max_cm", "max_deg")
    scale = (100, 1, 100, 1)
    return {n: round(float(v) * s, 3) for n, v, s in zip(names, [*rms, *most], scale, strict=True)}


@dataclass(frozen=True, eq=False)
class Precision:
    """The answers of all methods for one set of scans."""

    scans: Scans
    answers: dict[str, Answers]
    """by method"""

    def off_graph(self, name: str, pair: Pair) -> tuple[float, float]:
        return apart(self.answers[name][pair], self.scans.by_graph(pair))

    def mutual(self, pair: Pair) -> tuple[float, float]:
        """The largest differences between any two methods, metres and degrees."""
        poses = [found[pair] for found in self.answers.values()]
        pairs = np.array([apart(a, b) for k, a in enumerate(poses) for b in poses[:k]])
        return float(pairs[:, 0].max()), float(pairs[:, 1].max())

    def closures(self, name: str) -> list[tuple[float, float]]:
        T = self.answers[name]
        return [apart(T[a, b] @ T[b, c], T[a, c]) for a, b, c in self.scans.triangles]

    def adjusted(self, name: str) -> Answers:
        """The relative poses of the scans, adjusted to the registrations of one method."""
        T = adjusted(self.scans, self.answers[name])
        return {(a, b): np.asarray(invert(T[a]) @ T[b]) for a, b in self.scans.pairs}


def register_all(scans: Scans) -> Precision:
    """Register every pair by every method, from the graph's pose."""
    found = {
        name: {pair: method(scans, pair, scans.by_graph(pair)) for pair in scans.pairs}
        for name, method in methods().items()
    }
    return Precision(scans, found)


def mean_spread(scans: Scans, answers: Answers) -> float:
    """The mean over all pairs, centimetres."""
    return round(100 * float(np.mean([spread_m(scans, pair, answers[pair]) for pair in scans.pairs])), 3)


def tell_precision(found: Precision) -> dict[str, Any]:
    """Print tables of pairs, triangles and adjusted poses; return the statistics."""
    scans, names = found.scans, list(found.answers)
    say(f"\n{scans.source.title}: off the graph, and the largest difference between two methods (cm/deg)")
    say(f"{'pair':5s} {'m':>5s} {'overlap':>7s} " + " ".join(f"{n:>14s}" for n in [*names, "mutual"]))
    for pair in scans.pairs:
        cells = [found.off_graph(name, pair) for name in names] + [found.mutual(pair)]
        say(
            f"{pair[0]}-{pair[1]}   {np.linalg.norm(scans.by_graph(pair)[:3, 3]):5.1f} {scans.overlap(pair):7.0%} "
            + " ".join(f"{100 * m:8.1f}/{d:.2f} " for m, d in cells)
        )
    graph = {pair: scans.by_graph(pair) for pair in scans.pairs}
    result: dict[str, Any] = {
        "pairs": len(scans.pairs),
        "graph_outside_methods": sum(
            min(found.off_graph(name, pair)[0] for name in names) > found.mutual(pair)[0] for pair in scans.pairs
        ),
        "mutual": far(found.mutual(pair) for pair in scans.pairs),
        "neighbours": far(found.off_graph(OWN, (a, b)) for a, b in scans.pairs if b == a + 1),
        "methods": {},
    }
    say(
        f"{'cm, rms and max':15s} {'within':>6s} {'off graph':>12s} {'off ours':>12s} {'triangles':>12s} "
        f"{'to adjusted':>12s} {'adj.-graph':>12s} {'adj.-ours':>12s} {'spread':>6s}"
    )
    own = found.adjusted(OWN)
    for name in names:
        answers, mine = found.answers[name], found.adjusted(name)
        compared = {
            "off_graph": far(apart(answers[p], graph[p]) for p in scans.pairs),
            "off_ours": far(apart(answers[p], found.answers[OWN][p]) for p in scans.pairs),
            "triangles": far(found.closures(name)),
            "off_adjusted": far(apart(answers[p], mine[p]) for p in scans.pairs),
            "adjusted_off_graph": far(apart(mine[p], graph[p]) for p in scans.pairs),
            "adjusted_off_ours": far(apart(mine[p], own[p]) for p in scans.pairs),
        }
        close = sum(within(answers[p], graph[p], CLOSE) for p in scans.pairs)
        spread_cm = mean_spread(scans, answers)
        result["methods"][name] = {"within_of_graph": close, "spread_cm": spread_cm, **compared}
        columns = " ".join(f"{d['rms_cm']:6.1f} {d['max_cm']:5.1f}" for d in compared.values())
        say(f"{name:15s} {close:6d} {columns} {spread_cm:6.2f}")
    result["graph_spread_cm"] = mean_spread(scans, graph)
    say(
        f"within: pairs of {len(scans.pairs)} within 3 cm and 0.15 deg of the graph. spread: of points over the other "
        f"scan's surfaces, {result['graph_spread_cm']:.2f} at the graph's poses.\n"
        f"Every method is further from the graph than any two from each other: {result['graph_outside_methods']} pairs"
    )
    return result


def tell_starts(scans: Scans, count: int, seed: int) -> dict[str, Any]:
    """Register every pair from rotated starts and without a prior; return the statistics."""
    search = Search(scans.sides)
    say(f"\n{scans.source.title}: right places from {count} turned identities a pair, and from no prior")
    say(f"{'pair':5s} {'refined alone':>13s} {'with guesses':>12s} {'off graph cm/deg':>17s} "
        f"{'search':>7s} {'and coarse':>10s} {'off graph cm/deg':>17s}")  # fmt: skip
    sums = dict.fromkeys(("alone", "with_guesses", "with_guesses_close", "search", "coarse", "coarse_close"), 0)
    for number, pair in enumerate(scans.pairs):
        graph = scans.by_graph(pair)
        by_search = [[judged(scans, pair, T) for T in guesses] for guesses in search.guesses(pair)]
        everything = [candidate for some in by_search for candidate in some]
        alone = [judged(scans, pair, start) for start in turned_identities(count, seed + number)]
        chosen = [best([own, *allowed(own.guess, everything)]) for own in alone]
        first, coarse = best(by_search[0]), best(everything)
        row = {
            "alone": sum(within(c.T_ref_query, graph, RIGHT) for c in alone),
            "with_guesses": sum(within(T, graph, RIGHT) for T in chosen),
            "with_guesses_close": sum(within(T, graph, CLOSE) for T in chosen),
            "search": int(within(first, graph, RIGHT)),
            "coarse": int(within(coarse, graph, RIGHT)),
            "coarse_close": int(within(coarse, graph, CLOSE)),
        }
        sums = {key: sums[key] + row[key] for key in sums}
        off = max((apart(T, graph) for T in chosen if T is not None), default=(np.nan, np.nan))
        end = apart(coarse, graph) if coarse is not None else (np.nan, np.nan)
        say(
            f"{pair[0]}-{pair[1]}   {row['alone']:13d} {row['with_guesses']:12d} {100 * off[0]:12.1f}/{off[1]:.2f} "
            f"{row['search']:7d} {row['coarse']:10d} {100 * end[0]:12.1f}/{end[1]:.2f}"
        )
    total = count * len(scans.pairs)
    say(
        f"of {total} starts: {sums['alone']} right by refinement alone, {sums['with_guesses']} with guesses "
        f"({sums['with_guesses_close']} within 3 cm, 0.15 deg of the graph); of {len(scans.pairs)} pairs from no "
        f"prior: {sums['search']} by the search, {sums['coarse']} with the coarse one ({sums['coarse_close']} within)"
    )
    return {"starts": total, "pairs": len(scans.pairs), **sums}


def tell_kitti_00(folder: Path, elevations_deg: Sequence[float] = (0.0, REAL_ELEVATION_DEG)) -> dict[str, Any]:
    """Evaluate odometry and depth of the six scans, as they are and with the beams raised."""
    out = {}
    for elevation in elevations_deg:
        found = kitti_00(folder, elevation)
        errors = 100 * found.errors_m
        say(f"\nKITTI 00, beams raised by {elevation:.3f} deg")
        say("frames 0 to 1..5 along the track: " + ", ".join(f"{m:.3f}" for m in found.along_m)
            + f" m; off the reference by {', '.join(f'{e:+.1f}' for e in errors)} cm")  # fmt: skip
        say(f"depth of frame 0 from lidar at {found.coverage:.0%} of the pixels; against stereo {found.agreement}")
        out[f"elevation_{elevation:.3f}"] = {
            "along_m": [round(float(m), 4) for m in found.along_m],
            "max_error_cm": round(float(np.abs(errors).max()), 2),
            "coverage": round(found.coverage, 3),
            **{key: round(value, 3) for key, value in vars(found.agreement).items()},
        }
    return out

"""Whether intervals cover and ranks hold their error rate, on simulated drives whose true values are known.

The error of a pair is ``exp(s x)``, where x is a first-order autoregression along the drive: N pairs, correlation rho
from one to the next. Simulated are

- the coverage of 95 % intervals of shares, of areas under the curves of light- and heavy-tailed errors, of
  medians and of paired differences, on one set and as means over four and ten sets;
- how often ten equal methods on four sets get different ranks, whether they err on the same pairs or not;
- how often a method that is better by 10 points is told apart from nine others.

Coverage counts the intervals that are given. Cells in which few are given are taken together. ``half noise`` is beyond
what the intervals promise: half of the variance of x is white, so that the correlation hides behind noise.

    python benchmarks/truth/intervals.py [--quick] [--drives N] [--tables N] [--workers N] [--seed N]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtr, ndtri

from relocbench.arrays import Array
from relocbench.metrics.statistics.intervals import Interval, mean_interval, median_interval, paired_difference
from relocbench.metrics.statistics.ranks import different_methods, rank_with_ties

PAIRS = (16, 40, 64, 128, 360, 1000, 5000)
CORRELATIONS = (0.0, 0.5, 0.8, 0.9, 0.95)
SHARES = (0.5, 0.7, 0.9, 0.95, 0.99, 1.0)
"""the intervals of shares below a half are the mirror images of these"""
SPREADS = (0.5, 2.0)
"""s: a light and a heavy tail of errors"""
AREA_QUANTILES = (0.5, 0.95, 0.999)
"""shares of errors below the threshold of an area"""
DIFFERENCES = ((0.7, 0.7), (0.95, 0.95), (0.5, 0.6))
"""true shares of two methods"""
SEVERAL = ((4, 16), (4, 64), (4, 360), (10, 16), (10, 64))
"""number of sets, and of pairs of each"""
RANKED = (16, 64, 250, 1000)
RANK_CORRELATIONS = (0.0, 0.5, 0.9)
METHODS, SETS = 10, 4
LEAST_COVERAGE, MOST_RANK_ERRORS, LEAST_TOLD_APART = 0.92, 0.07, 0.80
LEAST_GIVEN = 0.4
"""share of the drives of a cell that need an interval for a coverage of its own"""


@dataclass(frozen=True)
class Coverage:
    """How often one kind of interval covered in one kind of drive."""

    what: str
    sets: int
    pairs: int
    correlation: float
    noise: float
    drives: int
    given: int
    covered: int

    @property
    def share(self) -> float:
        return self.covered / self.given if self.given else math.nan


@dataclass(frozen=True)
class RankErrors:
    """How often methods got different ranks."""

    pairs: int
    correlation: float
    shared: float
    """share of the variance of errors that methods have in common"""
    drives: int
    different: int
    """simulations in which equal methods got different ranks"""
    told_apart: int
    """simulations in which a method better by 10 points was told apart from all others, on all sets together"""
    told_apart_on_one_set: float
    """mean number of others that it was told apart from, on one set"""


def drives(rng: np.random.Generator, count: int, pairs: int, correlation: float, noise: float = 0.0) -> Array:
    """(count, pairs) stationary autoregressions of variance 1, of which ``noise`` is white."""
    steps = rng.normal(size=(count, pairs)) * math.sqrt(1 - correlation**2)
    steps[:, 0] = rng.normal(size=count)
    smooth = lfilter([1.0], [1.0, -correlation], steps, axis=-1)
    out: Array = math.sqrt(1 - noise) * smooth + math.sqrt(noise) * rng.normal(size=(count, pairs))
    return out


def right(x: Array, share: float) -> Array:
    """1 where an error is among the smallest ``share`` of all errors."""
    return (x < ndtri(share)).astype(np.float64)


def area(spread: float, quantile: float) -> tuple[float, Callable[[Array], Array]]:
    """The true area under the curve up to that quantile of errors, and its per-pair values."""
    threshold = math.exp(spread * float(ndtri(quantile)))
    grid = np.linspace(-9, 9, 100001)
    values = np.maximum(0.0, 1 - np.exp(spread * grid) / threshold)
    true = float(np.sum(values * np.exp(-(grid**2) / 2)) / np.sum(np.exp(-(grid**2) / 2)))
    return true, lambda x: np.maximum(0.0, 1 - np.exp(spread * x) / threshold)


def intervals(
    rng: np.random.Generator, sets: int, pairs: int, correlation: float, noise: float
) -> Iterator[tuple[str, float, Interval | None]]:
    """Simulate one set of drives; yields what was estimated, its true value and its interval."""
    own, other = (drives(rng, sets, pairs, correlation, noise) for _ in range(2))
    errors = [np.exp(x)[None] for x in own]
    for share in SHARES:
        yield f"share {share:g}", share, mean_interval([right(x, share) for x in own], errors)
    for spread in SPREADS:
        for quantile in AREA_QUANTILES:
            true, values = area(spread, quantile)
            yield f"area {spread:g} {quantile:g}", true, mean_interval([values(x) for x in own], errors)
    if sets == 1:
        yield "median", 1.0, median_interval(np.exp(own[0]))
    for a, b in DIFFERENCES:
        found = paired_difference([right(x, a) for x in own], [right(x, b) for x in other])
        yield f"difference {a:g} {b:g}", a - b, found.interval


def coverage(cell: tuple[int, int, float, float, int, int]) -> list[Coverage]:
    """The coverage of every kind of interval in one cell."""
    sets, pairs, correlation, noise, count, seed = cell
    rng = np.random.default_rng([seed, sets, pairs, round(1000 * correlation), round(1000 * noise)])
    given: Counter[str] = Counter()
    covered: Counter[str] = Counter()
    for _ in range(count):
        for what, true, interval in intervals(rng, sets, pairs, correlation, noise):
            given[what] += interval is not None
            covered[what] += interval is not None and interval.low - 1e-12 <= true <= interval.high + 1e-12
    return [Coverage(what, sets, pairs, correlation, noise, count, given[what], covered[what]) for what in given]


def rank_errors(cell: tuple[int, float, float, int, int]) -> RankErrors:
    """The errors of ranks in one cell."""
    pairs, correlation, shared, count, seed = cell
    rng = np.random.default_rng([seed, pairs, round(1000 * correlation), round(1000 * shared)])
    better = np.array([0.6] + [0.5] * (METHODS - 1))[:, None]
    different = apart = 0
    alone = 0.0
    for _ in range(count):
        x = [
            math.sqrt(shared) * drives(rng, 1, pairs, correlation)
            + math.sqrt(1 - shared) * drives(rng, METHODS, pairs, correlation)
            for _ in range(SETS)
        ]
        equal = {str(m): [right(of[m], 0.5) for of in x] for m in range(METHODS)}
        different += len(set(rank_with_ties(equal, rng).values())) > 1
        values = [(ndtr(of) < better).astype(np.float64) for of in x]
        apart += bool(different_methods(values, rng)[0, 1:].all())
        alone += float(different_methods(values[:1], rng)[0, 1:].sum())
    return RankErrors(pairs, correlation, shared, count, different, apart, alone / count)


def main() -> None:
    """Simulate, print tables and the worst cells; exits with 1 where a promise is broken."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer simulations, in under a minute")
    parser.add_argument("--workers", type=int, default=2, help="number of processes; it changes no number")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--drives", type=int, help="drives of each kind whose intervals are computed")
    parser.add_argument("--tables", type=int, help="tables of each kind whose methods are ranked")
    given = parser.parse_args()
    start = time.perf_counter()
    count = given.drives or (40 if given.quick else 300)
    ranked = given.tables or (10 if given.quick else 150)
    lengths, sizes = ((16, 128, 1000), (16, 1000)) if given.quick else (PAIRS, RANKED)
    single = [(1, n, r, 0.0, count, given.seed) for n in lengths for r in CORRELATIONS]
    several = [(s, n, r, 0.0, count, given.seed) for s, n in SEVERAL if n in lengths for r in (0.0, 0.8, 0.95)]
    noisy = [(1, n, r, 0.5, count, given.seed) for n in lengths for r in (0.8, 0.95)]
    ranks = [(n, r, s, ranked, given.seed) for n in sizes for r in RANK_CORRELATIONS for s in (0.0, 0.7)]
    with ProcessPoolExecutor(given.workers) as pool:
        covered = [row for rows in pool.map(coverage, (single + several + noisy)[::-1]) for row in rows][::-1]
        ranking = [*pool.map(rank_errors, ranks[::-1])][::-1]
    summary = report(covered, ranking, round(LEAST_GIVEN * count))
    print(json.dumps({**summary, "seconds": round(time.perf_counter() - start, 1)}))
    if not summary["kept"]:
        raise SystemExit(1)


def report(covered: list[Coverage], ranking: list[RankErrors], least: int) -> dict[str, object]:
    """Print the tables; returns the worst cells."""
    promised = [c for c in covered if c.noise == 0]
    print("least coverage of the intervals given, and how many of the drives got one (-: too few to tell)\n")
    print(f"{'kind':22}{'sets':>5}{'pairs':>7}  " + "".join(f"{f'rho {r:g}':>15}" for r in CORRELATIONS))
    for noise in (0.0, 0.5):
        for kind in ("share", "area", "median", "difference"):
            for sets, pairs in dict.fromkeys((c.sets, c.pairs) for c in covered if c.noise == noise):
                cells = [_cell(covered, kind, sets, pairs, r, noise, least) for r in CORRELATIONS]
                if any(cell.strip() for cell in cells):
                    name = kind + (", half noise" if noise else "")
                    print(f"{name:22}{sets:>5}{pairs:>7}  " + "".join(f"{cell:>15}" for cell in cells))
    print(f"\n{METHODS} equal methods on {SETS} sets get different ranks; one better by 10 points is told apart\n")
    print(f"{'pairs':>6}{'rho':>6}{'shared':>8}{'different':>11}{'told apart':>12}{'on one set, of 9':>18}")
    for row in ranking:
        print(
            f"{row.pairs:>6}{row.correlation:>6g}{row.shared:>8g}{row.different / row.drives:>11.1%}"
            f"{row.told_apart / row.drives:>12.1%}{row.told_apart_on_one_set:>18.2f}"
        )
    often = [c for c in promised if c.given >= least]
    seldom = [c for c in promised if 0 < c.given < least]
    worst = min(often, key=lambda c: c.share)
    wrong = max(promised, key=lambda c: (c.given - c.covered) / c.drives)
    noisy = min((c for c in covered if c.noise and c.given >= least), key=lambda c: c.share)
    errors = max(ranking, key=lambda r: r.different / r.drives)
    power = min((r for r in ranking if (r.pairs, r.correlation) == (1000, 0.5)), key=lambda r: r.told_apart)
    seldom_share = sum(c.covered for c in seldom) / max(1, sum(c.given for c in seldom))
    return {
        "least_coverage": round(worst.share, 4),
        "least_coverage_of": asdict(worst),
        "coverage_where_seldom_given": round(seldom_share, 4),
        "most_wrong_of_all_drives": round((wrong.given - wrong.covered) / wrong.drives, 4),
        "least_coverage_half_noise": round(noisy.share, 4),
        "least_coverage_half_noise_of": asdict(noisy),
        "most_rank_errors": round(errors.different / errors.drives, 4),
        "most_rank_errors_of": asdict(errors),
        "least_told_apart_1000_pairs": round(power.told_apart / power.drives, 4),
        "kept": all(_at_least(LEAST_COVERAGE, c.covered, c.given) for c in often)
        and _at_least(LEAST_COVERAGE, sum(c.covered for c in seldom), sum(c.given for c in seldom))
        and all(_at_least(1 - MOST_RANK_ERRORS, r.drives - r.different, r.drives) for r in ranking)
        and _at_least(LEAST_TOLD_APART, power.told_apart, power.drives),
    }


def _at_least(share: float, count: int, of: int) -> bool:
    """Whether a true share at least that large can have given so few: within three standard errors."""
    return count >= share * of - 3 * math.sqrt(share * (1 - share) * of)


def _cell(
    covered: list[Coverage], kind: str, sets: int, pairs: int, correlation: float, noise: float, least: int
) -> str:
    """The least coverage over the kinds of one name, and the share of drives with an interval; empty where none is."""
    of = [
        c
        for c in covered
        if c.what.startswith(kind) and (c.sets, c.pairs, c.correlation, c.noise) == (sets, pairs, correlation, noise)
    ]
    if not of:
        return ""
    given = sum(c.given for c in of) / sum(c.drives for c in of)
    known = [c.share for c in of if c.given >= least]
    return f"{f'{min(known):.1%}' if known else '-'} ({given:.0%})"


if __name__ == "__main__":
    main()

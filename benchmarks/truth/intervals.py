"""Whether intervals cover and ranks hold their error rate, on simulated drives whose true values are known.

The error of a pair is ``exp(s x)``, where x is a first-order autoregression along the drive: N pairs, correlation rho
from one to the next. Simulated are

- the coverage of 95 % intervals of shares, of areas under the curves of light- and heavy-tailed errors, of
  medians and of paired differences, on one set and as means over four and ten roads with one set each;
- the same on roads with four or six sets that have a part of the variance of x in common, with one correlation for
  what is common and for what is each set's own, with different ones (``mixed``), and with a fifth of the pairs
  missing, so that sets are not aligned (``gaps``);
- how often ten equal methods get different ranks on such roads, whether they err on the same pairs or not, how often
  they would if the sets of a road were taken as independent, and how often a method that is better by 10 points is told
  apart from nine others;
- how many of the nine an oracle tells apart, which knows the variances and covariances of the methods' means, and how
  often the method is told apart from a single other one, with which it is compared alone;
- how often equal methods get different ranks where each road suits one method better than another by chance, and where
  every other method errs on longer stretches than the rest (``slow``);
- how many ranks of others move if a table gets five copies of its best, middle or worst method, each without one pair a
  set or with a little noise on its errors, five methods that fail everywhere, or five that are right on one pair a set.

Coverage counts the intervals that are given. Cells in which few are given are taken together. ``half noise`` is beyond
what the intervals promise: half of the variance of x is white, so that the correlation hides behind noise. So are
``mixed`` roads with short sets.

Of many cells, the worst is also the worst by chance. Those beyond their promise are drawn again, with another seed and
eight times as many simulations.

    python benchmarks/truth/intervals.py [--quick] [--drives N] [--tables N] [--workers N] [--seed N] [--only-ranks]

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
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtr, ndtri

from relocbench.arrays import Array
from relocbench.metrics.statistics.intervals import Interval, mean_interval, median_interval, paired_difference
from relocbench.metrics.statistics.ranks import DRAWS, different_methods, rank_with_ties

PAIRS = (16, 40, 64, 128, 360, 1000, 5000)
CORRELATIONS = (0.0, 0.5, 0.8, 0.9, 0.95)
KINDS = ("share", "area", "median", "difference")
SHARES = (0.5, 0.7, 0.9, 0.95, 0.99, 1.0)
"""the intervals of shares below a half are the mirror images of these"""
SPREADS = (0.5, 2.0)
"""s: a light and a heavy tail of errors"""
AREA_QUANTILES = (0.5, 0.95, 0.999)
"""shares of errors below the threshold of an area"""
DIFFERENCES = ((0.7, 0.7), (0.99, 1.0), (0.97, 1.0), (0.99, 0.99), (0.95, 0.95), (0.5, 0.6))
"""true shares of two methods"""
SEVERAL = ((4, 16), (4, 64), (4, 360), (10, 16), (10, 64))
"""number of sets, and of pairs of each"""
RANKED = (16, 64, 250, 1000)
"""pairs of each of four roads with one set"""
RANK_CORRELATIONS = (0.0, 0.5, 0.9)
METHODS = 10
ROADS = ((1, 4, 64), (1, 4, 360), (4, 6, 64), (4, 4, 360), (12, 6, 64))
"""number of roads, of sets of each, and of pairs of each set"""
COMMON = (0.0, 0.25, 0.5, 0.9)
"""shares of the variance that the sets of a road have in common"""
MIXED = ((0.9, 0.0), (0.0, 0.9), (0.95, 0.5))
"""correlations of what is common and of what is each set's own"""
GAPS = 0.2
"""share of the pairs of each set that are missing"""
RANKED_ROADS = ((1, 4, 250), (4, 6, 64), (12, 6, 64))
STREETS = ((1, 4, 250), (4, 4, 250), (12, 4, 250))
STREET = 0.1
"""share of the variance that is constant on a road and different from method to method"""
SLOW = ((1, 1, 360, 0.95), (1, 1, 1000, 0.95), (4, 1, 250, 0.9), (12, 6, 64, 0.9))
"""roads, sets, pairs, and the correlation of every other method's errors; those of the rest are independent"""
DISTRICTS = ((1, 6, 52), (12, 6, 52))
"""roads of the tables to which copies and failing methods are added"""
GRADES = (0.98, 0.97, 0.95, 0.9, 0.8, 0.6)
"""true shares of the methods of these tables"""
ADDED = 5
"""copies of one method, or failing ones"""
NOISE = 0.05
"""standard deviation of the logarithm of a copy's errors, from those of the original"""
ORACLE_TABLES = 2000
"""tables from which the oracle knows variances and covariances"""
LEAST_COVERAGE, MOST_RANK_ERRORS, LEAST_TOLD_APART = 0.94, 0.07, 0.80
LONG = 360
"""pairs of a set from which on drives are promised whose sets have other correlations in common than of their own"""
AGAIN = 8
"""times as many simulations of a cell that is drawn again"""
LEAST_GIVEN = 0.4
"""share of the drives of a cell that need an interval for a coverage of its own"""


@dataclass(frozen=True)
class Streets:
    """The drives of one cell: roads, the sets of each, and what they have in common."""

    roads: int
    sets: int
    pairs: int
    correlation: float
    """of what the sets of a road have in common, from one pair to the next"""
    own: float
    """the same of what is a set's own"""
    common: float = 0.0
    """share of the variance that the sets of a road have in common"""
    noise: float = 0.0
    """share of the variance that is white"""
    gaps: float = 0.0
    """share of the pairs that are missing"""
    street: float = 0.0
    """share of the variance that is constant on a road"""
    slow: float = 0.0
    """correlation of every other method, if it is another one"""

    @property
    def of_sets(self) -> list[int]:
        """The road of each set."""
        return [road for road in range(self.roads) for _ in range(self.sets)]

    @property
    def mixed(self) -> bool:
        return self.common > 0 and self.correlation != self.own

    @property
    def seed(self) -> list[int]:
        shares = (self.correlation, self.own, self.common, self.noise, self.gaps, self.street, self.slow)
        return [self.roads, self.sets, self.pairs, *(round(1000 * share) for share in shares)]

    def draw(self, rng: np.random.Generator, methods: int = 1, shared: float = 0.0) -> list[Array]:
        """(methods, N_s) of each set, of variance 1, of which ``shared`` is the same for all methods."""
        if self.slow:
            every = [replace(self, correlation=r, own=r, slow=0.0) for r in (self.own, self.slow)]
            both_kinds = zip(*(of.draw(rng, methods, shared) for of in every), strict=True)
            other = np.arange(methods)[:, None] % 2 == 1
            return [np.where(other, slow, quick) for quick, slow in both_kinds]
        noise, out = self.noise, []

        def both(pairs: int, correlation: float) -> Array:
            alone = drives(rng, methods, pairs, correlation, noise)
            together = drives(rng, 1, pairs, correlation, noise) if shared else 0.0
            mixed: Array = math.sqrt(shared) * together + math.sqrt(1 - shared) * alone
            return mixed

        for _ in range(self.roads):
            of_road = math.sqrt(self.common) * both(self.pairs, self.correlation) if self.common else 0.0
            of_street = math.sqrt(self.street) * rng.normal(size=(methods, 1)) if self.street else 0.0
            for _ in range(self.sets):
                x = of_road + of_street + math.sqrt(1 - self.common - self.street) * both(self.pairs, self.own)
                out.append(x[:, rng.random(self.pairs) >= self.gaps] if self.gaps else x)
        return out


def one_set(roads: int, pairs: int, correlation: float, noise: float = 0.0) -> Streets:
    """Roads with one set each."""
    return Streets(roads, 1, pairs, correlation, correlation, noise=noise)


@dataclass(frozen=True)
class Coverage:
    """How often one kind of interval covered in one kind of drive."""

    what: str
    streets: Streets
    drives: int
    given: int
    covered: int

    @property
    def share(self) -> float:
        return self.covered / self.given if self.given else math.nan

    @property
    def promised(self) -> bool:
        return not self.streets.noise and (not self.streets.mixed or self.streets.pairs >= LONG)


@dataclass(frozen=True)
class Moves:
    """How many ranks of other methods moved when methods were added to tables."""

    streets: Streets
    added: str
    ranks: int
    moved: int


@dataclass(frozen=True)
class RankErrors:
    """How often methods got different ranks."""

    streets: Streets
    shared: float
    """share of the variance of errors that methods have in common"""
    drives: int
    different: int
    """simulations in which equal methods got different ranks"""
    told_apart: int
    """simulations in which a method better by 10 points was told apart from all others"""
    others: float
    """mean number of others that it was told apart from"""
    others_on_one_set: float
    """the same on the first set alone"""
    by_oracle: float = math.nan
    """the same by a test that knows the variances"""
    of_two: float = math.nan
    """how often it is told apart from one other on the first set, where these two alone are compared"""
    of_two_by_oracle: float = math.nan
    as_independent: int = 0
    """simulations in which equal methods would get different ranks if the sets of a road were independent"""


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


def intervals(rng: np.random.Generator, streets: Streets) -> Iterator[tuple[str, float, Interval | None]]:
    """Simulate the drives of one cell; yields what was estimated, its true value and its interval."""
    several = streets.sets > 1
    roads = streets.of_sets
    x = streets.draw(rng, 2)
    own = [of[0] for of in x]
    errors = [np.exp(of)[None] for of in own]
    for share in SHARES[::2] if several else SHARES:
        yield f"share {share:g}", share, mean_interval([right(of, share) for of in own], errors, roads=roads)
    for spread in SPREADS[1:] if several else SPREADS:
        for quantile in AREA_QUANTILES[1:2] if several else AREA_QUANTILES:
            true, values = area(spread, quantile)
            yield f"area {spread:g} {quantile:g}", true, mean_interval([values(of) for of in own], errors, roads=roads)
    if len(own) == 1:
        yield "median", 1.0, median_interval(np.exp(own[0]))
    for a, b in DIFFERENCES[:3] if several else DIFFERENCES:
        found = paired_difference([right(of[0], a) for of in x], [right(of[1], b) for of in x], roads=roads)
        yield f"difference {a:g} {b:g}", a - b, found.interval


def coverage(cell: tuple[Streets, int, int]) -> list[Coverage]:
    """The coverage of every kind of interval in one cell."""
    streets, count, seed = cell
    rng = np.random.default_rng([seed, *streets.seed])
    given: Counter[str] = Counter()
    covered: Counter[str] = Counter()
    for _ in range(count):
        for what, true, interval in intervals(rng, streets):
            given[what] += interval is not None
            covered[what] += interval is not None and interval.low - 1e-12 <= true <= interval.high + 1e-12
    return [Coverage(what, streets, count, given[what], covered[what]) for what in given]


def rank_errors(cell: tuple[Streets, float, int, int]) -> RankErrors:
    """The errors of ranks in one cell."""
    streets, shared, count, seed = cell
    rng = np.random.default_rng([seed, *streets.seed, round(1000 * shared)])
    roads = streets.of_sets
    better = np.array([0.6] + [0.5] * (METHODS - 1))[:, None]
    oracle = Oracle(one_set(1, streets.pairs, streets.own), shared, better, rng) if streets.sets == 1 else None
    rng_independent = np.random.default_rng([seed, *streets.seed, round(1000 * shared), 1])
    different = apart = as_independent = 0
    others = alone = by_oracle = of_two = of_two_by_oracle = 0.0
    for _ in range(count):
        x = streets.draw(rng, METHODS, shared)
        equal: dict[str, list[Array | None]] = {str(m): [right(of[m], 0.5) for of in x] for m in range(METHODS)}
        errors = {str(m): [np.exp(of[m])[None] for of in x] for m in range(METHODS)}
        different += len(set(rank_with_ties(equal, rng, errors, roads=roads).values())) > 1
        if streets.sets > 1:
            of_sets = rank_with_ties(equal, rng_independent, errors, roads=range(len(x)))
            as_independent += len(set(of_sets.values())) > 1
        values = [(ndtr(of) < better).astype(np.float64) for of in x]
        found = different_methods(values, rng, roads=roads)[0, 1:]
        apart += bool(found.all())
        others += float(found.sum())
        if oracle is not None:
            alone += float(different_methods(values[:1], rng)[0, 1:].sum())
            by_oracle += oracle.told_apart(values[0])
            of_two += paired_difference([values[0][0]], [values[0][1]]).significant
            of_two_by_oracle += oracle.tells_two_apart(values[0])
    means = [others / count, alone / count]
    if oracle is not None:
        means += [by_oracle / count, of_two / count, of_two_by_oracle / count]
    return RankErrors(streets, shared, count, different, apart, *means, as_independent=as_independent)


def moves(cell: tuple[Streets, int, int]) -> list[Moves]:
    """How many ranks move in one cell, by what is added."""
    streets, count, seed = cell
    rng = np.random.default_rng([seed, *streets.seed])
    grades = ndtri(np.array(GRADES))[:, None]
    ranks: Counter[str] = Counter()
    moved: Counter[str] = Counter()
    for table in range(count):
        first = [x - grades for x in streets.draw(rng, len(GRADES), 0.5)]
        second = [0.8 * x + 0.6 * rng.normal(size=x.shape) for x in first]
        errors = {
            str(m): [np.exp(np.stack([a[m], b[m]])) for a, b in zip(first, second, strict=True)]
            for m in range(len(GRADES))
        }
        before = graded(errors, table, streets)
        for added, others in additions(errors, rng):
            after = graded({**others, **errors} if "fail" in added else {**errors, **others}, table, streets)
            ranks[added] += len(before)
            moved[added] += sum(after[name] != rank for name, rank in before.items())
    return [Moves(streets, added, ranks[added], moved[added]) for added in ranks]


def additions(errors: dict[str, list[Array]], rng: np.random.Generator) -> Iterator[tuple[str, dict[str, list[Array]]]]:
    """What is added to a table: its name, and the errors of the methods."""
    for place, original in (("best", 0), ("middle", len(GRADES) // 2), ("worst", len(GRADES) - 1)):
        own = errors[str(original)]
        for change, of in (("without one pair a set", without_one), ("with noise", with_noise)):
            yield f"copies of the {place}, {change}", {f"a{c}": [of(e, rng) for e in own] for c in range(ADDED)}
    failing = [np.full_like(e, np.inf) for e in errors["0"]]
    yield "failing everywhere", {f"a{c}": failing for c in range(ADDED)}
    yield "failing but on one pair a set", {f"a{c}": [with_one(e, rng) for e in failing] for c in range(ADDED)}


def without_one(errors: Array, rng: np.random.Generator) -> Array:
    out = errors.copy()
    out[:, rng.integers(errors.shape[1])] = np.inf
    return out


def with_one(errors: Array, rng: np.random.Generator) -> Array:
    out = errors.copy()
    out[:, rng.integers(errors.shape[1])] = 0.1
    return out


def with_noise(errors: Array, rng: np.random.Generator) -> Array:
    out: Array = errors * np.exp(NOISE * rng.normal(size=errors.shape))
    return out


def graded(errors: dict[str, list[Array]], table: int, streets: Streets) -> dict[str, int | None]:
    """The ranks by the share of errors below 1."""
    values = {name: [(e[0] < 1).astype(np.float64) for e in of] for name, of in errors.items()}
    return rank_with_ties(values, np.random.default_rng(table), errors, roads=streets.of_sets)


class Oracle:
    """The max-T test, stepped down, of one who knows the covariance of the methods' means: no test can be expected to
    tell apart more at this error rate."""

    def __init__(self, streets: Streets, shared: float, better: Array, rng: np.random.Generator) -> None:
        # The better method and two equal ones say it all.
        of_three = [(ndtr(streets.draw(rng, 3, shared)[0]) < better[:3]).mean(axis=1) for _ in range(ORACLE_TABLES)]
        known = np.cov(np.array(of_three).T)
        between = (known[0, 1] + known[0, 2]) / 2
        covariance = np.full((METHODS, METHODS), known[1, 2])
        np.fill_diagonal(covariance, (known[1, 1] + known[2, 2]) / 2)
        covariance[0, 1:] = covariance[1:, 0] = between
        covariance[0, 0] = known[0, 0]
        own = np.diag(covariance)
        self._first, self._second = np.triu_indices(METHODS, 1)
        self._scale = np.sqrt(own[:, None] + own[None, :] - 2 * covariance)[self._first, self._second]
        values, vectors = np.linalg.eigh(covariance)
        drawn = rng.standard_normal((DRAWS, METHODS)) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        self._drawn = self._statistics(drawn)

    def told_apart(self, values: Array) -> int:
        """How many of the others the first of (METHODS, N) values is told apart from."""
        statistics = self._statistics(values.mean(axis=1)[None])[0]
        open_ = np.ones(len(statistics), dtype=bool)
        while open_.any():
            now = open_ & (statistics > np.quantile(self._drawn[:, open_].max(axis=1), 0.95))
            if not now.any():
                break
            open_ &= ~now
        return int(np.sum(~open_[self._first == 0]))

    def tells_two_apart(self, values: Array) -> bool:
        """Whether the first two of (M, N) values differ, if no other methods are compared."""
        return bool(self._statistics(values.mean(axis=1)[None])[0, 0] > ndtri(0.975))

    def _statistics(self, means: Array) -> Array:
        out: Array = np.abs(means[:, self._first] - means[:, self._second]) / self._scale
        return out


def main() -> None:
    """Simulate, print tables and the worst cells; exits with 1 where a promise is broken."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer simulations, in under a minute")
    parser.add_argument("--workers", type=int, default=2, help="number of processes; it changes no number")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--drives", type=int, help="drives of each kind whose intervals are computed")
    parser.add_argument("--tables", type=int, help="tables of each kind whose methods are ranked")
    parser.add_argument("--only-ranks", action="store_true", help="simulate no intervals")
    given = parser.parse_args()
    start = time.perf_counter()
    count = given.drives or (40 if given.quick else 300)
    ranked = given.tables or (10 if given.quick else 150)
    covered, ranking, moving = simulate(
        0 if given.only_ranks else count, ranked, given.quick, given.seed, given.workers
    )
    summary = report(covered, ranking, moving, round(LEAST_GIVEN * count))
    summary["drawn_again"] = draw_again(covered, ranking, round(LEAST_GIVEN * count), given.seed + 1, given.workers)
    print(json.dumps({**summary, "seconds": round(time.perf_counter() - start, 1)}))
    if not summary["kept"]:
        raise SystemExit(1)


def simulate(
    count: int, ranked: int, quick: bool, seed: int, workers: int
) -> tuple[list[Coverage], list[RankErrors], list[Moves]]:
    """Simulate all cells; the number of processes changes no number."""
    lengths, sizes = ((16, 128, 1000), (16, 1000)) if quick else (PAIRS, RANKED)
    drives_of = [one_set(1, n, r) for n in lengths for r in CORRELATIONS]
    drives_of += [one_set(s, n, r) for s, n in SEVERAL if n in lengths for r in (0.0, 0.8, 0.95)]
    drives_of += [one_set(1, n, r, 0.5) for n in lengths for r in (0.8, 0.95)]
    roads, ranked_roads = (ROADS[:2], RANKED_ROADS[:1]) if quick else (ROADS, RANKED_ROADS)
    for place in roads:
        drives_of += [Streets(*place, r, r, c) for c in COMMON for r in (0.0, 0.8, 0.95)]
        drives_of += [Streets(*place, r, own, c) for c in COMMON[1:] for r, own in MIXED]
        drives_of += [Streets(*place, 0.8, 0.8, 0.5, gaps=GAPS)]
    tables = [(one_set(4, n, r), shared) for n in sizes for r in RANK_CORRELATIONS for shared in (0.0, 0.7)]
    tables += [(Streets(*p, r, r, c), 0.7) for p in ranked_roads for c in COMMON for r in RANK_CORRELATIONS[1:]]
    tables += [(Streets(*p, r, own, 0.5), 0.7) for p in ranked_roads for r, own in MIXED[:2]]
    tables += [(Streets(*p, 0.5, 0.5, 0.25, street=STREET), 0.0) for p in STREETS]
    tables += [
        (Streets(roads, sets, n, 0.0, 0.0, slow=slow), 0.0) for roads, sets, n, slow in SLOW[: 1 if quick else 4]
    ]
    districts = [Streets(*place, 0.5, 0.5, 0.25) for place in DISTRICTS]
    with ProcessPoolExecutor(workers) as pool:
        cells = [(streets, count, seed) for streets in drives_of] if count else []
        covered = [row for rows in pool.map(coverage, cells[::-1]) for row in rows][::-1]
        ranking = [*pool.map(rank_errors, [(*table, ranked, seed) for table in tables][::-1])][::-1]
        moving = [row for rows in pool.map(moves, [(of, ranked, seed) for of in districts]) for row in rows]
    return covered, ranking, moving


def draw_again(
    covered: list[Coverage], ranking: list[RankErrors], least: int, seed: int, workers: int
) -> list[dict[str, object]]:
    """Draw the cells beyond their promise again, and print both results of each."""
    low = [c for c in covered if c.promised and c.given >= least and c.share < LEAST_COVERAGE]
    wrong = [r for r in ranking if not r.streets.street and r.different > MOST_RANK_ERRORS * r.drives]
    cells = list(dict.fromkeys((c.streets, AGAIN * c.drives, seed) for c in low))
    tables = [(r.streets, r.shared, AGAIN * r.drives, seed) for r in wrong]
    with ProcessPoolExecutor(workers) as pool:
        found = {(c.what, c.streets): c for rows in pool.map(coverage, cells) for c in rows}
        ranked = [*pool.map(rank_errors, tables)]
    told: list[dict[str, object]] = [
        {"what": c.what, "first": c.share, "again": found[c.what, c.streets].share, **asdict(c.streets)} for c in low
    ]
    told += [
        {"what": "ranks", "first": a.different / a.drives, "again": b.different / b.drives, **asdict(a.streets)}
        for a, b in zip(wrong, ranked, strict=True)
    ]
    print(f"\n{len(told)} cells beyond their promise, drawn again with {AGAIN} times as many simulations\n")
    for one in told:
        where = ", ".join(f"{name} {one[name]:g}" for name in ("roads", "sets", "pairs", "correlation", "common"))
        print(f"{one['what']}, {where}: {one['first']:.1%}, again {one['again']:.1%}")
    return told


def report(covered: list[Coverage], ranking: list[RankErrors], moving: list[Moves], least: int) -> dict[str, object]:
    """Print the tables; returns the worst cells."""
    if covered:
        report_coverage(covered, least)
    report_ranks(ranking)
    print(f"\n{ADDED} methods are added to a table of {len(GRADES)}: ranks of the others that move\n")
    for row in moving:
        one = row.streets
        print(
            f"{one.roads:>3} roads, {one.sets} sets of {one.pairs} pairs, {row.added:46}{row.moved:>6} of {row.ranks}"
        )
    return _worst(covered, ranking, moving, least)


def report_coverage(covered: list[Coverage], least: int) -> None:
    """Print how well intervals cover."""
    alone = [c for c in covered if c.streets.sets == 1]
    together = [c for c in covered if c.streets.sets > 1]
    print("least coverage of the intervals given, and how many of the drives got one (-: too few to tell)\n")
    print("roads with one set\n")
    print(f"{'kind':22}{'roads':>5}{'pairs':>7}  " + "".join(f"{f'rho {r:g}':>15}" for r in CORRELATIONS))
    for noise in (0.0, 0.5):
        for kind in KINDS:
            for roads, pairs in dict.fromkeys((c.streets.roads, c.streets.pairs) for c in alone):
                cells = [_cell(alone, kind, one_set(roads, pairs, r, noise), least) for r in CORRELATIONS]
                if any(cell.strip() for cell in cells):
                    name = kind + (", half noise" if noise else "")
                    print(f"{name:22}{roads:>5}{pairs:>7}  " + "".join(f"{cell:>15}" for cell in cells))
    print("\nroads with several sets, by the share of the variance that they have in common\n")
    print(f"{'roads':>6}{'sets':>5}{'pairs':>6}{'rho':>6}{'own':>6}  " + "".join(f"{f'{c:g}':>15}" for c in COMMON))
    for one in dict.fromkeys(replace(c.streets, common=0.0) for c in together):
        cells = [_cell(together, "", replace(one, common=c), least) for c in COMMON]
        print(
            f"{one.roads:>6}{one.sets:>5}{one.pairs:>6}{one.correlation:>6g}{one.own:>6g}  "
            + "".join(f"{cell:>15}" for cell in cells)
            + ("  gaps" if one.gaps else "")
        )


def report_ranks(ranking: list[RankErrors]) -> None:
    """Print how often ranks are wrong, and how often right."""
    print(f"\n{METHODS} equal methods get different ranks; one better by 10 points is told apart\n")
    words = (("roads", 6), ("sets", 5), ("pairs", 6), ("rho", 6), ("own", 6), ("common", 8), ("shared", 8))
    numbers = (
        ("different", 11),
        ("independent", 13),
        ("apart", 8),
        ("of 9", 7),
        ("on one set", 12),
        ("oracle", 8),
        ("two alone", 11),
        ("oracle", 8),
    )
    print("".join(f"{word:>{width}}" for word, width in (*words, *numbers)))
    for row in ranking:
        one = row.streets
        seen = (one.roads, one.sets, one.pairs, one.correlation, one.own, one.common, row.shared)
        print(
            "".join(f"{value:>{width}g}" for value, (_, width) in zip(seen, words, strict=True))
            + f"{row.different / row.drives:>11.1%}"
            + (f"{row.as_independent / row.drives:>13.1%}" if one.sets > 1 else f"{'':13}")
            + f"{row.told_apart / row.drives:>8.1%}{row.others:>7.2f}"
            + (f"{row.others_on_one_set:>12.2f}{row.by_oracle:>8.2f}" if one.sets == 1 else "")
            + (f"{row.of_two:>11.1%}{row.of_two_by_oracle:>8.1%}" if one.sets == 1 else "")
            + (f"  {one.street:g} of the variance is a constant of method and road" if one.street else "")
            + (f"  every other method has a correlation of {one.slow:g}" if one.slow else "")
        )


def _worst(covered: list[Coverage], ranking: list[RankErrors], moving: list[Moves], least: int) -> dict[str, object]:
    of_ranks = _worst_of_ranks(ranking)
    moved = {"ranks_moved": sum(row.moved for row in moving), "of_ranks": sum(row.ranks for row in moving)}
    of_intervals = _worst_of_intervals(covered, least) if covered else {"kept": True}
    kept = all((of_ranks["kept"], of_intervals["kept"], moved["ranks_moved"] == 0))
    return {**of_intervals, **of_ranks, **moved, "kept": kept}


def _worst_of_intervals(covered: list[Coverage], least: int) -> dict[str, object]:
    promised = [c for c in covered if c.promised]
    often = [c for c in promised if c.given >= least]
    seldom = [c for c in promised if 0 < c.given < least]
    worst = min(often, key=lambda c: c.share)
    of_roads = min((c for c in often if c.streets.sets > 1), key=lambda c: c.share)
    wrong = max(promised, key=lambda c: (c.given - c.covered) / c.drives)
    noisy = min((c for c in covered if not c.promised and c.given >= least), key=lambda c: c.share)
    seldom_share = sum(c.covered for c in seldom) / max(1, sum(c.given for c in seldom))
    return {
        "least_coverage": round(worst.share, 4),
        "least_coverage_of": asdict(worst),
        "least_coverage_on_roads_of_several_sets": round(of_roads.share, 4),
        "least_coverage_on_roads_of_several_sets_of": asdict(of_roads),
        "coverage_where_seldom_given": round(seldom_share, 4),
        "most_wrong_of_all_drives": round((wrong.given - wrong.covered) / wrong.drives, 4),
        "least_coverage_not_promised": round(noisy.share, 4),
        "least_coverage_not_promised_of": asdict(noisy),
        "kept": all(at_least(LEAST_COVERAGE, c.covered, c.given) for c in often)
        and at_least(LEAST_COVERAGE, sum(c.covered for c in seldom), sum(c.given for c in seldom)),
    }


def _worst_of_ranks(ranking: list[RankErrors]) -> dict[str, object]:
    ranked = [r for r in ranking if not r.streets.street]
    errors = max(ranked, key=lambda r: r.different / r.drives)
    of_streets = {str(r.streets.roads): r.different / r.drives for r in ranking if r.streets.street}
    four = [r for r in ranking if (r.streets.sets, r.streets.pairs, r.streets.own) == (1, 1000, 0.5)]
    power = min(four, key=lambda r: r.told_apart)
    return {
        "most_rank_errors": round(errors.different / errors.drives, 4),
        "most_rank_errors_of": asdict(errors),
        "rank_errors_where_roads_suit_methods": of_streets,
        "least_told_apart_1000_pairs": round(power.told_apart / power.drives, 4),
        "told_apart_on_one_set_and_by_oracle_of_nine_and_alone": {
            f"shared {r.shared:g}": (r.others_on_one_set, r.by_oracle, r.of_two, r.of_two_by_oracle) for r in four
        },
        "kept": all(at_least(1 - MOST_RANK_ERRORS, r.drives - r.different, r.drives) for r in ranked)
        and at_least(LEAST_TOLD_APART, power.told_apart, power.drives),
    }


def at_least(share: float, count: int, of: int) -> bool:
    """Whether a true share at least that large can have given so few: within three standard errors."""
    return count >= share * of - 3 * math.sqrt(share * (1 - share) * of)


def _cell(covered: list[Coverage], kind: str, streets: Streets, least: int) -> str:
    """The least coverage over the kinds of one name, and the share of drives with an interval; empty where none is."""
    of = [c for c in covered if c.what.startswith(kind) and c.streets == streets]
    if not of:
        return ""
    given = sum(c.given for c in of) / sum(c.drives for c in of)
    known = [c.share for c in of if c.given >= least]
    return f"{f'{min(known):.1%}' if known else '-'} ({given:.0%})"


if __name__ == "__main__":
    main()

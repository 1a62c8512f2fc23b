"""Whether differences near the ceiling are covered, and how often equal methods have a star, on simulated drives.

The regime is one in which nearly every pair is found: twelve districts, six pair sets of 52 pairs in each, which become
one series of a district by the step of the drive, and methods that are right on 90 to 100 % of the pairs. Errors are
those of ``intervals.py``: autoregressions along the drive, of which the sets of a district have a part in common, both
methods another (``shared``), and each method in each district a constant (``district``).

Printed are

- the coverage and the mean width of the 95 % interval of a paired difference, beside that of Student's t alone, which
  has the same end near zero;
- in how many pages that list differences of equal methods any has a star, if each is tested for itself and with one
  error rate for the page; and how often a method that is worse by 2 points has its star.

Cells below 94 % are drawn again with another seed and eight times as many simulations.

    python benchmarks/truth/differences.py [--drives N] [--pages N] [--workers N] [--seed N]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass

import numpy as np
from intervals import AGAIN, Streets, at_least, right

from relocbench.arrays import Array
from relocbench.metrics import Difference, controlled, paired_difference
from relocbench.metrics.statistics import intervals

DISTRICTS, SETS, PAIRS = 12, 6, 52
KINDS = ((0.0, 0.0), (0.5, 0.25), (0.8, 0.5), (0.9, 0.5))
"""correlation of neighbours, and the share of the variance that the sets of a district have in common"""
DISTRICT = (0.0, 0.1)
"""shares of the variance that are a constant of each method in each district"""
SHARED = (0.0, 0.7)
"""shares of the variance that both methods have in common"""
SHARES = ((0.9, 0.9), (0.97, 0.97), (0.97, 1.0), (0.99, 0.99), (0.99, 1.0), (0.999, 0.999))
"""true shares of two methods"""
METHODS = 12
"""equal methods of a page, of which the first is compared with each other one"""
WORSE = 0.02
LEAST = 0.94


@dataclass(frozen=True)
class Cell:
    """One kind of drives and methods."""

    correlation: float
    common: float
    district: float
    shared: float
    shares: tuple[float, float]

    def drawn(self, rng: np.random.Generator, shares: Sequence[float]) -> list[list[Array]]:
        """For each method, one series for each district: the share of right answers at each step."""
        drives = Streets(
            DISTRICTS, SETS, PAIRS, self.correlation, self.correlation, self.common, street=self.district
        ).draw(rng, len(shares), self.shared)
        return [
            [np.mean([right(x[m], share) for x in drives[d : d + SETS]], axis=0) for d in range(0, len(drives), SETS)]
            for m, share in enumerate(shares)
        ]


@dataclass
class Count:
    """What was seen of a cell."""

    drives: int = 0
    given: int = 0
    covered: int = 0
    by_t: int = 0
    width: float = 0.0
    width_by_t: float = 0.0

    def add(self, true: float, found: Difference, by_t: Difference) -> None:
        self.drives += 1
        if found.interval is None or by_t.interval is None:
            return
        self.given += 1
        self.covered += found.interval.low - 1e-12 <= true <= found.interval.high + 1e-12
        self.by_t += by_t.interval.low - 1e-12 <= true <= by_t.interval.high + 1e-12
        self.width += found.interval.high - found.interval.low
        self.width_by_t += by_t.interval.high - by_t.interval.low


def coverage(task: tuple[Cell, int, int]) -> Count:
    """The coverage of a difference in one cell."""
    cell, drives, seed = task
    rng = np.random.default_rng([seed, *_seed(cell)])
    count = Count()
    for _ in range(drives):
        a, b = cell.drawn(rng, cell.shares)
        found = paired_difference(a, b, roads=range(DISTRICTS))
        count.add(cell.shares[0] - cell.shares[1], found, _by_t_alone(found, a, b))
    return count


def _by_t_alone(found: Difference, a: Sequence[Array], b: Sequence[Array]) -> Difference:
    """The same difference with the interval that does not ask how many pairs differ."""
    if found.interval is None:
        return found
    difference = [x - y for x, y in zip(a, b, strict=True)]
    both = [np.stack(of) for of in zip(a, b, strict=True)]
    size = intervals._effective_size(difference, both, range(DISTRICTS), False, intervals.LEVEL)
    assert size is not None
    low, high, _ = intervals._by_students_t(difference, size)
    return Difference(found.mean, intervals.Interval(max(low, -1.0), min(high, 1.0), intervals.LEVEL))


def stars(task: tuple[Cell, int, int]) -> tuple[int, int, int]:
    """In how many pages equal methods have a star, alone and with one error rate; how often a worse one has its own."""
    cell, pages, seed = task
    rng = np.random.default_rng([seed, 1, *_seed(cell)])
    alone = together = worse = 0
    share = cell.shares[0]
    for _ in range(pages):
        methods = cell.drawn(rng, [share] * METHODS + [share - WORSE])
        listed = [paired_difference(methods[0], other, roads=range(DISTRICTS)) for other in methods[1:]]
        alone += any(each.significant for each in listed[:-1])
        together += any(each.significant for each in controlled(listed[:-1]))
        worse += controlled(listed)[-1].significant
    return alone, together, worse


def _seed(cell: Cell) -> list[int]:
    return [round(1000 * n) for n in (cell.correlation, cell.common, cell.district, cell.shared, *cell.shares)]


def main() -> None:
    """Simulate and print; exits with 1 where a cell stays below its promise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=300, help="drives of each kind whose intervals are computed")
    parser.add_argument("--pages", type=int, default=60, help="pages of each kind")
    parser.add_argument("--workers", type=int, default=2, help="number of processes; it changes no number")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    start = time.perf_counter()
    kinds = [(*kind, district, shared) for district in DISTRICT for kind in KINDS for shared in SHARED]
    cells = [Cell(*kind, shares) for kind in kinds for shares in SHARES]
    with ProcessPoolExecutor(given.workers) as pool:
        counts = list(pool.map(coverage, [(cell, given.drives, given.seed) for cell in cells]))
        low = [c for c, count in zip(cells, counts, strict=True) if count.covered < LEAST * count.given]
        again = list(pool.map(coverage, [(cell, AGAIN * given.drives, given.seed + 1) for cell in low]))
        of_pages = [Cell(*kind, (share, share)) for kind in kinds for share in (0.97, 0.99)]
        found = list(pool.map(stars, [(cell, given.pages, given.seed) for cell in of_pages]))
    print("coverage and mean width in points of a difference, by t alone and with the shares that are won and lost\n")
    print(f"{'rho':>5}{'common':>8}{'district':>9}{'shared':>8}{'shares':>14}{'given':>7}", end="")
    print(f"{'by t':>8}{'width':>7}{'now':>8}{'width':>7}")
    for cell, count in zip(cells, counts, strict=True):
        _print_cell(cell, count)
    print(f"\n{len(low)} cells below {LEAST:.0%}, drawn again with {AGAIN} times as many drives\n")
    for cell, count in zip(low, again, strict=True):
        _print_cell(cell, count)
    print(f"\npages of {METHODS - 1} equal methods: those with any star; how often one worse by {WORSE:g} is found\n")
    print(
        f"{'rho':>5}{'common':>8}{'district':>9}{'shared':>8}{'share':>7}{'each alone':>12}{'one rate':>10}{'found':>8}"
    )
    for cell, seen in zip(of_pages, found, strict=True):
        shares = [of / given.pages for of in seen]
        print(
            f"{cell.correlation:>5g}{cell.common:>8g}{cell.district:>9g}{cell.shared:>8g}{cell.shares[0]:>7g}"
            f"{shares[0]:>12.1%}{shares[1]:>10.1%}{shares[2]:>8.1%}"
        )
    print(
        json.dumps({**_summary(cells, counts, low, again, found, given.pages), "seconds": time.perf_counter() - start})
    )
    if not all(at_least(LEAST, count.covered, count.given) for count in again):
        raise SystemExit(1)


def _print_cell(cell: Cell, count: Count) -> None:
    n = max(1, count.given)
    before, now = (100 * width / n for width in (count.width_by_t, count.width))
    print(
        f"{cell.correlation:>5g}{cell.common:>8g}{cell.district:>9g}{cell.shared:>8g}"
        f"{f'{cell.shares[0]:g}, {cell.shares[1]:g}':>14}{count.given / count.drives:>7.0%}"
        f"{count.by_t / n:>8.1%}{before:>7.2f}{count.covered / n:>8.1%}{now:>7.2f}"
    )


def _summary(
    cells: list[Cell],
    counts: list[Count],
    low: list[Cell],
    again: list[Count],
    found: list[tuple[int, int, int]],
    pages: int,
) -> dict[str, object]:
    redrawn = dict(zip(low, again, strict=True))
    final = [(redrawn.get(cell, count), cell) for cell, count in zip(cells, counts, strict=True)]
    worst, of = min(final, key=lambda each: each[0].covered / max(1, each[0].given))
    before = min(counts, key=lambda count: count.by_t / max(1, count.given))
    wider = [count.width / count.width_by_t for count in counts if count.by_t >= LEAST * count.given]
    return {
        "benchmark": "differences",
        "least_coverage": round(worst.covered / worst.given, 4),
        "least_coverage_of": asdict(of),
        "least_coverage_by_t": round(before.by_t / before.given, 4),
        "cells": len(cells),
        "cells_below": sum(count.covered < LEAST * count.given for count, _ in final),
        "cells_below_by_t": sum(count.by_t < LEAST * count.given for count in counts),
        "median_widening_where_t_covers": round(float(np.median(wider)) - 1, 4),
        "pages_with_a_star_alone": round(sum(seen[0] for seen in found) / (pages * len(found)), 4),
        "pages_with_a_star": round(sum(seen[1] for seen in found) / (pages * len(found)), 4),
        "most_pages_with_a_star": round(max(seen[1] for seen in found) / pages, 4),
    }


if __name__ == "__main__":
    main()

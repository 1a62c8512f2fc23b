"""What published pages compare methods on: groups of pairs, their shares, and the differences that answer a question.

Districts count alike, and so do the pair sets of a district, which are one series by the place along the drive
(``docs/statistics.md``).
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from relocbench.arrays import Array
from relocbench.metrics import (
    LEVEL,
    Difference,
    Interval,
    by_place,
    controlled,
    in_points,
    mean_interval,
    paired_difference,
)

METRICS = ("recall@(0.25m,2deg)", "t_auc@0.5m", "r_auc@0.5deg")
FLOORS = ("identity", "clock")
QUESTIONS = {
    ("gn-net", "aliked-pnp"): "align learned features, or match others",
    ("gn-net-from-prior", "sift-pnp"): "align without a match, or match classical features",
    ("gn-net-from-prior", "orb-pnp"): "align without a match, or match classical features",
    ("aliked-pnp", "sift-pnp"): "match learned or classical features",
    ("aliked-pnp", "orb-pnp"): "match learned or classical features",
    ("gn-net-one-start", "dso"): "learned features or grey levels, from the keyframe's pose",
    ("gn-net-one-start", "sift-pnp"): "align once from the keyframe's pose, or match classical features",
    ("gn-net-one-start", "orb-pnp"): "align once from the keyframe's pose, or match classical features",
    ("gn-net-from-prior", "gn-net-one-start"): "what more starts add, along the road and nearby",
    ("gn-net", "gn-net-from-prior"): "what starts from its own matches add",
    ("gn-net", "gn-net-from-aliked-pnp"): "align from its own matches, or from another method's pose",
    ("gn-net-from-aliked-pnp", "aliked-pnp"): "what alignment adds to another method's pose",
    ("gn-net", "gn-net-contrastive"): "all losses, or the contrastive one alone",
}
"""by two methods, the question that the first less the second answers: all differences that the page lists"""
_OF_DIFFERENCES = """\
Percentage points by which the first method is ahead of the second, with the 95 % interval of each difference by itself,
and its p value over all {count} differences of this page: the probability of one as clear anywhere among them if no two
methods differed, counted over all signs of the districts' differences ([how](../../docs/statistics.md)). **A star means
that the methods differ, with one error rate of 5 % for the whole page.** An interval without zero that has no star may
be chance: among so many, some are. Without an interval, the pairs on which two methods differ are worth fewer than ten
independent ones. Where they differ on very few, the end away from zero is wide: the failures that were seen do not tell
how long such stretches may be.
"""


@dataclass(frozen=True, eq=False)
class Group:
    """A group of pairs that are evaluated together."""

    name: str
    rows: pd.DataFrame
    """one row for each method and pair, with its district, step, pair_set and the per-pair value of each metric"""

    @property
    def pairs(self) -> int:
        return int(self.rows["method"].value_counts().max())

    @property
    def districts(self) -> int:
        return int(self.rows["district"].nunique())

    @cached_property
    def methods(self) -> frozenset[str]:
        """The methods that were asked of all its pairs."""
        pairs = self.rows["method"].value_counts()
        return frozenset(pairs.index[pairs == pairs.max()])

    def mean(self, method: str, metric: str) -> float:
        """The mean over the districts of the mean over a district's pair sets."""
        return float(np.mean([series.mean() for series in self.by_step[method, metric]]))

    def interval(self, method: str, metric: str) -> Interval | None:
        """Of :meth:`mean`; from eight districts on at least as wide as their spread demands."""
        series = self.by_step[method, metric]
        return mean_interval(series, roads=range(len(series)))

    def ahead(self, method: str, other: str, metric: str) -> Difference:
        """The difference of ``method`` to ``other``, over the steps of the drives."""
        a, b = self.by_step[method, metric], self.by_step[other, metric]
        return paired_difference(a, b, roads=range(len(a)))

    @cached_property
    def by_step(self) -> dict[tuple[str, str], list[Array]]:
        """By method and metric: one series for each district, by the step of the queries."""
        found: dict[tuple[str, str], list[Array]] = {}
        for method, of_method in self.rows.groupby("method"):
            for _, district in of_method.groupby("district"):
                sets = [of for _, of in district.groupby("pair_set")]
                steps = [of["step"].to_numpy() for of in sets]
                for metric in METRICS:
                    series = by_place([of[metric].to_numpy() for of in sets], steps)
                    found.setdefault((str(method), metric), []).append(series)
        return found


def commit() -> str:
    """The commit of the repository, with a plus if files differ from it."""
    asked = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty=+", "--abbrev=12"]
    return subprocess.run(asked, check=True, capture_output=True, text=True).stdout.strip()


def rounded_percent(share: float) -> str:
    """A share in whole percent, about as fine as its interval; with a decimal where 100 would say that none is lost."""
    return f"{100 * min(share, 0.999):.1f}" if 0.995 <= share < 1.0 else f"{100 * share:.0f}"


def run(*words: object) -> None:
    """Run a relocbench command; its messages go to standard error."""
    subprocess.run([sys.executable, "-m", "relocbench", *map(str, words)], check=True, stdout=sys.stderr)


Listed = dict[tuple[tuple[str, str], str], Difference]
"""the differences of a page by the two methods and the group"""


def differences(groups: Sequence[Group]) -> Listed:
    """All differences of the share that is found, with one error rate."""
    keys = [(both, group) for both in QUESTIONS for group in groups if group.methods.issuperset(both)]
    found = [group.ahead(*both, METRICS[0]) for both, group in keys]
    return {(both, group.name): each for (both, group), each in zip(keys, controlled(found), strict=True)}


def difference_table(listed: Listed) -> list[str]:
    """What the first of two methods finds more than the second, with the groups side by side."""
    if not listed:
        return []
    columns = dict.fromkeys(group for _, group in listed)
    lines = [f"\n## Differences\n\n{_OF_DIFFERENCES.format(count=len(listed))}"]
    lines += [f"| methods | question |{''.join(f' {column} | p |' for column in columns)}"]
    lines += [f"|---|---|{'---:|---:|' * len(columns)}"]
    for both in dict.fromkeys(both for both, _ in listed):
        cells = []
        for column in columns:
            found = listed.get((both, column))
            p = None if found is None else found.adjusted_p
            cells += ["" if found is None else in_points(found), "" if p is None else p_text(p)]
        lines.append(f"| {' | '.join([f'{both[0]} less {both[1]}', QUESTIONS[both], *cells])} |")
    return lines


def p_text(p: float) -> str:
    """A p value with two digits, which rounding does not move to the other side of 0.05."""
    text = f"{p:.2g}"
    return text if (float(text) <= 1 - LEVEL + 1e-12) == (p <= 1 - LEVEL) else f"{p:.3g}"

"""Near-copies of one method: what counts once where methods are compared.

Who hands in five copies of a method, each a little different, makes every comparison of the table harder, and puts five
methods above those that are worse. So near-copies are one family, which its first method represents. Methods are
compared with representatives alone (:mod:`relocbench.metrics.statistics.ranks`).

Which method comes first must not be the choice of whoever copies; boards go by the time of the run. A method joins the
first family of which one method is nearly its own copy, unless it is clearly better than the representative: nothing
that is better hides behind its copy, and nobody is represented by something clearly worse. What comes later changes no
family and no representative. Two methods that are both near to a third, later one stay two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array

SAME_WITHIN = 0.2
"""by which share of the larger one two errors of one answer may differ"""
SAME_ANSWERS, LEAST_ANSWERS = 0.5, 10
"""share of the pairs that either method answered on which near-copies give the same answer, and the least number of
these pairs"""
AHEAD, STANDARD_ERRORS = 0.01, 4.0
"""by how much a method must be better than a representative not to be represented by it: by more than a percentage
point and by so many standard errors of independent pairs, which is more than noise on copied answers gives"""


def families_of(values: Mapping[str, Sequence[Array]], near: Callable[[str, str], bool]) -> dict[str, str]:
    """The representative of each method, which may be itself.

    Args:
        values: (N_s,) of each method and pair set, in the order in which the methods came; higher is better.
        near: whether two methods, the later one first, are nearly copies.
    """
    families: dict[str, list[str]] = {}
    for name, own in values.items():
        joined = (
            first
            for first, members in families.items()
            if any(near(name, member) for member in members) and not _clearly_better(own, values[first])
        )
        families.setdefault(next(joined, name), []).append(name)
    return {member: first for first, members in families.items() for member in members}


def _clearly_better(a: Sequence[Array], b: Sequence[Array]) -> bool:
    differences = [x - y for x, y in zip(a, b, strict=True)]
    mean = float(np.mean([of.mean() for of in differences]))
    error = math.sqrt(sum(float(of.var()) / len(of) for of in differences)) / len(differences)
    return mean > max(AHEAD, STANDARD_ERRORS * error)


def same_answers(a: Sequence[ArrayLike | None], b: Sequence[ArrayLike | None]) -> bool:
    """Whether two methods give the same answer on half of the pairs that either answered, judged by their errors.

    Two answers are the same if each of their K errors differs by at most a fifth of the larger one. Those of different
    methods that are equally accurate agree that closely on few pairs, since both errors must.

    Args:
        a, b: (K, N_s) errors of each pair set, inf where there is no answer; None where there is no result.
    """
    known = [
        [np.atleast_2d(np.asarray(of, dtype=np.float64)) for of in both]
        for both in zip(a, b, strict=True)
        if both[0] is not None and both[1] is not None
    ]
    if not known:
        return False
    x, y = (np.concatenate(of, axis=1) for of in zip(*known, strict=True))
    answers = np.isfinite(x).all(axis=0), np.isfinite(y).all(axis=0)
    both, either = answers[0] & answers[1], int((answers[0] | answers[1]).sum())
    close = np.abs(x[:, both] - y[:, both]) <= SAME_WITHIN * np.maximum(x[:, both], y[:, both])
    return either >= LEAST_ANSWERS and int(close.all(axis=0).sum()) >= SAME_ANSWERS * either

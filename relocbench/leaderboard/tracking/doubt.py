"""Doubt about the truth of pair sets, carried from the images to every board.

Where a dataset is available, images of some pairs of each set are compared at the true pose, as ``relocbench inspect
--pictures`` does. Of a set whose images are mostly apart there, boards say so and by how much: its numbers measure the
truth rather than the methods. Rendered sets, whose truth has a sigma of zero, are exact and not compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.inspect.agreement import ImageAgreement, measure_agreement
from relocbench.datasets.inspect.overlay import spread_pairs
from relocbench.errors import DatasetError
from relocbench.execution import Run, default_workers, run_units
from relocbench.leaderboard.common.text import Value
from relocbench.progress import Reporter

_MOST_OF_A_SET = 6
"""pairs of a pair set that are compared, spread along the drive: those that inspect draws too"""
_MOST_OF_ALL = 48
"""of a dataset, but for two of each pair set"""
_MANY = 24
"""pairs from which on they are compared in processes, whose start takes as long as several pairs"""
_LEAST_APART = 2
"""pairs that must be apart: one may be a mistake of the comparison"""


@dataclass(frozen=True)
class TruthCheck:
    """What a comparison of the images of some pairs at the true pose found."""

    compared: int
    agree: int
    apart: int
    """of the compared pairs; of the others nothing can be told"""
    apart_px: float
    """median distance of the edges of pairs that are apart, pixels of the query; NaN where none is"""
    width_px: int
    """width of the queries' images"""

    @property
    def in_doubt(self) -> bool:
        """Whether most pairs of which something can be told are apart."""
        return self.apart >= _LEAST_APART and self.apart > self.agree

    @property
    def words(self) -> str:
        """By how much the truth and the images are apart."""
        among = f"in {self.apart} of {self.compared} pairs that were compared"
        far = f"a median of {self.apart_px:.1f} px apart at the true pose, in images {self.width_px} px wide"
        return f"{among}, edges lie {far}"


@dataclass(frozen=True)
class _Job:
    dataset: Dataset
    pair_set: str
    key: PairKey


def check_truth(dataset: Dataset, pair_sets: Iterable[str], reporter: Reporter) -> dict[str, TruthCheck]:
    """Compare the images of some pairs of each pair set that has images, depth and a truth that can be wrong.

    A pair whose images cannot be read is left out with a note: its errors follow from poses alone.

    Raises:
        DatasetError: a file of poses or pairs is bad.
    """
    sets = [dataset.pair_set(name) for name in pair_sets]
    sets = [s for s in sets if dataset.has_images(s) and any(p.sigma_translation_m != 0 for p in s.pairs)]
    count = max(_LEAST_APART, min(_MOST_OF_A_SET, _MOST_OF_ALL // max(len(sets), 1)))
    jobs = [_Job(dataset, s.name, pair.key) for s in sets for pair in spread_pairs(s.pairs, count)]
    if not jobs:
        return {}
    comparisons: dict[str, list[tuple[ImageAgreement, int]]] = {}
    workers = default_workers() if len(jobs) >= _MANY else 1
    with reporter.stage("comparing images with the truth", len(jobs)) as advance:
        for index, each in run_units(_compare, jobs, Run(workers)):
            if isinstance(each, str):
                reporter.note(f"the truth of a pair of {jobs[index].pair_set} is not compared with its images: {each}")
            else:
                comparisons.setdefault(jobs[index].pair_set, []).append(each)
            advance(1)
    return {name: _check_of(each) for name, each in comparisons.items()}


def doubts_of(checks: Mapping[str, TruthCheck], pair_sets: Iterable[str]) -> list[tuple[str, str]]:
    """The pair sets among some whose truth is in doubt, each with by how much in words."""
    return [(name, checks[name].words) for name in pair_sets if name in checks and checks[name].in_doubt]


def truth_rows(title: Mapping[str, Value], checks: Mapping[str, TruthCheck]) -> list[dict[str, Value]]:
    """The rows of ``truth.csv``, each beginning with the columns that name the dataset."""
    return [
        {
            **title,
            "pair_set": name,
            "compared": check.compared,
            "agree": check.agree,
            "apart": check.apart,
            "median_apart_px": None if np.isnan(check.apart_px) else check.apart_px,
            "width_px": check.width_px,
            "in_doubt": "yes" if check.in_doubt else "no",
        }
        for name, check in checks.items()
    ]


def _compare(job: _Job) -> tuple[ImageAgreement, int] | str:
    """The agreement and the width of the query; why there is none where an image cannot be read."""
    pair_set = job.dataset.pair_set(job.pair_set)
    pair = pair_set.by_key[job.key]
    assert pair.T_query_ref is not None  # spread_pairs has chosen it
    try:
        query, reference = job.dataset.query(pair_set, pair), job.dataset.reference(pair_set, pair)
        return measure_agreement(reference, query, pair.T_query_ref), query.camera.width
    except DatasetError as why:
        return str(why)


def _check_of(comparisons: Sequence[tuple[ImageAgreement, int]]) -> TruthCheck:
    apart = [agreement.shift_px for agreement, _ in comparisons if agreement.verdict == "apart"]
    agree = sum(agreement.verdict == "agree" for agreement, _ in comparisons)
    return TruthCheck(
        len(comparisons), agree, len(apart), float(np.median(apart)) if apart else np.nan, comparisons[0][1]
    )

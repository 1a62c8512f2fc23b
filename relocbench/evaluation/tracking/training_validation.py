"""Validation of trackers during training: scoring them in memory on a fixed choice of a split's pairs.

A pair is answered and scored as in ``relocbench evaluate``, but nothing is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.datasets.core import fingerprint
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.learning.training_pairs import VALIDATION_SPLIT
from relocbench.errors import ConfigError
from relocbench.evaluation.isolation.answers import CheckedAnswer, error_answer
from relocbench.evaluation.isolation.handles import LocalTracker
from relocbench.evaluation.isolation.views import masked_query, masked_reference
from relocbench.metrics import PoseErrors, pose_array, pose_errors, summarize
from relocbench.progress import Reporter
from relocbench.tracking import Tracker
from relocbench.training import ValidationScores

METRICS = ("t_auc@0.5m", "r_auc@0.5deg", "recall@(0.25m,2deg)")


@dataclass(frozen=True, eq=False)
class _ValidationPair:
    dataset: Dataset
    pair_set: PairSet
    pair: Pair
    conditions: str


class TrackerValidation:
    """A fixed choice of pairs from the validation splits of some datasets, on which trackers are scored.

    Args:
        datasets: folders; datasets without a validation split are ignored.
        pairs: the largest number of pairs, spread evenly over all combinations of reference and query condition.
        seed: of the choice.
        reporter: shows progress.

    Raises:
        ConfigError: no dataset has the split, or the splits have no pair with ground truth.
        DatasetError: a bad dataset.
    """

    def __init__(self, datasets: Sequence[Path], pairs: int, seed: int, reporter: Reporter) -> None:
        self._reporter = reporter
        opened = [Dataset(root) for root in datasets]
        with_split = [dataset for dataset in opened if VALIDATION_SPLIT in dataset.splits]
        if not with_split:
            raise ConfigError(
                f"no dataset has a split '{VALIDATION_SPLIT}' to choose weights by; give one that has with --dataset, "
                "or --no-validation to keep the last weights"
            )
        for dataset in with_split:
            dataset.require_images(dataset.pair_sets(VALIDATION_SPLIT), "no tracker can be tried on it")
            for fault in fingerprint.faults(dataset.layout, content="text"):
                raise fault
        self._asked = _evenly([each for dataset in with_split for each in _pairs_of(dataset)], pairs, seed)
        if not self._asked:
            raise ConfigError(f"split '{VALIDATION_SPLIT}' has no pair with ground truth", with_split[0].root)

    def __len__(self) -> int:
        return len(self._asked)

    def __call__(self, tracker: Tracker) -> ValidationScores:
        """Track every pair and score the answers; an exception of the tracker's costs its pair and is reported."""
        conditions, answers, truth = [], [], []
        messages: dict[str, None] = {}
        with self._reporter.stage("validation", len(self._asked)) as advance:
            for _, group in groupby(self._asked, key=_keyframe):
                asked = list(group)
                for each, result in zip(asked, _track(tracker, asked), strict=True):
                    if result.status == "error":
                        messages.setdefault(result.message)
                    conditions.append(each.conditions)
                    answers.append(result.T_query_ref)
                    truth.append(each.pair.T_query_ref)
                    advance(1)
        errors = pose_errors(pose_array(answers), pose_array(truth))
        of = np.array(conditions)
        names = sorted(set(conditions))
        return ValidationScores(
            together=_scores(errors, np.ones(len(of), dtype=bool)),
            by_conditions={name: _scores(errors, of == name) for name in names},
            pairs={name: int(np.sum(of == name)) for name in names},
            messages=tuple(messages)[:3],
        )


def _track(tracker: Tracker, pairs: Sequence[_ValidationPair]) -> list[CheckedAnswer]:
    """The answers to the pairs of one keyframe."""
    first = pairs[0]
    times = bool(getattr(tracker, "uses_times", False))
    handle = LocalTracker(tracker)
    keyframe = first.dataset.reference(first.pair_set, first.pair, handle.declared.neighbours)
    crash = handle.declared.fault or handle.prepare(masked_reference(keyframe, times))
    if crash:
        return [error_answer(crash)] * len(pairs)
    queries = (masked_query(each.dataset.query(each.pair_set, each.pair), times) for each in pairs)
    return [handle.ask([query])[0][0] for query in queries]


def _pairs_of(dataset: Dataset) -> list[_ValidationPair]:
    out = []
    for pair_set in dataset.pair_sets(VALIDATION_SPLIT):
        ref, query = (dataset.traversal(name).condition for name in (pair_set.reference, pair_set.query))
        known = (pair for pair in pair_set.pairs if pair.T_query_ref is not None)
        out += [_ValidationPair(dataset, pair_set, pair, f"{ref} -> {query}") for pair in known]
    return out


def _evenly(pairs: Sequence[_ValidationPair], count: int, seed: int) -> list[_ValidationPair]:
    """Choose up to ``count`` pairs, one from each combination of conditions in turn, and sort them by keyframe."""
    rng = np.random.default_rng(seed)
    turn: dict[str, int] = {}
    ranked: list[tuple[int, int, _ValidationPair]] = []
    for number in rng.permutation(len(pairs)):
        at = turn[pairs[number].conditions] = turn.get(pairs[number].conditions, 0) + 1
        ranked.append((at, len(ranked), pairs[number]))
    ranked.sort(key=lambda entry: entry[:2])
    return sorted((each for _, _, each in ranked[:count]), key=lambda a: (*_keyframe(a), a.pair_set.name, a.pair.key))


def _keyframe(pair: _ValidationPair) -> tuple[str, str, str, int]:
    return str(pair.dataset.root), pair.pair_set.reference, pair.pair_set.reference_camera, pair.pair.ref_timestamp_ns


def _scores(errors: PoseErrors, chosen: Any) -> dict[str, float]:
    part = PoseErrors(
        errors.rotation_error_deg[chosen], errors.translation_error_m[chosen], errors.mlad_translation_error_m[chosen]
    )
    values = summarize(part).values
    return {name: float(value) for name in METRICS if (value := values[name]) is not None}

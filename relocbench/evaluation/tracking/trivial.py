"""The two trivial baselines that need no image: the identity pose, and poses from times alone.

Drives along one road keep a similar pace, so that times tell much of a pose. Trackers see no times; what times would
have told them is shown beside their scores. The baseline is fitted to other pairs of the same set, which no method is
given: it is at least what a method could learn of times.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relocbench.arrays import Array, Mask, Times
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.datasets.core.writer import versions
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import DatasetResults, MethodResults, RunRecord, write_record
from relocbench.evaluation.tables.answers import ANSWERS, Answer
from relocbench.geometry import se3_exp, se3_log
from relocbench.methods import MethodSpec

IDENTITY = "identity"
IDENTITY_TARGETS = (IDENTITY, "baselines.identity:Identity")
"""the names of the tracker that answers the identity pose"""


def is_identity(spec: MethodSpec) -> bool:
    """Whether a method answers the identity pose, whatever its label."""
    return spec.target in IDENTITY_TARGETS


def run_identity(
    dataset: Dataset, pair_sets: Sequence[PairSet], spec: MethodSpec, results: DatasetResults
) -> MethodResults:
    """Write the identity pose as the answer to every pair.

    Raises:
        PredictionError: the folder holds predictions of another method.
    """
    folder = results.method(spec.label)
    if folder.run_yaml.exists() and (target := folder.run_record().target) not in IDENTITY_TARGETS:
        raise PredictionError(f"holds predictions of '{target}'; choose another label", folder.run_yaml)
    for pair_set in pair_sets:
        folder.root.mkdir(parents=True, exist_ok=True)
        write_pose_lines(folder.predictions(pair_set.name), [PoseLine(*p.key, np.eye(4)) for p in pair_set.evaluated])
        ANSWERS.write(folder.answers(pair_set.name), [Answer(*p.key, "ok") for p in pair_set.evaluated])
    record = RunRecord.on(
        dataset,
        method=spec.label,
        target=spec.target,
        versions=versions(),
        isolated=True,  # no method ran, and so none beside the truth
    )
    write_record(folder.run_yaml, record)
    return folder


CLOCK = "clock"
TARGET = "floor:clock"
FOLDS = 5
_RIDGE = 1e-3
_WITHHELD = "the truth is withheld, to which the baseline is fitted"


def clock_poses(
    ref_ns: Sequence[int],
    query_ns: Sequence[int],
    T_query_ref: Array,
    fitted: Mask | None = None,
) -> Array:
    """Poses from times alone, by cross-validation: each pair is predicted from the pairs of other parts of the drive.

    The six coordinates of ``log T_query_ref`` are regressed (ridge regression) on the time since the start of each
    drive, its square, and the product of both times. The pairs are divided into five consecutive parts of the query's
    drive; each part is predicted by a fit to the other four.

    Args:
        ref_ns: (N,) times of the keyframes.
        query_ns: (N,) times of the queries.
        T_query_ref: (N, 4, 4) the truth.
        fitted: (N,) the pairs that are fitted; the others are predicted from all of these. Default: all.

    Returns:
        (N, 4, 4); the identity where there are too few pairs to fit.
    """
    out = np.tile(np.eye(4), (len(T_query_ref), 1, 1))
    known = np.ones(len(out), dtype=bool) if fitted is None else fitted
    features = _features(np.asarray(ref_ns, dtype=np.int64), np.asarray(query_ns, dtype=np.int64))
    if known.sum() <= 2 * features.shape[1]:
        return out
    logs = np.array([se3_log(T) for T in T_query_ref])
    order = np.lexsort((np.asarray(ref_ns), np.asarray(query_ns)))
    order = order[known[order]]
    others = [np.flatnonzero(~known)] if not known.all() else []
    for part in (*np.array_split(order, FOLDS), *others):
        rest = np.setdiff1d(order, part)
        mean, weights = _ridge(features[rest], logs[rest])
        out[part] = [se3_exp(log) for log in mean + features[part] @ weights]
    return out


def _features(ref_ns: Times, query_ns: Times) -> Array:
    """(N, 5) functions of the times, each time from 0 to 1 over the pairs."""
    r, q = (_share(times) for times in (ref_ns, query_ns))
    return np.stack([r, q, r * r, q * q, r * q], axis=1)


def _share(times_ns: Times) -> Array:
    since = (times_ns - times_ns.min()).astype(np.float64) if len(times_ns) else np.zeros(0)
    longest = float(since.max(initial=0.0))
    return since / longest if longest else since


def _ridge(x: Array, y: Array) -> tuple[Array, Array]:
    """The offset (6,) and weights (K, 6) of a ridge regression; offsets are not shrunk."""
    x_mean, y_mean = x.mean(axis=0), y.mean(axis=0)
    centred = x - x_mean
    spread = float(np.var(x, axis=0).mean()) or 1.0
    gram = centred.T @ centred / len(x) + _RIDGE * spread * np.eye(x.shape[1])
    weights = np.linalg.solve(gram, centred.T @ (y - y_mean) / len(x))
    return y_mean - x_mean @ weights, weights


def run_clock(dataset: Dataset, pair_sets: Sequence[PairSet], results: DatasetResults) -> MethodResults:
    """Write the baseline's predictions as those of a method called ``clock``; they are computed anew each time.

    Raises:
        PredictionError: the folder holds predictions of a method.
    """
    folder = results.method(CLOCK)
    if folder.run_yaml.exists() and (target := folder.run_record().target) != TARGET:
        raise PredictionError(
            f"holds predictions of '{target}'; the label '{CLOCK}' is that of the timestamp-only baseline",
            folder.run_yaml,
        )
    for pair_set in pair_sets:
        pairs = pair_set.evaluated
        truth = [pair.T_query_ref for pair in pairs if pair.T_query_ref is not None]
        lines: list[PoseLine] = []
        answers = [Answer(*pair.key, "failed", message=_WITHHELD) for pair in pairs]
        if pairs and len(truth) == len(pairs):
            ref, query = zip(*(pair.key for pair in pairs), strict=True)
            # Pairs of different places are drawn at random, so that fitting them would only spoil the baseline.
            fitted = np.array([not pair.is_negative for pair in pairs])
            poses = clock_poses(ref, query, np.array(truth), fitted)
            lines = [PoseLine(*pair.key, pose) for pair, pose in zip(pairs, poses, strict=True)]
            answers = [Answer(*pair.key, "ok") for pair in pairs]
        folder.root.mkdir(parents=True, exist_ok=True)
        write_pose_lines(folder.predictions(pair_set.name), lines)
        ANSWERS.write(folder.answers(pair_set.name), answers)
    record = RunRecord.on(dataset, method=CLOCK, target=TARGET, versions=versions(), uses_times=True)
    write_record(folder.run_yaml, record)
    return folder

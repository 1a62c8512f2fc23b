"""The floor of times alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from small_dataset import ACROSS, make_small_dataset

from relocbench.arrays import Array
from relocbench.errors import PredictionError
from relocbench.evaluation.tables.answers import read_answers
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.evaluation.tracking.trivial import clock_poses
from relocbench.geometry import make_transform, so3_exp
from relocbench.metrics import pose_errors
from relocbench.progress import Silent

NS = 10**9


def drive(count: int, speed_noise: float, seed: int = 0) -> tuple[list[int], list[int], Array]:
    """Keyframes and queries of two drives of about 10 m/s, each query with the keyframe about 2 m behind it."""
    rng = np.random.default_rng(seed)
    keyframes = 10.0 * np.arange(count) + rng.normal(0, speed_noise, count)
    queries = 10.0 * np.arange(count) + 2.0 + rng.normal(0, speed_noise, count)
    truth = [make_transform(so3_exp([0, 0.01, 0]), [0.3, 0, k - q]) for k, q in zip(keyframes, queries, strict=True)]
    return [i * NS for i in range(count)], [5 * 10**15 + i * NS for i in range(count)], np.array(truth)


def test_drives_of_equal_pace_are_given_away_by_their_times() -> None:
    ref, query, truth = drive(100, 0.05)
    errors = pose_errors(clock_poses(ref, query, truth), truth)
    assert np.median(errors.translation_error_m) < 0.15
    assert np.max(errors.rotation_error_deg) < 1e-6


def test_times_that_say_nothing_give_nothing_away() -> None:
    ref, query, truth = drive(100, 20.0)
    errors = pose_errors(clock_poses(ref, query, truth), truth)
    assert np.median(errors.translation_error_m) > 5


def test_a_pair_is_not_predicted_from_its_own_truth() -> None:
    ref, query, truth = drive(40, 0.05)
    before = clock_poses(ref, query, truth)
    changed = truth.copy()
    changed[7, 2, 3] += 100.0
    after = clock_poses(ref, query, changed)
    np.testing.assert_array_equal(after[7], before[7])
    assert not np.array_equal(after[30], before[30])


def test_few_pairs_and_standing_clocks_give_the_identity_or_the_mean() -> None:
    ref, query, truth = drive(6, 0.05)
    np.testing.assert_array_equal(clock_poses(ref, query, truth), np.tile(np.eye(4), (6, 1, 1)))
    _, _, truth = drive(40, 0.05)
    poses = clock_poses([7] * 40, [9] * 40, truth)
    assert np.all(np.isfinite(poses))


@pytest.mark.thorough
def test_the_floor_stands_beside_the_methods(tmp_path: Path) -> None:
    data = make_small_dataset(tmp_path / "small", frames=12)
    options = EvaluateOptions(dataset=data.root, methods=("clock", "identity"), out=tmp_path / "out", workers=0)
    identity, clock = evaluate_methods(options, Silent()).folders
    assert (identity.label, clock.label) == ("identity", "clock")
    record = clock.run_record()
    assert record.target == "floor:clock"
    assert record.uses_times
    scores = clock.score_record().pair_sets[ACROSS]["all"]
    assert scores["t_auc@0.5m"] > identity.score_record().pair_sets[ACROSS]["all"]["t_auc@0.5m"]  # type: ignore[operator]
    first = clock.predictions(ACROSS).read_bytes()
    evaluate_methods(options, Silent())
    assert clock.predictions(ACROSS).read_bytes() == first


def test_withheld_truth_has_no_floor(tmp_path: Path) -> None:
    data = make_small_dataset(tmp_path / "small", truth=False)
    options = EvaluateOptions(dataset=data.root, methods=("clock",), out=tmp_path / "out", workers=0)
    (clock,) = evaluate_methods(options, Silent()).folders
    assert {answer.status for answer in read_answers(clock.answers(ACROSS)).values()} == {"failed"}


def test_a_methods_folder_is_not_overwritten(tmp_path: Path) -> None:
    data = make_small_dataset(tmp_path / "small")
    common = {"dataset": data.root, "out": tmp_path / "out", "workers": 0}
    evaluate_methods(EvaluateOptions(methods=("clock=identity",), **common), Silent())
    with refused(PredictionError, "", None, "clock"):
        evaluate_methods(EvaluateOptions(methods=("clock",), **common), Silent())

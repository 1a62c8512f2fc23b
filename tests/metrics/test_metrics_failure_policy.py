"""Each rule of the failure policy, alone."""

from __future__ import annotations

import numpy as np
import pytest
from refusals import refused

from relocbench.errors import DatasetError, PredictionError
from relocbench.metrics import (
    align_predictions,
    answered_pairs,
    infinite_where_failed,
    mean_over_pair_sets,
    pose_errors,
    summarize,
    totals,
)

PAIRS = [(10, 100), (20, 200), (30, 300)]


def test_missing_answer_has_infinite_errors() -> None:
    poses = np.stack([np.eye(4), np.full((4, 4), np.nan), np.eye(4)])
    errors = pose_errors(poses, np.tile(np.eye(4), (3, 1, 1)))
    np.testing.assert_array_equal(errors.translation_error_m, [0, np.inf, 0])
    np.testing.assert_array_equal(errors.rotation_error_deg, [0, np.inf, 0])
    np.testing.assert_array_equal(errors.mlad_translation_error_m, [0, np.inf, 0])


def test_failed_pair_has_infinite_errors_whatever_pose_stands_there() -> None:
    truth = np.tile(np.eye(4), (2, 1, 1))
    errors = pose_errors(truth, truth, answered=[True, False])
    for error in (errors.translation_error_m, errors.rotation_error_deg, errors.mlad_translation_error_m):
        np.testing.assert_array_equal(error, [0, np.inf])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("entry", [(0, 0), (1, 3), (3, 3)])
def test_one_non_finite_number_in_a_pose_fails_the_pair_alone(bad: float, entry: tuple[int, int]) -> None:
    truth = np.tile(np.eye(4), (2, 1, 1))
    predicted = truth.copy()
    predicted[(1, *entry)] = bad
    errors = pose_errors(predicted, truth)
    for error in (errors.translation_error_m, errors.rotation_error_deg, errors.mlad_translation_error_m):
        np.testing.assert_array_equal(error, [0, np.inf])
    np.testing.assert_array_equal(errors.answered, [True, False])


def test_a_finite_pose_too_far_to_measure_is_a_failure_and_never_nan() -> None:
    predicted = np.tile(np.eye(4), (1, 1, 1))
    predicted[0, :3, 3] = 1e200
    errors = pose_errors(predicted, np.eye(4)[None])
    assert errors.translation_error_m[0] == errors.rotation_error_deg[0] == np.inf


def test_answered_needs_both_the_word_and_a_finite_pose() -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[1] = np.nan
    np.testing.assert_array_equal(answered_pairs(poses), [True, False, True])
    np.testing.assert_array_equal(answered_pairs(poses, [False, True, True]), [False, False, True])


def test_nan_error_becomes_infinite() -> None:
    np.testing.assert_array_equal(infinite_where_failed([1.0, np.nan], [True, True]), [1.0, np.inf])


def test_denominator_is_every_pair_of_the_set() -> None:
    truth = np.tile(np.eye(4), (8, 1, 1))
    answered = np.arange(8) < 2
    summary = summarize(pose_errors(truth, truth, answered))
    assert summary.pairs == 8
    assert summary.answered == 2
    for name in ("coverage", "t_auc@0.5m", "r_auc@1deg", "recall@(5m,10deg)", "mlad_recall@0.1m"):
        assert summary[name] == 0.25


def test_failure_is_not_replaced_by_the_identity_even_where_the_identity_is_exact() -> None:
    truth = np.tile(np.eye(4), (2, 1, 1))
    summary = summarize(pose_errors(np.full((2, 4, 4), np.nan), truth))
    assert summary["recall@(5m,10deg)"] == 0.0
    assert summary["median_translation_error_m"] == np.inf


def test_alignment_finds_each_answer_in_any_order() -> None:
    np.testing.assert_array_equal(align_predictions(PAIRS, [(30, 300), (10, 100)]), [1, -1, 0])


def test_unknown_pair_is_an_error_that_names_file_line_and_pair() -> None:
    with refused(PredictionError, "orb.txt", 7, "10 200", 3):
        align_predictions(PAIRS, [(10, 100), (10, 200)], path="orb.txt", lines=[6, 7])


def test_duplicate_pair_is_an_error_that_names_both_lines() -> None:
    with refused(PredictionError, "orb.txt", 9, "10 100", 6):
        align_predictions(PAIRS, [(10, 100), (20, 200), (10, 100)], path="orb.txt", lines=[6, 7, 9])


def test_pair_twice_in_the_set_itself_is_the_datasets_fault() -> None:
    with refused(DatasetError, "", None, "10 100"):
        align_predictions([*PAIRS, (10, 100)], [])


def test_no_pair_set_is_dropped_from_a_mean() -> None:
    assert mean_over_pair_sets([0.5, 1.0]) == 0.75
    assert mean_over_pair_sets([0.5, 0.0]) == 0.25
    assert mean_over_pair_sets([0.5, np.inf]) == np.inf
    assert mean_over_pair_sets([0.5, None]) is None
    assert mean_over_pair_sets([]) is None


def test_method_with_a_missing_set_has_blank_totals_for_every_metric() -> None:
    truth = np.tile(np.eye(4), (4, 1, 1))
    whole = summarize(pose_errors(truth, truth))
    half = summarize(pose_errors(truth, truth, np.arange(4) < 2))
    assert totals([whole, half])["t_auc@0.5m"] == 0.75
    assert set(totals([whole, None]).values()) == {None}


def test_pair_without_ground_truth_cannot_be_scored() -> None:
    with pytest.raises(ValueError, match="true poses"):
        pose_errors(np.eye(4)[None], np.full((1, 4, 4), np.nan))


def test_empty_pair_set_cannot_be_scored() -> None:
    with refused(DatasetError):
        summarize(pose_errors(np.zeros((0, 4, 4)), np.zeros((0, 4, 4))))

"""Recall, exact areas, medians, confidence and the registry that names them."""

from __future__ import annotations

import json
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import ArrayLike
from refusals import refused

from relocbench.arrays import Array
from relocbench.errors import ConfigError
from relocbench.geometry import make_transform, so3_exp
from relocbench.metrics import (
    METRICS,
    PairScores,
    PoseErrors,
    area_shares,
    metric_named,
    pose_errors,
    precision_recall,
    risk_coverage_area,
    spread_over_seeds,
    summarize,
    summarize_scores,
)

some_errors = arrays(np.float64, st.integers(1, 40), elements=st.one_of(st.floats(0, 3), st.just(np.inf), st.just(0.5)))


def errors_of(translation: ArrayLike, rotation: ArrayLike = 0.0) -> PoseErrors:
    t, r = np.broadcast_arrays(np.asarray(translation, float), np.asarray(rotation, float))
    return PoseErrors(rotation_error_deg=r, translation_error_m=t, mlad_translation_error_m=t)


def test_auc_hand_value_is_the_exact_area_and_not_the_trapezoid() -> None:
    # Errors 0.1 and 0.2 m under 0.5 m: (0.8 + 0.6) / 2. The trapezoid through (0, 0), (0.1, 1/2), (0.2, 1),
    # (0.5, 1) is (0.025 + 0.075 + 0.3) / 0.5.
    error = np.array([0.1, 0.2])
    assert summarize(errors_of(error))["t_auc@0.5m"] == pytest.approx(0.7, abs=1e-15)
    trapezoid = np.trapezoid([0, 0.5, 1, 1], [0, 0.1, 0.2, 0.5]) / 0.5
    assert trapezoid == pytest.approx(0.8)


def test_auc_of_rotation_and_translation_hand_values() -> None:
    summary = summarize(errors_of([0.0, 0.25, 0.5, np.inf], [0.5, 0.125, 2.0, np.inf]))
    assert summary["t_auc@0.5m"] == (1 + 0.5) / 4
    assert summary["t_auc@1m"] == (1 + 0.75 + 0.5) / 4
    assert summary["r_auc@0.5deg"] == 0.75 / 4
    assert summary["r_auc@1deg"] == (0.5 + 0.875) / 4


def test_exact_area_and_trapezoid_agree_for_thousands_of_pairs_only() -> None:
    rng = np.random.default_rng(5)

    def gap(n: int) -> float:
        error = np.sort(rng.exponential(0.3, n))
        inside = np.concatenate([[0], error[error < 0.5], [0.5]])
        share = np.searchsorted(error, inside, side="right") / n
        return float(np.trapezoid(share, inside) / 0.5 - area_shares(error, 0.5).mean())

    assert gap(20) > 0.005
    assert 0 < gap(3000) < 0.0005


@given(some_errors, st.floats(0.01, 2))
def test_auc_is_the_integral_of_the_cumulative_curve(error: Array, tau: float) -> None:
    knots = np.concatenate([[0.0], np.sort(error[error < tau]), [tau]])
    shares = np.searchsorted(np.sort(error), knots[:-1], side="right") / len(error)
    assert area_shares(error, tau).mean() == pytest.approx(np.sum(shares * np.diff(knots)) / tau, abs=1e-12)


@given(some_errors, st.integers(0, 39))
def test_no_share_falls_when_one_error_shrinks(error: Array, which: int) -> None:
    better = error.copy()
    better[which % len(error)] = 0.0
    before, after = summarize(errors_of(error, error)), summarize(errors_of(better, better))
    for metric in METRICS:
        if metric.per_pair is not None:
            assert after[metric.name] >= before[metric.name]  # type: ignore[operator]


def test_recall_counts_an_error_on_the_threshold_and_needs_both() -> None:
    summary = summarize(errors_of([0.25, np.nextafter(0.25, 1), 0.25, 0.0], [2.0, 2.0, np.nextafter(2.0, 3), 2.0]))
    assert summary["recall@(0.25m,2deg)"] == 0.5
    assert summary["recall@(0.5m,5deg)"] == 1.0


def test_mlad_recall_looks_at_its_own_translation_error_alone() -> None:
    errors = PoseErrors(
        rotation_error_deg=np.array([90.0, 0, 0]),
        translation_error_m=np.array([9.0, 0, 0]),
        mlad_translation_error_m=np.array([0.1, 0.2, 0.7]),
    )
    summary = summarize(errors)
    assert [summary[f"mlad_recall@{t}m"] for t in (0.1, 0.2, 0.5)] == [1 / 3, 2 / 3, 2 / 3]


def test_medians_are_over_all_pairs_and_infinite_when_more_than_half_failed() -> None:
    assert summarize(errors_of([0.1, 0.2, np.inf], [1, 2, np.inf]))["median_translation_error_m"] == 0.2
    summary = summarize(errors_of([0.1, np.inf, np.inf], [1, np.inf, np.inf]))
    assert summary["median_translation_error_m"] == summary["median_rotation_error_deg"] == np.inf


def test_median_of_an_even_number_of_pairs_is_infinite_from_half_on() -> None:
    # The mean of the two middle errors, one of which is infinite.
    assert summarize(errors_of([0.1, 0.2, np.inf, np.inf]))["median_translation_error_m"] == np.inf
    assert summarize(errors_of([0.1, 0.2, 0.4, np.inf]))["median_translation_error_m"] == pytest.approx(0.3)


def test_seconds_are_over_the_pairs_that_were_run() -> None:
    seconds = np.append(np.arange(1.0, 102.0), np.nan)
    summary = summarize(errors_of(np.zeros(102)), seconds=seconds)
    assert summary["median_seconds"] == 51.0
    assert summary["p95_seconds"] == 96.0
    assert summarize(errors_of(np.zeros(3)))["median_seconds"] is None
    assert summarize(errors_of(np.zeros(3)), seconds=np.full(3, np.nan))["p95_seconds"] is None


def test_summary_goes_to_json_and_back_with_infinities() -> None:
    summary = summarize(errors_of([np.inf, np.inf, 0.1]), np.array([1.0, 2, 3]), np.array([0.5, 0.5, 0.5]))
    plain = summary.to_dict()
    assert all(value is None or type(value) in (int, float) for value in plain.values())
    assert json.loads(json.dumps(plain)) == plain
    assert plain["pairs"] == 3
    assert plain["median_translation_error_m"] == np.inf


def test_mean_metrics_are_the_mean_of_their_per_pair_values() -> None:
    rng = np.random.default_rng(1)
    errors = errors_of(rng.exponential(0.4, 57), rng.exponential(2, 57))
    with_values = [metric for metric in METRICS if metric.per_pair is not None]
    assert with_values
    for metric in with_values:
        values = metric.per_pair(errors)  # type: ignore[misc]
        assert values.shape == (57,)
        assert np.all((values >= 0) & (values <= 1))
        assert metric.compute(PairScores(errors)) == np.mean(values)


def test_recall_by_overlap_and_by_change_of_scale_counts_a_pair_on_an_end_with_the_easier_ones() -> None:
    errors = errors_of([0.1, 0.1, 0.9, np.inf, 0.1, 0.1])
    overlap = np.array([1.0, 0.5, 0.5, 0.2, np.nan, 0.0])
    scale = np.array([1.0, 1.15, 1.4, 1.41, 1.8, np.nan])
    summary = summarize_scores(PairScores(errors, overlap=overlap, scale_change=scale))
    found = {
        name.removeprefix("recall_").partition("@")[0]: (summary[name], metric_named(name).over)
        for name in summary.values
        if name.startswith(("recall_overlap", "recall_scale"))
    }
    assert {name: value for name, (value, _) in found.items()} == {
        "overlap_to_0.1": 1.0,
        "overlap_0.1_to_0.2": None,
        "overlap_0.2_to_0.5": 0.0,
        "overlap_over_0.5": 2 / 3,
        "scale_to_1.15": 1.0,
        "scale_1.15_to_1.4": 0.0,
        "scale_1.4_to_1.8": 0.5,
        "scale_over_1.8": None,
    }
    over = {name: count(PairScores(errors, overlap=overlap)) for name, (_, count) in found.items() if count is not None}
    assert [over[name] for name in found] == [1, 0, 1, 3, 0, 0, 0, 0]
    assert {summarize(errors)[m.name] for m in METRICS if m.over is not None} == {None}


def test_identity_scores_on_close_pairs_and_must_be_read_against() -> None:
    # Pairs of 0.84 m mean distance and a few tenths of a degree, as keyframes of a street at short spacing have.
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(2000, 3))
    distance = rng.uniform(0.34, 1.34, 2000)
    t = distance[:, None] * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    T_gt = make_transform(so3_exp(rng.normal(0, 0.005, (2000, 3))), t)
    summary = summarize(pose_errors(np.tile(np.eye(4), (2000, 1, 1)), T_gt))
    assert np.mean(distance) == pytest.approx(0.84, abs=0.02)
    # uniform on 0.34..1.34: P(d <= 1) = 0.66, mean of max(0, 1 - d) = 0.66^2 / 2
    assert summary["recall@(1m,5deg)"] == pytest.approx(0.66, abs=0.03)
    assert summary["t_auc@1m"] == pytest.approx(0.66**2 / 2, abs=0.02)
    assert summary["r_auc@1deg"] > 0.4  # type: ignore[operator]
    assert summary["coverage"] == 1.0


def test_thresholds_finer_than_two_sigma_are_told() -> None:
    fine, coarse = metric_named("recall@(0.25m,2deg)"), metric_named("recall@(1m,5deg)")
    assert fine.threshold_finer_than(0.16)  # the sigma of lidar-registered ground truth of Oxford
    assert not coarse.threshold_finer_than(0.16)
    assert not fine.threshold_finer_than(0.125)
    assert fine.threshold_finer_than(0.0, sigma_deg=1.5)
    assert metric_named("r_auc@0.5deg").threshold_finer_than(None, 0.3)
    assert not metric_named("r_auc@0.5deg").threshold_finer_than(10.0, 0.1)
    assert not any(metric.threshold_finer_than(None) for metric in METRICS)
    assert not metric_named("coverage").threshold_finer_than(10.0, 10.0)


def test_unknown_metric_is_refused_with_the_names_there_are() -> None:
    with refused(ConfigError, "", None, "auc", "t_auc@0.5m"):
        metric_named("auc")


def test_confidence_area_hand_value() -> None:
    # Surest first: right, wrong, right, (no answer). Precision 1, 1/2, 2/3 at recall 1/4, 1/4, 2/4.
    curve = precision_recall([True, False, True, False], [True, True, True, False], [0.9, 0.8, 0.7, 0.99])
    np.testing.assert_allclose(curve.precision, [1, 1 / 2, 2 / 3])
    np.testing.assert_allclose(curve.recall, [1 / 4, 1 / 4, 2 / 4])
    assert curve.area == pytest.approx(1 / 4 + 2 / 3 / 4)


def test_equal_confidences_are_one_block_whatever_their_order() -> None:
    correct = np.array([True, False, True, False, False])
    for order in (np.arange(5), np.arange(5)[::-1]):
        curve = precision_recall(correct[order], np.ones(5, bool), np.ones(5))
        np.testing.assert_allclose(curve.precision, [2 / 5])
        assert curve.area == pytest.approx(4 / 25)


def test_answers_without_confidence_come_last_as_one_block() -> None:
    curve = precision_recall([True, True, False], [True, True, True], [np.nan, -5.0, np.nan])
    np.testing.assert_allclose(curve.precision, [1, 2 / 3])
    np.testing.assert_allclose(curve.recall, [1 / 3, 2 / 3])


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_confidence_area_depends_on_the_order_alone_and_is_at_most_the_recall(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    correct, answered = rng.random(n) < 0.5, rng.random(n) < 0.8
    correct &= answered
    confidence = rng.integers(0, 5, n).astype(float)
    area = precision_recall(correct, answered, confidence).area
    assert area == pytest.approx(precision_recall(correct, answered, 100 * np.exp(confidence)).area, abs=1e-15)
    assert 0 <= area <= correct.mean() + 1e-12
    perfect = precision_recall(correct, answered, correct.astype(float)).area
    assert perfect == pytest.approx(correct.mean())


def test_summary_judges_confidence_at_a_quarter_metre_and_two_degrees() -> None:
    errors = errors_of([0.1, 0.3, np.inf], [1.0, 1.0, np.inf])
    name = "confidence_auc_pr@(0.25m,2deg)"
    assert summarize(errors, confidence=np.array([2.0, 1.0, np.nan]))[name] == pytest.approx(1 / 3)
    assert summarize(errors, confidence=np.array([1.0, 2.0, np.nan]))[name] == pytest.approx(1 / 6)
    assert summarize(errors)[name] is None
    assert summarize(errors, confidence=np.full(3, np.nan))[name] is None


def test_risk_coverage_area_hand_value() -> None:
    # Surest first: right, wrong, right, (no answer): risks 0, 1/2, 1/3, 2/4 at coverages of 1, 2, 3 and 4 pairs.
    area = risk_coverage_area([True, False, True, False], [True, True, True, False], [0.9, 0.8, 0.7, 0.99])
    assert area == pytest.approx((0 + 1 / 2 + 1 / 3 + 2 / 4) / 4)


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_precision_over_coverage_ends_at_all_answers(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    correct, answered = rng.random(n) < 0.5, rng.random(n) < 0.8
    correct &= answered
    curve = precision_recall(correct, answered, rng.integers(0, 5, n).astype(float))
    assert np.all(np.diff(curve.coverage) > 0)
    if answered.any():
        assert curve.coverage[-1] == pytest.approx(answered.mean())
        assert curve.precision[-1] == pytest.approx(correct.sum() / answered.sum())
    else:
        assert len(curve.coverage) == 0


def test_equal_confidences_have_the_mean_area_of_all_their_orders() -> None:
    correct = np.array([True, False, False, True])
    orders = [np.array(order) for order in permutations(range(4))]
    areas = [risk_coverage_area(correct[order], np.ones(4, bool), -np.arange(4.0)) for order in orders]
    assert risk_coverage_area(correct, np.ones(4, bool), np.ones(4)) == pytest.approx(np.mean(areas))
    assert risk_coverage_area(correct, np.ones(4, bool), np.full(4, np.nan)) == pytest.approx(np.mean(areas))


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_the_risk_is_least_where_the_right_ones_are_surest(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    correct, answered = rng.random(n) < 0.5, rng.random(n) < 0.8
    correct &= answered
    confidence = rng.integers(0, 5, n).astype(float)
    area = risk_coverage_area(correct, answered, confidence)
    assert area == pytest.approx(risk_coverage_area(correct, answered, 100 * np.exp(confidence)), abs=1e-15)
    best = risk_coverage_area(correct, answered, correct.astype(float))
    worst = risk_coverage_area(correct, answered, -correct.astype(float))
    assert -1e-12 <= best - 1e-12 <= area <= worst + 1e-12 <= 1 + 2e-12
    # With w wrong ones last, the risk is 0 until they come.
    wrong = n - int(correct.sum())
    assert best == pytest.approx(sum((k - (n - wrong)) / k for k in range(n - wrong + 1, n + 1)) / n)


@given(st.integers(1, 30), st.integers(0, 2**32 - 1), st.sampled_from([0.5, 0.95, 0.99, 1.0]))
def test_coverage_at_a_precision_is_the_best_threshold(n: int, seed: int, precision: float) -> None:
    rng = np.random.default_rng(seed)
    correct, answered = rng.random(n) < 0.8, rng.random(n) < 0.8
    confidence = rng.integers(0, 5, n).astype(float)
    kept = [answered & (confidence >= threshold) for threshold in range(5)]
    shares = [keep.mean() for keep in kept if keep.any() and correct[keep].mean() >= precision]
    assert precision_recall(correct, answered, confidence).coverage_at(precision) == pytest.approx(
        max(shares, default=0)
    )


def test_coverage_at_a_precision_hand_values_in_the_summary() -> None:
    # The 20 surest of 41 pairs are right; then come a wrong one, 19 right ones and one without an answer. 39 of 40
    # answers are 97.5 %, and 99 % hold only until the wrong one comes.
    errors = np.full(41, 0.1)
    errors[20], errors[40] = 3.0, np.inf
    confidence = np.append(np.arange(40.0, 0, -1), np.nan)
    summary = summarize(errors_of(errors, np.where(np.isinf(errors), np.inf, 0.0)), confidence=confidence)
    assert summary["coverage_at_precision_95@(0.25m,2deg)"] == pytest.approx(40 / 41)
    assert summary["coverage_at_precision_99@(0.25m,2deg)"] == pytest.approx(20 / 41)
    assert summary["wrong_of_answered@(0.25m,2deg)"] == pytest.approx(1 / 40)


def test_confident_answers_are_those_of_one_half_or_more() -> None:
    errors = errors_of([0.1, 0.1, 3.0, 0.1, np.inf], [0.0, 0.0, 0.0, 0.0, np.inf])
    summary = summarize(errors, confidence=np.array([0.9, 0.5, 0.7, 0.49, 0.99]))
    assert summary["precision_at_confidence_50@(0.25m,2deg)"] == pytest.approx(2 / 3)
    assert summary["coverage_at_confidence_50"] == pytest.approx(3 / 5)
    none = summarize(errors, confidence=np.full(5, 0.4))
    assert none["precision_at_confidence_50@(0.25m,2deg)"] is None
    assert none["coverage_at_confidence_50"] == summarize(errors)["coverage_at_confidence_50"] == 0.0


def test_a_method_without_confidences_has_one_threshold() -> None:
    names = [f"coverage_at_precision_{percent}@(0.25m,2deg)" for percent in (95, 99)]
    right = summarize(errors_of([0.1, 0.1, np.inf], [0.0, 0.0, np.inf]))
    assert [right[name] for name in names] == pytest.approx([2 / 3, 2 / 3])
    some = summarize(errors_of([0.1, 0.3]))
    assert [some[name] for name in names] == [0.0, 0.0]
    assert some["aurc@(0.25m,2deg)"] == pytest.approx((0.5 + 0.5) / 2)


def test_a_method_that_answers_nothing_has_no_share_of_wrong_answers() -> None:
    summary = summarize(errors_of([np.inf, np.inf], [np.inf, np.inf]))
    assert summary["wrong_of_answered@(0.25m,2deg)"] is None
    assert summary["aurc@(0.25m,2deg)"] == 1.0
    assert summary["coverage_at_precision_95@(0.25m,2deg)"] == 0.0


def test_columns_of_another_length_are_refused() -> None:
    with pytest.raises(ValueError, match="confidence"):
        summarize(errors_of([0.1, 0.2]), confidence=np.ones(3))


def test_spread_over_seeds_is_mean_and_sample_deviation() -> None:
    spread = spread_over_seeds([0.4, 0.5, 0.6])
    assert spread.mean == pytest.approx(0.5)
    assert spread.standard_deviation == pytest.approx(0.1)
    assert spread_over_seeds([0.4]).standard_deviation is None
    infinite = spread_over_seeds([0.4, np.inf])
    assert (infinite.mean, infinite.standard_deviation) == (np.inf, None)


@pytest.mark.parametrize("bad", [[], [np.nan], [-1.0], [[0.0]]])
def test_areas_refuse_what_is_no_error(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="errors"):
        area_shares(bad, 1.0)

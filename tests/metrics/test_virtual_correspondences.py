"""The virtual correspondence reprojection error, and what is made of it over a pair set."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from relocbench.arrays import Array
from relocbench.geometry import Camera, make_transform, se3_exp, so3_exp
from relocbench.metrics import PairScores, PoseErrors, reprojection_errors, summarize_scores
from relocbench.metrics.pose.virtual_correspondences import virtual_points

PHONE = Camera("pinhole", 540, 720, 450.0, 450.0, 269.5, 359.5)
"""the size of the images of Map-free relocalization"""
WIDE = Camera("pinhole", 1200, 800, 500.0, 500.0, 599.5, 399.5)
twists = arrays(np.float64, (3, 6), elements=st.floats(-2, 2))


def shifted(x: float, y: float = 0.0, z: float = 0.0) -> Array:
    """(1, 4, 4) the true query camera's frame in that of an estimated one."""
    return make_transform(np.eye(3), [x, y, z])[None]


def test_the_grid_is_that_of_the_paper() -> None:
    points = virtual_points()
    assert points.shape == (4 * 7 * 7, 3)
    assert np.array_equal(points.min(axis=0).round(9), [-0.9, -0.45, 1.8])
    assert np.array_equal(points.max(axis=0).round(9), [0.9, 0.45, 3.6])


@pytest.mark.parametrize(
    ("rotation", "translation", "expected_px"),
    [
        ([0.02, -0.03, 0.01], [0.05, -0.1, 0.2], 26.77734561412478),
        ([0.0, 0.02, 0.0], [-0.06, 0.02, -0.1], 6.317243931954715),
        ([0.01, 0.0, 0.0], [0.0, 0.0, 0.0], 4.584392060070257),
    ],
)
def test_pixels_are_those_of_the_published_evaluation(
    rotation: list[float], translation: list[float], expected_px: float
) -> None:
    # Computed by the function of the authors' evaluation on these poses, with all points inside the image.
    truth = make_transform(so3_exp([0.3, -0.2, 0.1]), [1.0, 2.0, 3.0])[None]
    answer = make_transform(so3_exp(rotation), translation)[None] @ truth
    assert 900 * reprojection_errors(answer, truth, PHONE)[0] == pytest.approx(expected_px, rel=1e-9)
    assert np.hypot(*PHONE.size) == 900


def test_a_camera_put_aside_draws_points_off_by_its_focal_length_over_their_depth() -> None:
    depths = [1.8, 2.1, 2.4, 2.7, 3.0, 3.3, 3.6]
    expected = np.mean([500 * 0.1 / depth for depth in depths]) / np.hypot(1200, 800)
    assert reprojection_errors(shifted(0.1), np.eye(4)[None], WIDE)[0] == pytest.approx(expected, rel=1e-12)


def test_what_falls_outside_is_as_far_off_as_the_border_and_what_is_behind_as_the_diagonal() -> None:
    truth = np.eye(4)[None]
    u = 500 * virtual_points()[:, 0] / virtual_points()[:, 2] + 599.5
    far_right = np.mean(1199.5 - u) / np.hypot(1200, 800)
    assert reprojection_errors(shifted(1e4), truth, WIDE)[0] == pytest.approx(far_right, rel=1e-12)
    turned = make_transform(so3_exp([0.0, np.pi, 0.0]), np.zeros(3))[None]
    assert reprojection_errors(turned, truth, WIDE)[0] == 1.0
    # Four of seven layers of points lie behind a camera that stands 2.9 m too far ahead.
    assert reprojection_errors(shifted(0, 0, -2.9), truth, WIDE)[0] > 4 / 7


@given(twists, twists)
def test_it_depends_on_where_the_cameras_are_and_not_on_the_frame_of_reference(twist: Array, other: Array) -> None:
    answer, truth, moved = se3_exp(twist), se3_exp(twist[::-1] / 2), se3_exp(other)
    before = reprojection_errors(answer, truth, PHONE)
    assert np.all((before >= 0) & (before <= 1))
    np.testing.assert_allclose(reprojection_errors(answer @ moved, truth @ moved, PHONE), before, atol=1e-6)
    assert reprojection_errors(truth, truth, PHONE) == pytest.approx(0, abs=1e-9)


def test_it_grows_with_the_error_and_not_with_the_size_of_the_image() -> None:
    truth = np.tile(np.eye(4), (3, 1, 1))
    errors = reprojection_errors(np.concatenate([shifted(x) for x in (0.05, 0.1, 0.4)]), truth, WIDE)
    assert np.all(np.diff(errors) > 0)
    assert reprojection_errors(shifted(0.1), truth[:1], WIDE.scaled(2.0))[0] == pytest.approx(errors[1], rel=1e-9)
    distorted = Camera("radtan", *WIDE.size, WIDE.fx, WIDE.fy, WIDE.cx, WIDE.cy, (0.1, 0.01, 0.0, 0.0))
    assert reprojection_errors(shifted(0.1), truth[:1], distorted)[0] == errors[1]


def test_no_answer_is_infinitely_far_off() -> None:
    truth = np.tile(np.eye(4), (3, 1, 1))
    answers = np.stack([np.eye(4), np.full((4, 4), np.nan), np.eye(4)])
    assert reprojection_errors(answers, truth, WIDE, [True, True, False]).tolist() == [0.0, np.inf, np.inf]


def scores(vcre: list[float], confidence: list[float] | None = None) -> PairScores:
    error = np.where(np.isinf(vcre), np.inf, 0.0)
    given = None if confidence is None else np.array(confidence)
    return PairScores(PoseErrors(error, error, error), None, given, np.array(vcre))


def test_precision_and_area_by_hand() -> None:
    # Below 0.1 is one of four pairs. With the threshold on confidence at 3, 2 and 1 a quarter, a half and three
    # quarters of the pairs are kept, of which 1, 1/2 and 1/3 are right.
    summary = summarize_scores(scores([0.05, 0.1, 0.2, np.inf], [3.0, 2.0, 1.0, np.nan]))
    assert summary["vcre_precision@10%"] == 0.25
    assert summary["vcre_auc@10%"] == pytest.approx((1 + 1 / 2 + 1 / 3) / 4, rel=1e-12)
    assert summary["median_vcre"] == pytest.approx(0.15)
    # Without confidences there is one threshold, which keeps all three answers.
    assert summarize_scores(scores([0.05, 0.1, 0.2, np.inf]))["vcre_auc@10%"] == pytest.approx(0.25)


def test_without_cameras_nothing_is_said() -> None:
    for unknown in (scores([np.nan, 0.1]), PairScores(scores([0.0]).errors)):
        summary = summarize_scores(unknown)
        assert [summary[name] for name in ("median_vcre", "vcre_precision@10%", "vcre_auc@10%")] == [None] * 3

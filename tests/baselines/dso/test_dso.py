"""The DSO trackers keep the method contract: what they answer, and how they say that they cannot."""

from __future__ import annotations

import inspect
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from alignment_scene import CAMERA, motion, render, to_image
from answer_contract import fault_of
from refusals import refused

from baselines.alignment.shared.pyramid import Level, image_pyramid
from baselines.alignment.shared.starts import moved_along, small_rotations
from baselines.dso import Dso, DsoMultiStart
from baselines.dso.tracker import evidence_for
from relocbench.arrays import Array
from relocbench.errors import MethodError
from relocbench.geometry import Camera, compose, invert, rotation_angle
from relocbench.tracking import KeyframePoints, Query, Reference, SupportsPrepare, Tracker, TrackResult

MOTION = motion((0.25, -0.1, -0.4), (1.0, -2.0, 1.5))
GREY, DEPTH = render(np.eye(4))


def dense_reference(**changes: Any) -> Reference:
    values = {"image": to_image(GREY), "camera": CAMERA, "depth": DEPTH, **changes}
    return Reference(key="r", timestamp_ns=1, **values)


def sparse_points(count: int) -> KeyframePoints:
    rng = np.random.default_rng(0)
    uv = rng.uniform(10, [CAMERA.width - 10, CAMERA.height - 10], (count, 2))
    z = DEPTH[np.rint(uv[:, 1]).astype(int), np.rint(uv[:, 0]).astype(int)].astype(np.float64)
    return KeyframePoints(uv, 1 / z, np.full(count, 0.01))


def query(T: Array = MOTION, camera: Camera = CAMERA, gain: float = 1.0, offset: float = 0.0) -> Query:
    return Query("q", 2, to_image(render(T, camera)[0], gain, offset), camera)


def track(tracker: Dso, reference: Reference, asked: Query, prior: Array | None = None) -> TrackResult:
    return tracker.track(tracker.prepare(reference), asked, prior)


def assert_right(result: TrackResult, truth: Array = MOTION, metres: float = 0.01, degrees: float = 0.06) -> None:
    assert result.answered, result.message
    assert fault_of(result) is None
    assert result.T_query_ref is not None
    assert np.linalg.norm(invert(result.T_query_ref)[:3, 3] - invert(truth)[:3, 3]) < metres
    delta = compose(result.T_query_ref, invert(truth))
    assert np.rad2deg(rotation_angle(delta[:3, :3])) < degrees


@pytest.mark.parametrize("tracker_class", [Dso, DsoMultiStart])
def test_contract(tracker_class: type[Dso]) -> None:
    tracker = tracker_class()
    assert isinstance(tracker, Tracker)
    assert isinstance(tracker, SupportsPrepare)
    assert tracker_class.uses_prior is True
    parameters = list(inspect.signature(tracker_class).parameters.values())
    assert {p.name for p in parameters} >= {"points", "huber", "cutoff", "max_levels", "dso_failure_test", "seed"}
    assert all(p.annotation is not p.empty and p.default is not p.empty for p in parameters)


@pytest.mark.parametrize("tracker_class", [Dso, DsoMultiStart])
def test_a_dense_keyframe_is_aligned_from_the_identity(tracker_class: type[Dso]) -> None:
    result = track(tracker_class(), dense_reference(), query())
    assert_right(result)
    assert result.confidence is not None
    assert 0.9 < result.confidence <= 1
    assert result.info["correlation"] > 0.8
    assert result.info["dso_would_reject"] is False
    assert len(result.info["iterations"]) == len(result.info["levels"]) == 4
    assert result.info["saturated_share"] < 0.05
    assert abs(result.info["a"]) < 0.01


def test_a_sparse_keyframe_is_aligned_with_the_points_it_has() -> None:
    tracker = Dso(points=700)
    reference = dense_reference(depth=None, sparse_points=sparse_points(700))
    prepared = tracker.prepare(reference)
    assert prepared.selected == 700
    assert_right(tracker.track(prepared, query()), metres=0.03, degrees=0.2)


def test_colour_images_and_a_depth_with_holes() -> None:
    holes = DEPTH.copy()
    holes[::2] = 0
    holes[1::4] = np.nan
    colour = np.repeat(to_image(GREY)[..., None], 3, axis=2)
    reference = dense_reference(image=colour, depth=holes)
    tracker = Dso(points=800)
    assert_right(tracker.track(tracker.prepare(reference), query()))


def test_query_camera_may_differ_from_the_reference_camera() -> None:
    other = Camera("pinhole", 301, 233, 240.0, 235.0, 150.0, 110.0)
    assert_right(track(Dso(), dense_reference(), query(camera=other)))


def test_a_change_of_exposure_is_estimated() -> None:
    result = track(Dso(), dense_reference(), query(gain=0.75, offset=20))
    assert_right(result, metres=0.015, degrees=0.1)
    assert np.exp(result.info["a"]) == pytest.approx(0.75, abs=0.01)
    assert result.info["b"] == pytest.approx(20, abs=2)


def test_the_prior_is_the_start_and_never_the_answer() -> None:
    far = motion((1.5, -0.3, -2.5), (2, -14, 3))
    asked = query(far)
    near = motion((0.1, 0.05, -0.1), (0.5, 0.5, 0)) @ far
    tracker = Dso()
    prepared = tracker.prepare(dense_reference())
    assert_right(tracker.track(prepared, asked, near), far, metres=0.02, degrees=0.1)
    behind = motion((0, 0, -100), (0, 0, 0))
    lost = tracker.track(prepared, asked, behind)
    assert not lost.answered
    assert "no point falls into the query" in lost.message


def test_multi_start_bridges_a_rotation_that_one_start_does_not() -> None:
    turned = motion((0.05, 0, -0.05), (4, 0, 0))
    alone = Dso(max_levels=1)
    several = DsoMultiStart(max_levels=1)
    single, best = track(alone, dense_reference(), query(turned)), track(several, dense_reference(), query(turned))
    assert_right(best, turned)
    assert single.info["energy"] > 100 * best.info["energy"]


def test_a_start_ahead_bridges_a_distance_that_the_prior_does_not() -> None:
    ahead = motion((0, 0, -2), (0.3, 0, 0))
    single = track(Dso(max_levels=1), dense_reference(), query(ahead))
    for tracker in (Dso(max_levels=1, along=(-1.8, 1.8)), DsoMultiStart(max_levels=1, along=(1.8,))):
        best = track(tracker, dense_reference(), query(ahead))
        assert_right(best, ahead)
        assert single.info["energy"] > 100 * best.info["energy"]


def test_a_start_on_a_bend_bridges_a_turn_that_one_on_the_axis_does_not() -> None:
    """To the right by 20 degrees over 2 m, where the camera then stands 0.35 m to the right."""
    bent = moved_along(np.eye(4), [2.0], [np.deg2rad(20)])[0]
    straight = track(Dso(max_levels=1, along=(1.9,)), dense_reference(), query(bent))
    best = track(Dso(max_levels=1, along=(1.9,), turns_deg=(-18.0, 18.0)), dense_reference(), query(bent))
    assert_right(best, bent)
    assert straight.info["energy"] > 10 * best.info["energy"]


def test_the_small_rotations_are_the_26_of_dso() -> None:
    angles = np.rad2deg([rotation_angle(T[:3, :3]) for T in small_rotations()])
    counts = {round(float(a), 1): int(np.isclose(angles, a, atol=0.05).sum()) for a in angles}
    assert counts == {2.3: 6, 3.2: 12, 4.0: 8}
    assert len(np.unique(np.round([T[:3, :3] for T in small_rotations()], 9), axis=0)) == 26


def test_the_same_seed_gives_the_same_bytes_in_any_order() -> None:
    tracker = Dso(seed=3)
    first = track(tracker, dense_reference(), query())
    track(tracker, dense_reference(), query(np.eye(4)))
    again, fresh = track(tracker, dense_reference(), query()), track(Dso(seed=3), dense_reference(), query())
    assert first.T_query_ref is not None
    assert again.T_query_ref is not None
    assert fresh.T_query_ref is not None
    assert first.T_query_ref.tobytes() == again.T_query_ref.tobytes() == fresh.T_query_ref.tobytes()
    assert first.info == again.info == fresh.info


@pytest.mark.parametrize(
    "changes",
    [
        {"depth": None},
        {"depth": np.zeros_like(DEPTH)},
        {"depth": None, "sparse_points": sparse_points(12)},
        {"image": np.full_like(to_image(GREY), 77)},
    ],
)
def test_too_few_points_is_a_stated_failure(changes: dict[str, Any]) -> None:
    result = track(Dso(), dense_reference(**changes), query())
    assert not result.answered
    assert "at least 30 are needed" in result.message


def test_a_blank_query_is_a_stated_failure() -> None:
    blank = Query("q", 2, np.full_like(to_image(GREY), 128), CAMERA)
    for tracker in (Dso(), DsoMultiStart()):
        result = track(tracker, dense_reference(), blank)
        assert not result.answered
        assert "singular" in result.message


def test_hardly_any_overlap_is_a_stated_failure() -> None:
    aside = motion((0, 0, 0), (0, 58, 0))
    result = track(Dso(max_levels=1), dense_reference(), query(aside), aside)
    assert not result.answered
    assert "project into the query" in result.message


def test_keyframe_and_query_that_look_different_are_a_stated_failure() -> None:
    noise = np.random.default_rng(5).integers(0, 256, (CAMERA.height // 8, CAMERA.width // 8), dtype=np.uint8)
    elsewhere = Query("q", 2, np.ascontiguousarray(np.kron(noise, np.ones((8, 8), np.uint8))), CAMERA)
    tracker, lenient = Dso(affine=False, min_correlation=0.3), Dso(affine=False, min_correlation=-1.0)
    reference = dense_reference(image=to_image(GREY))
    refused = track(tracker, reference, elsewhere)
    assert not refused.answered
    assert re.fullmatch(
        r"keyframe and query have a correlation of -?0\.\d\d around the points, at least 0\.\d\d is needed",
        refused.message,
    )
    answered = track(lenient, reference, elsewhere)
    assert answered.confidence is not None
    assert answered.confidence < 0.1
    assert refused.info == answered.info


def test_evidence_does_not_depend_on_the_exposure_and_falls_with_the_error() -> None:
    prepared = Dso().prepare(dense_reference())
    level = image_pyramid(query().image, CAMERA, 1)[0]
    darker = image_pyramid(query(gain=0.5, offset=40).image, CAMERA, 1)[0]
    shifts = [motion((x, 0, 0), (0, 0, 0)) @ MOTION for x in (0.0, 0.2, 0.8)]
    found = [evidence_for(pose, prepared.levels[0], prepared.maps[0], level)[0] for pose in shifts]
    assert found[0] > found[1] + 0.05 > found[2] + 0.3
    assert found[0] == pytest.approx(evidence_for(MOTION, prepared.levels[0], prepared.maps[0], darker)[0], abs=0.03)


def test_points_out_of_view_count_as_points_that_look_different() -> None:
    prepared = Dso().prepare(dense_reference())
    level = prepared.maps[0]
    own, _ = evidence_for(np.eye(4), prepared.levels[0], level, level)
    assert own > 0.99
    half = replace(CAMERA, width=CAMERA.width // 2)
    part = Level(np.ascontiguousarray(level.map[:, : half.width]), half)
    share = np.mean(prepared.levels[0].uv[:, 0] < half.width)
    assert evidence_for(np.eye(4), prepared.levels[0], level, part)[0] == pytest.approx(share, abs=0.05)
    behind = motion((0, 0, -100), (0, 0, 0))
    assert evidence_for(behind, prepared.levels[0], level, level)[0] == 0.0


def test_dso_s_own_failure_test_is_recorded_and_off_unless_asked_for() -> None:
    faint = query(gain=0.15, offset=100)
    lenient = track(Dso(), dense_reference(), faint)
    strict = track(Dso(dso_failure_test=True), dense_reference(), faint)
    assert lenient.info["dso_would_reject"] is True
    assert lenient.info["a"] == pytest.approx(np.log(0.15), abs=0.2)
    assert lenient.answered
    assert not strict.answered
    assert "DSO's limits" in strict.message


def test_a_distorted_camera_is_the_users_mistake() -> None:
    fisheye = Camera("equidistant", CAMERA.width, CAMERA.height, 200, 200, 160, 128, (0.1, 0, 0, 0))
    with refused(MethodError, "", None, "pinhole"):
        Dso().prepare(dense_reference(camera=fisheye))
    with refused(MethodError, "", None, "pinhole"):
        Dso().track(Dso().prepare(dense_reference()), Query("q", 2, to_image(GREY), fisheye))

"""Coarse-to-fine alignment of feature maps on an analytic scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import plain_feature_alignment as plain
import pytest
from alignment_scene import CAMERA, motion
from feature_alignment_scene import features, keyframe_points, pyramid, world_points
from numpy.typing import NDArray
from refusals import refused

from baselines.alignment.direct.settings import Settings
from baselines.alignment.direct.solver import align
from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.alignment.features.reference import FeaturePoints, ReferenceFeatures
from baselines.alignment.features.settings import LM_RELOC_DAMPING, FeatureSettings
from baselines.alignment.features.solver import FeatureAlignment, align_features
from baselines.alignment.shared.damping import DSO_DAMPING, Damping
from baselines.alignment.shared.depth_map import LevelPoints
from baselines.alignment.shared.pyramid import level_camera
from baselines.alignment.shared.starts import Start
from relocbench.arrays import Array, Floats
from relocbench.errors import MethodError
from relocbench.geometry import Camera, apply, compose, invert, make_transform, rotation_angle, se3_exp, so3_exp

MOVED = (0.25, -0.1, -0.4, 1.0, -2.0, 1.5)
MOTION = motion(MOVED[:3], MOVED[3:])
IDENTITY, TRUTH = [Start(np.eye(4))], [Start(MOTION)]


@pytest.fixture(scope="module")
def reference() -> ReferenceFeatures:
    return ReferenceFeatures.at_points(keyframe_points(), pyramid())


@pytest.fixture(scope="module")
def query() -> FeaturePyramid:
    return pyramid(MOVED)


def error(T: Array, truth: Array = MOTION) -> tuple[float, float]:
    """Metres between camera centres, and degrees."""
    delta = compose(T, invert(truth))
    centre = invert(T)[:3, 3] - invert(truth)[:3, 3]
    return float(np.linalg.norm(centre)), float(np.rad2deg(rotation_angle(delta[:3, :3])))


def changed(features: FeaturePyramid, change: Callable[[Floats], Floats]) -> FeaturePyramid:
    return FeaturePyramid.from_maps([change(level.map.copy()) for level in features.levels], CAMERA)


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("damping", [DSO_DAMPING, LM_RELOC_DAMPING])
def test_the_pose_is_recovered_from_the_identity(
    reference: ReferenceFeatures, query: FeaturePyramid, per_channel: bool, damping: Damping
) -> None:
    found = align_features(reference, query, IDENTITY, FeatureSettings(per_channel=per_channel, damping=damping))
    metres, degrees = error(found.T_query_ref)
    assert not found.failure
    assert metres < 0.002
    assert degrees < 0.01
    assert [outcome.level for outcome in found.outcomes] == [3, 2, 1, 0]
    assert 0.5 < found.inlier_share <= 1
    assert found.energy == found.final.energy < 0.01


def test_the_same_input_gives_the_same_bytes(reference: ReferenceFeatures, query: FeaturePyramid) -> None:
    first, second = (align_features(reference, query, IDENTITY, FeatureSettings()) for _ in range(2))
    assert first.T_query_ref.tobytes() == second.T_query_ref.tobytes()
    assert first.H.tobytes() == second.H.tobytes()
    assert first.outcomes == second.outcomes


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("damping", [DSO_DAMPING, LM_RELOC_DAMPING])
def test_compiled_and_plain_take_the_same_path(
    reference: ReferenceFeatures, query: FeaturePyramid, per_channel: bool, damping: Damping
) -> None:
    settings = FeatureSettings(per_channel=per_channel, damping=damping, cutoff_levels=4)
    fast = align_features(reference, query, IDENTITY, settings)
    T, iterations = plain.align(reference, query, np.eye(4), settings)
    np.testing.assert_allclose(fast.T_query_ref, T, atol=1e-4)
    assert abs(sum(iterations) - sum(outcome.iterations for outcome in fast.outcomes)) <= 3

    # Two steps a level end far from where both converge to: every step must be the same.
    short = FeatureSettings(per_channel=per_channel, damping=damping, cutoff_levels=4, iterations=(2,))
    fast = align_features(reference, query, IDENTITY, short)
    T, iterations = plain.align(reference, query, np.eye(4), short)
    np.testing.assert_allclose(fast.T_query_ref, T, atol=1e-6)
    assert iterations == [outcome.iterations for outcome in fast.outcomes]


def test_one_channel_is_the_intensity_aligner_without_brightness() -> None:
    maps, reference = pyramid(MOVED, channels=1), ReferenceFeatures.at_points(keyframe_points(), pyramid(channels=1))
    points = [
        LevelPoints(level.points, level.values, np.zeros((len(level), 2), np.int32)) for level in reference.levels
    ]
    for cutoff_levels in (1, 4):
        ours = align_features(
            reference,
            maps,
            IDENTITY,
            FeatureSettings(huber=0.3, cutoff=1.0, unit="absolute", cutoff_levels=cutoff_levels),
        )
        intensity = Settings(huber=0.3, cutoff=1.0, cutoff_levels=cutoff_levels, affine=False)
        theirs = align(points, maps.with_gradients(), np.eye(4), intensity)
        np.testing.assert_allclose(ours.T_query_ref, theirs.T_query_ref, atol=1e-4)
        assert [o.level for o in ours.outcomes] == [o.level for o in theirs.outcomes]
        assert ours.energy == pytest.approx(theirs.final.energy, rel=1e-3)
        assert abs(ours.final.saturated - theirs.final.saturated) <= 1


def _found_with(change: Callable[[Floats], Floats], settings: FeatureSettings) -> Array:
    """The pose with the features of both sides changed alike."""
    reference = ReferenceFeatures.at_points(keyframe_points(), changed(pyramid(), change))
    return align_features(reference, changed(pyramid(MOVED), change), IDENTITY, settings).T_query_ref


def test_the_scale_of_features_does_not_matter_in_units_of_their_spread() -> None:
    settings = FeatureSettings(cutoff_levels=4)
    as_is = _found_with(lambda m: m, settings)
    # A power of two: nothing is rounded otherwise.
    np.testing.assert_allclose(_found_with(lambda m: m * np.float32(64), settings), as_is, atol=1e-6)
    np.testing.assert_allclose(_found_with(lambda m: m / np.float32(7) + np.float32(2), settings), as_is, atol=1e-4)


def test_rotating_the_channels_into_each_other_does_not_matter_to_the_norm() -> None:
    R = np.linalg.qr(np.random.default_rng(0).normal(size=(8, 8)))[0].astype(np.float32)
    settings = FeatureSettings(unit="absolute", huber=0.1, cutoff=0.5)
    as_is, turned = _found_with(lambda m: m, settings), _found_with(lambda m: m @ R, settings)
    np.testing.assert_allclose(turned, as_is, atol=1e-4)


def test_the_cutoff_keeps_what_shows_something_else_out(reference: ReferenceFeatures, query: FeaturePyramid) -> None:
    def hide(values: Floats) -> Floats:
        height, width = values.shape[:2]
        elsewhere = (slice(height // 8, height * 5 // 8), slice(width // 8, width // 2))
        values[elsewhere] = np.roll(values[elsewhere], 1, axis=2)  # as smooth, unrelated channel by channel
        return values

    spoilt = changed(query, hide)
    with_cutoff = align_features(reference, spoilt, TRUTH, FeatureSettings(huber=0.1, cutoff=0.3))
    without = align_features(reference, spoilt, TRUTH, FeatureSettings(huber=100, cutoff=100))
    assert error(with_cutoff.T_query_ref)[0] < 0.01
    assert error(without.T_query_ref)[0] > 3 * error(with_cutoff.T_query_ref)[0]
    assert with_cutoff.final.saturated > 0.05 * with_cutoff.points
    assert with_cutoff.inlier_share < without.inlier_share - 0.05


def test_points_of_small_weight_have_little_say(query: FeaturePyramid) -> None:
    points = keyframe_points()
    wrong = np.arange(len(points)) % 3 == 0
    depth = np.where(wrong, 3.0, 1.0) * points.inverse_depth
    parts = [
        ReferenceFeatures.at_points(type(points)(points.uv[some], depth[some], points.sigma[some]), pyramid()).levels
        for some in (wrong, ~wrong)
    ]
    settings = FeatureSettings(huber=100, cutoff=100)  # nothing but the weights to help

    def found(of_wrong: float) -> float:
        levels = [
            FeaturePoints(
                np.hstack([a.points, b.points]),
                np.vstack([a.values, b.values]),
                np.concatenate([np.float32(of_wrong) * a.weights, b.weights]),
            )
            for a, b in zip(*parts, strict=True)
        ]
        return error(align_features(ReferenceFeatures(tuple(levels)), query, TRUTH, settings).T_query_ref)[0]

    assert found(1e-4) < 0.005
    assert found(1.0) > 0.05


def test_the_cutoff_is_doubled_while_most_residuals_are_saturated(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    found = align_features(reference, query, IDENTITY, FeatureSettings(huber=0.02, cutoff=0.05, cutoff_levels=4))
    assert max(outcome.cutoff_factor for outcome in found.outcomes) > 1
    levels = [outcome.level for outcome in found.outcomes]
    assert levels[0] == levels[1]  # the level is repeated once with the base cutoff
    assert sorted(set(levels), reverse=True) == [3, 2, 1, 0]


def test_the_lowest_final_energy_wins_among_starts(reference: ReferenceFeatures, query: FeaturePyramid) -> None:
    far = motion((3, 2, 0), (20, 30, 20))
    settings = FeatureSettings()
    lost = align_features(reference, query, [Start(far)], settings)
    assert error(lost.T_query_ref)[0] > 1
    for starts in ([Start(far), Start(MOTION)], [Start(MOTION), Start(far)], [Start(far), Start(MOTION, 1)]):
        assert error(align_features(reference, query, starts, settings).T_query_ref)[0] < 0.002
    with pytest.raises(ValueError, match="start"):
        align_features(reference, query, [], settings)


def test_a_start_is_given_up_where_its_root_mean_energy_exceeds_the_best_ones_by_the_factor(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    far = motion((3, 2, 0), (20, 30, 20))
    right, lost = (align_features(reference, query, [Start(start)], FeatureSettings()) for start in (MOTION, far))
    best = {outcome.level: outcome.energy for outcome in right.outcomes}
    ratio = next((each.energy / best[each.level]) ** 0.5 for each in lost.outcomes)
    assert ratio > 1.1
    for starts in ([Start(far), Start(MOTION)], [Start(MOTION), Start(far)]):
        for factor, on_the_second in ((0.99 * ratio, 1), (1000 * ratio, 2)):
            found = align_features(reference, query, starts, FeatureSettings(give_up=factor))
            assert found.starts[-2:] == (on_the_second, 2)
            assert np.array_equal(found.T_query_ref, right.T_query_ref)


def test_only_the_best_of_several_starts_are_kept_after_a_level(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    """Starts too far off to come to the same place; a start on a finer level joins those that are left."""
    aside = [Start(motion((metres, 0, 0), (0, 0, 0))) for metres in (6, -6, 9, -9)]
    starts = [*aside, Start(MOTION), Start(MOTION, 1)]
    usual = FeatureSettings(give_up=1e6, min_valid_share=0.0)
    assert align_features(reference, query, starts, usual).starts[3] == 5
    found = align_features(reference, query, starts, replace(usual, kept=(5, 2, 2, 3)))
    assert found.starts[1:] == (3, 3, 5)
    assert error(found.T_query_ref)[0] < 0.002
    finest = align_features(
        reference, query, [Start(MOTION), Start(aside[0].T_query_ref, 0)], replace(usual, kept=(1,))
    )
    assert finest.starts[0] == len(finest.reached) == 2
    assert error(finest.reached[0])[0] < 0.002 < error(finest.reached[1])[0]


def test_a_start_of_which_next_to_nothing_is_in_view_has_failed(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    """The mean energy of the few residuals that are left may be the lowest one."""
    away = Start(motion((0, 0, 0), (0, 58, 0)), 0)
    lenient, strict = FeatureSettings(min_valid_share=0.0, give_up=1e6), FeatureSettings(give_up=1e6)
    alone = align_features(reference, query, [away], lenient)
    assert not alone.failure
    assert 0 < alone.final.valid < 0.1 * alone.residuals
    declined = align_features(reference, query, [away], strict)
    assert declined.failure == (
        f"only {alone.final.valid} of {alone.residuals} residuals project into the query on level 0"
    )
    assert error(align_features(reference, query, [away, Start(MOTION)], strict).T_query_ref)[0] < 0.002


def test_of_starts_that_come_to_the_same_pose_one_is_kept(reference: ReferenceFeatures, query: FeaturePyramid) -> None:
    starts = [Start(MOTION), Start(np.eye(4)), Start(MOTION, 2)]
    found = align_features(reference, query, starts, FeatureSettings())
    assert found.starts == (1, 1, 2, 2)


def test_a_start_on_a_finer_level_leaves_the_coarser_ones_out(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    found = align_features(reference, query, [Start(MOTION, 1)], FeatureSettings())
    assert [outcome.level for outcome in found.outcomes] == [1, 0]
    assert error(found.T_query_ref)[0] < 0.002
    deepest = align_features(reference, query, [Start(MOTION, 99)], FeatureSettings())
    assert deepest.outcomes[0].level == len(query) - 1


def test_starts_near_the_best_poses_reach_what_these_do_not(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    """One step from 2.5 m off; a tenth of the median depth of 9 m leads back to where the second step reaches."""
    beside = [Start(make_transform(np.eye(3), [2.5, 0.0, 0.0]) @ MOTION, 1)]
    settings = FeatureSettings(iterations=(50, 1))
    assert error(align_features(reference, query, beside, settings).T_query_ref)[0] > 1
    found = align_features(reference, query, beside, replace(settings, nearby=(0.1, 0.2)))
    assert found.starts[1] == 1 + 2 * 6
    assert error(found.T_query_ref)[0] < 0.002


def test_the_lead_compares_the_misfit_with_that_of_the_best_other_pose(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    lenient = FeatureSettings(give_up=1e6, min_valid_share=0.0)
    starts = [Start(motion((metres, 0, 0), (0, 0, 0)), 0) for metres in (6, -6)]
    first, second = sorted((align_features(reference, query, [s], lenient) for s in starts), key=lambda a: a.misfit)
    assert first.lead == second.lead == 1.0
    both = align_features(reference, query, starts, lenient)
    assert both.misfit == first.misfit
    assert both.lead == pytest.approx(min(np.log(second.misfit / first.misfit), 1.0))
    assert 0 < both.lead < 1
    same = align_features(reference, query, [starts[0], starts[0]], lenient)
    assert same.lead == 1.0


def test_poses_that_cannot_be_compared_on_the_second_level_have_no_lead(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    finest, *coarser = (level.map.copy() for level in query.levels)
    blind = FeaturePyramid.from_maps([finest, *(np.full_like(level, np.nan) for level in coarser)], CAMERA)
    starts = [Start(motion((metres, 0, 0), (0, 0, 0)), 0) for metres in (6, -6)]
    found = align_features(reference, blind, starts, FeatureSettings(give_up=1e6, min_valid_share=0.0))
    assert not found.failure
    assert (found.misfit, found.lead) == (np.inf, 0.0)


def _starts(metres: float, degrees: float, count: int = 12) -> list[Array]:
    """Starts off the truth by so much, in seeded directions."""
    rng = np.random.default_rng(int(100 * metres))
    out = []
    for direction, axis in rng.normal(size=(count, 2, 3)):
        turn = so3_exp(np.deg2rad(degrees) * axis / np.linalg.norm(axis))
        out.append(make_transform(turn, metres * direction / np.linalg.norm(direction)) @ MOTION)
    return out


def test_every_start_within_a_radius_converges_and_levels_widen_it(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    finest = ReferenceFeatures(reference.levels[:1])

    def share(of: ReferenceFeatures, metres: float, degrees: float) -> float:
        starts = ([Start(T)] for T in _starts(metres, degrees))
        found = [align_features(of, query, one, FeatureSettings()).T_query_ref for one in starts]
        return float(np.mean([error(T)[0] < 0.01 for T in found]))

    distances = (0.05, 0.5, 1.5, 3.0)
    all_levels, finest_only = ([share(of, metres, 4 * metres) for metres in distances] for of in (reference, finest))
    assert all_levels == [1.0, 1.0, 1.0, 1.0]
    assert finest_only[:2] == [1.0, 1.0]
    assert finest_only == sorted(finest_only, reverse=True)
    assert finest_only[2] < 0.8
    assert finest_only[3] < 0.4


def test_covariance_tells_how_far_independent_noise_moves_the_pose(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    """The squared Mahalanobis distance of six unknowns has mean 6 and variance 12.

    The precision is that of the translation: its root mean square, with three unknowns, is known to 5 % by 150 draws.
    """
    draws = 150
    rng = np.random.default_rng(4)
    settings = FeatureSettings(huber=100, cutoff=100, unit="absolute", damping=Damping(smallest_step=1e-6))
    level = reference.levels[0]
    # A point that crosses the border makes the mean energy jump and can hold the pose; take those well inside.
    x, y, inverse_depth = level.points.astype(np.float64)
    pixels = CAMERA.project(apply(MOTION, (np.stack([x, y, np.ones_like(x)]) / inverse_depth).T))[0]
    inside = np.all((pixels > 12) & (pixels < np.array(CAMERA.size) - 13), axis=1)
    points, values, weights = np.ascontiguousarray(level.points[:, inside]), level.values[inside], level.weights[inside]

    def found_with(noise: NDArray[np.floating]) -> FeatureAlignment:
        noisy = FeaturePoints(points, values + noise.astype(np.float32), weights)
        return align_features(ReferenceFeatures((noisy,)), query, TRUTH, settings)

    T_exact = found_with(np.zeros_like(values)).T_query_ref
    distances, squares, sigmas = [], [], []
    for _ in range(draws):
        found = found_with(0.1 * rng.standard_normal(values.shape))
        assert np.sqrt(found.variance) == pytest.approx(0.1, rel=0.1)
        delta = compose(found.T_query_ref, invert(T_exact))
        twist = np.concatenate([delta[:3, 3], [delta[2, 1], delta[0, 2], delta[1, 0]]])
        np.testing.assert_allclose(se3_exp(twist), delta, atol=1e-4)  # small enough to be read off like this
        distances.append(twist @ np.linalg.solve(found.covariance, twist))
        squares.append(twist[:3] @ twist[:3])
        sigmas.append(np.exp(-found.precision))
    assert np.mean(distances) == pytest.approx(6, abs=3 * np.sqrt(12 / draws))
    assert np.mean(sigmas) == pytest.approx(np.sqrt(np.mean(squares)), rel=0.2)


def test_no_points_are_a_stated_trouble(query: FeaturePyramid) -> None:
    nothing = type(keyframe_points())(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    found = align_features(ReferenceFeatures.at_points(nothing, pyramid()), query, IDENTITY, FeatureSettings())
    assert found.failure == "the reference has 0 points, at least 8 are needed"
    assert (found.inlier_share, found.energy) == (0.0, np.inf)
    assert np.isnan(found.covariance).all()
    assert found.precision == -np.log(100.0)


@pytest.mark.parametrize("flat", [0.0, np.nan, -1e-9])
def test_a_translation_that_nothing_holds_has_the_lowest_precision(flat: float) -> None:
    """Normal equations whose smallest eigenvalue is zero, not a number or, by rounding, below zero."""
    H = np.diag([1e4, 1e4, flat, 1e4, 1e4, 1e4])
    found = FeatureAlignment(np.eye(4), (), 30, 30, H, variance=1.0)
    assert found.precision == -np.log(100.0)


def test_a_start_that_sees_nothing_is_a_stated_trouble(reference: ReferenceFeatures, query: FeaturePyramid) -> None:
    found = align_features(reference, query, [Start(motion((0, 0, -100), (0, 0, 0)))], FeatureSettings())
    assert found.failure == "no point falls into the query on level 3"
    assert found.inlier_share == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("level", [0, 3])
def test_features_that_are_not_finite_are_a_stated_trouble(
    reference: ReferenceFeatures, query: FeaturePyramid, bad: float, level: int
) -> None:
    maps = [part.map.copy() for part in query.levels]
    maps[level][..., 2] = bad
    found = align_features(reference, FeaturePyramid.from_maps(maps, CAMERA), IDENTITY, FeatureSettings())
    assert "features are not finite at" in found.failure
    assert f"on level {level}" in found.failure

    levels = list(reference.levels)
    values = levels[level].values.copy()
    values[5] = bad
    levels[level] = FeaturePoints(levels[level].points, values, levels[level].weights)
    for unit in ("absolute", "spread"):
        found = align_features(ReferenceFeatures(tuple(levels)), query, TRUTH, FeatureSettings(unit=unit))
        assert "not finite" in found.failure
        assert f"on level {level}" in found.failure


def test_features_that_are_all_the_same_are_a_stated_trouble(
    reference: ReferenceFeatures, query: FeaturePyramid
) -> None:
    blank = changed(query, np.ones_like)
    same = ReferenceFeatures.at_points(keyframe_points(), blank)
    assert "singular" in align_features(reference, blank, IDENTITY, FeatureSettings()).failure
    assert "all the same" in align_features(same, query, IDENTITY, FeatureSettings()).failure


def test_a_start_that_is_not_finite_is_a_stated_trouble(reference: ReferenceFeatures, query: FeaturePyramid) -> None:
    assert (
        align_features(reference, query, [Start(np.full((4, 4), np.nan))], FeatureSettings()).failure
        == "the start is not finite"
    )


def test_a_coarse_level_with_too_few_points_is_left_out(query: FeaturePyramid) -> None:
    points = keyframe_points()
    # Near the left border: level 3 keeps none of them.
    near = points.uv[:, 0] < 18
    few = type(points)(points.uv[near], points.inverse_depth[near], points.sigma[near])
    reference = ReferenceFeatures.at_points(few, pyramid())
    sizes = [len(level) for level in reference.levels]
    assert sizes[3] < 8 <= sizes[1]
    found = align_features(reference, query, TRUTH, FeatureSettings())
    assert max(outcome.level for outcome in found.outcomes) < 3


def test_different_channels_are_refused(query: FeaturePyramid) -> None:
    reference = ReferenceFeatures.at_points(keyframe_points(), pyramid(channels=1))
    with refused(MethodError, "", None, 1, 8):
        align_features(reference, query, IDENTITY, FeatureSettings())
    with refused(MethodError):
        align_features(ReferenceFeatures(()), query, IDENTITY, FeatureSettings())


@pytest.mark.parametrize("changed", [{"huber": 2, "cutoff": 1}, {"huber": 0}])
def test_thresholds_that_make_no_sense_are_refused(changed: dict[str, float]) -> None:
    with refused(MethodError, "", None, "cutoff"):
        FeatureSettings(**changed)  # type: ignore[arg-type]


def test_a_query_may_be_of_another_camera(reference: ReferenceFeatures) -> None:
    """Size and focal length of the query differ from the reference's."""
    other = Camera("pinhole", 300, 200, 220.0, 215.0, 150.0, 98.0)
    cameras = [level_camera(other, level) for level in range(4)]
    maps = [features(world_points(MOTION, camera), level) for level, camera in enumerate(cameras)]
    found = align_features(reference, FeaturePyramid.from_maps(maps, other), IDENTITY, FeatureSettings())
    assert error(found.T_query_ref)[0] < 0.003

"""GN-Net as a tracker: the answer depends on what stands before the camera, failures are said in words."""

from __future__ import annotations

import tomllib
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from answer_contract import fault_of
from refusals import refused
from repository import ROOT
from small_dataset import WITHIN, make_small_dataset, render, small_camera, small_pose

from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.alignment.features.solver import FeatureAlignment, align_features
from baselines.alignment.shared.pyramid import level_camera
from baselines.alignment.shared.starts import Start, moved_along
from baselines.gn_net.method import ALONG
from baselines.gn_net.network import FeatureNet
from baselines.gn_net.options import NetworkOptions
from baselines.gn_net.start import MatchedLandmarks, find_landmarks
from baselines.gn_net.tracker import ONE_START, GnNet, GnNetContrastive, GnNetFromPrior, GnNetPnp, LmNet
from baselines.gn_net.weights import save_weights
from relocbench.arrays import Array, Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import MethodError
from relocbench.geometry import Camera, make_transform, rotation_angle, so3_exp
from relocbench.methods import parse_method
from relocbench.tracking import KeyframePoints, Query, Reference, SupportsMatching, SupportsPrepare, TrackResult

SMALL = NetworkOptions(widths=(8, 12, 16), dim=8, levels=3)


@pytest.fixture(scope="module", params=[0, 1], ids=["full", "half"])
def weights(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of a network that learnt nothing, whose finest map has all or half the image's resolution.

    Random filters see texture all the same.
    """
    net = FeatureNet(replace(SMALL, finest=request.param))
    with torch.no_grad():
        for seed in range(3):
            net(torch.rand((2, 3, 48, 64), generator=torch.Generator().manual_seed(seed)))
    path = tmp_path_factory.mktemp("weights") / "random.safetensors"
    save_weights(path, net, {})
    return path


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "d", size=(192, 144))


def a_reference(size: tuple[int, int] = (192, 144)) -> Reference:
    camera = small_camera(*size)
    image, depth = render(camera, small_pose(0))
    return Reference(key="r", timestamp_ns=1, image=image, camera=camera, depth=depth)


def a_query(T_world_cam: np.ndarray, size: tuple[int, int] = (192, 144)) -> Query:
    camera = small_camera(*size)
    return Query(key="q", timestamp_ns=2, image=render(camera, T_world_cam)[0], camera=camera)


@pytest.mark.thorough
def test_the_tracker_finds_small_motions(weights: Path, dataset: Dataset) -> None:
    tracker = GnNet(weights=weights)
    assert isinstance(tracker, SupportsPrepare)
    pair_set = dataset.pair_set(WITHIN)
    for pair in pair_set.pairs[:3]:
        found = tracker.track(tracker.prepare(dataset.reference(pair_set, pair)), dataset.query(pair_set, pair))
        assert fault_of(found) is None
        assert found.T_query_ref is not None
        assert pair.T_query_ref is not None
        off = np.linalg.inv(found.T_query_ref) @ pair.T_query_ref
        assert np.linalg.norm(off[:3, 3]) < 0.03 < np.linalg.norm(pair.T_query_ref[:3, 3])
        assert np.degrees(rotation_angle(off[:3, :3])) < 0.3
        assert found.confidence is not None
        assert 0 < found.confidence <= 1


@pytest.mark.thorough
def test_another_place_is_answered_with_less_confidence(weights: Path, dataset: Dataset) -> None:
    """Confidence must compare between queries and keyframes; turned upside down, a query shows none of the keyframe."""
    tracker = GnNet(weights=weights, min_agreement=0.0, most_rival=None)
    pair_set = dataset.pair_set(WITHIN)
    pair = pair_set.pairs[0]
    reference, query = tracker.prepare(dataset.reference(pair_set, pair)), dataset.query(pair_set, pair)
    right = tracker.track(reference, query)
    other = tracker.track(reference, replace(query, image=np.ascontiguousarray(query.image[::-1])))
    assert right.confidence is not None
    assert other.confidence is not None
    assert other.confidence < 0.5 * right.confidence


def test_one_prepared_reference_serves_all_queries_and_the_network_sees_it_once(
    weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker = GnNet(weights=weights)
    seen = []
    features = tracker.features

    def counted(image: Image, camera: Camera) -> FeaturePyramid:
        seen.append(image.shape)
        return features(image, camera)

    monkeypatch.setattr(tracker, "features", counted)
    reference = tracker.prepare(a_reference())
    for frame in (0, 1, 1):
        tracker.track(reference, a_query(small_pose(frame)))
    assert len(seen) == 4
    query = a_query(small_pose(1))
    for prior in (None, np.eye(4)):
        tracker.track(reference, query, prior)
    assert len(seen) == 5


def test_the_prior_is_where_the_alignment_starts(weights: Path) -> None:
    tracker = GnNet(weights=weights)
    assert tracker.uses_prior
    reference = tracker.prepare(a_reference())
    prior = make_transform(so3_exp([0.0, 0.01, 0.0]), [0.02, 0.0, 0.0])
    found = tracker.track(reference, a_query(small_pose(0)), prior)
    assert found.T_query_ref is not None
    assert np.abs(found.T_query_ref - np.eye(4)).max() < 1e-3


def test_from_a_prior_coarse_levels_can_be_left_out(weights: Path) -> None:
    reference_and_query = a_reference(), a_query(small_pose(1))
    prior = make_transform(so3_exp([0.0, 0.01, 0.0]), [0.02, 0.0, 0.0])
    levels = {}
    for prior_level in (None, 1, 0):
        tracker = GnNetFromPrior(
            weights=weights, prior_level=prior_level, first_levels=1, along=(), kept=(), nearby=(), min_agreement=0.0
        )
        reference = tracker.prepare(reference_and_query[0])
        for given in (None, prior):
            info = tracker.track(reference, reference_and_query[1], given).info
            levels[prior_level, given is None] = info["levels"]
    assert levels[None, False] == levels[None, True] == levels[0, True] == levels[1, True] == [2, 1, 0]
    assert levels[1, False] == [1, 0]
    assert levels[0, False] == [0]


def test_halved_images_give_coarser_levels(weights: Path) -> None:
    image, camera = a_reference((193, 144)).image, small_camera(193, 144)
    plain, halved = GnNet(weights=weights), GnNet(weights=weights, halvings=1)
    half = image[:, :192].reshape(72, 2, 96, 2, -1).astype(np.float32).mean((1, 3)) / 255
    coarsest = plain.net(torch.from_numpy(half).permute(2, 0, 1)[None])[-1][0].permute(1, 2, 0)
    before, after = plain.features(image, camera).levels, halved.features(image, camera).levels
    assert len(after) == len(before) + 1
    for one, other in zip(before, after, strict=False):
        np.testing.assert_array_equal(one.map, other.map)
    np.testing.assert_allclose(after[-1].map, coarsest, atol=1e-5)
    assert after[-1].camera == level_camera(before[0].camera, len(before))
    assert len(GnNet(weights=weights, halvings=99).features(image, camera).levels) < 9


def test_remembered_maps_are_those_that_the_network_finds(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    forgetful, tracker = (GnNetFromPrior(weights=weights, cache_size=most, min_agreement=0.0) for most in (0, 2))
    passed, through = [], tracker.net.with_confidences

    def counted(x: torch.Tensor) -> Any:
        passed.append(x)
        return through(x)

    monkeypatch.setattr(tracker.net, "with_confidences", counted)
    pair = a_reference(), a_query(small_pose(3))
    expected = forgetful.track(forgetful.prepare(pair[0]), pair[1])
    for _ in range(2):
        found = tracker.track(tracker.prepare(pair[0]), pair[1])
        assert len(passed) == 2
        assert found.T_query_ref is not None
        assert expected.T_query_ref is not None
        np.testing.assert_array_equal(found.T_query_ref, expected.T_query_ref)
        assert found.info == expected.info


def test_of_several_first_levels_the_lowest_energy_wins(weights: Path) -> None:
    pair, found = (a_reference(), a_query(small_pose(3))), {}
    for first_levels in (1, 2, 3, 9):
        tracker = GnNetFromPrior(weights=weights, first_levels=first_levels, along=(), kept=(), min_agreement=0.0)
        found[first_levels] = tracker.track(tracker.prepare(pair[0]), pair[1]).info
    alone = [
        GnNetFromPrior(weights=weights, prior_level=level, first_levels=1, min_agreement=0.0).track(
            tracker.prepare(pair[0]), pair[1], np.eye(4)
        )
        for level in (2, 1, 0)
    ]
    for count, info in found.items():
        # Starts that come to the same pose go on as one.
        assert info["energy"] == pytest.approx(min(one.info["energy"] for one in alone[:count]), rel=1e-3)
    assert found[9] == found[3]


def test_of_several_positions_along_the_road_the_lowest_energy_wins(weights: Path) -> None:
    pair, metres, turns = (a_reference(), a_query(small_pose(3))), (-0.3, 0.2, 0.4), (0.0, 5.0)
    plain: dict[str, Any] = {"weights": weights, "first_levels": 2, "kept": (), "min_agreement": 0.0}
    along = GnNetFromPrior(along=metres, turns_deg=turns, **plain)
    info = along.track(along.prepare(pair[0]), pair[1]).info
    single = GnNetFromPrior(along=(), **plain)
    reference = single.prepare(pair[0])
    priors = [np.eye(4), *moved_along(np.eye(4), metres, np.deg2rad(turns).tolist())]
    alone = [single.track(reference, pair[1], prior).info["energy"] for prior in priors]
    assert info["energy"] == pytest.approx(min(alone), rel=1e-2)  # those that come to the same pose go on as one


def test_each_hypothesis_is_searched_for_with_other_samples(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth, asked = small_pose(1), []

    def pose(_: MatchedLandmarks, seed: int, best_first: bool = False) -> Array | None:
        asked.append((seed, best_first))
        return (None, make_transform(np.eye(3), [1.0, 0.0, 0.0]), truth)[seed - 7]

    monkeypatch.setattr(MatchedLandmarks, "pose", pose)
    tracker = GnNet(weights=weights, landmarks=50, hypotheses=3, min_agreement=0.0, seed=7)
    reference = tracker.prepare(a_reference())
    assert len(reference.landmarks) == 50
    found = tracker.track(reference, a_query(truth))
    assert asked == [(7, False), (8, True), (9, False)]
    monkeypatch.setattr(MatchedLandmarks, "pose", lambda *_, **__: truth)
    usual = GnNet(weights=weights, landmarks=50, min_agreement=0.0, seed=7)
    expected = usual.track(reference, a_query(truth))
    assert found.info["energy"] <= expected.info["energy"]


def test_poses_of_matches_start_on_a_coarse_level_and_on_the_finest(
    weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    matched = make_transform(np.eye(3), [0.0, 0.0, -0.15])
    given: list[tuple[int | None, bool]] = []

    def aligned(*asked: Any) -> FeatureAlignment:
        given.extend((start.level, start.T_query_ref is matched) for start in asked[2])
        return align_features(*asked)

    monkeypatch.setattr("baselines.gn_net.method.align_features", aligned)
    monkeypatch.setattr(MatchedLandmarks, "pose", lambda *_, **__: matched)
    tracker = GnNet(weights=weights, hypotheses=1, along=(), first_levels=1)
    tracker.track(tracker.prepare(a_reference()), a_query(small_pose(1)))
    assert given == [(tracker.start.level, True), (0, True), (2, False)]


def test_confidences_of_the_network_weigh_the_keyframes_points(tmp_path: Path) -> None:
    net, path = FeatureNet(replace(SMALL, confidence=True)).eval(), tmp_path / "confident.safetensors"
    with torch.no_grad():
        for head in net.confidences:
            head.weight.normal_(generator=torch.Generator().manual_seed(0))  # type: ignore[operator]
    save_weights(path, net, {})
    prepared = GnNet(weights=path).prepare(a_reference())
    for points, level in zip(prepared.features.levels, prepared.pyramid.levels, strict=True):
        assert level.confidence is not None
        assert np.ptp(points.weights) > 0.01
        assert level.confidence.min() <= points.weights.min() <= points.weights.max() <= level.confidence.max()


def test_single_pixels_are_found_again(weights: Path) -> None:
    tracker = GnNet(weights=weights)
    assert isinstance(tracker, SupportsMatching)
    reference = tracker.prepare(a_reference())
    uv = np.random.default_rng(0).uniform(40, (150, 100), (100, 2))
    ends = tracker.match(reference, a_query(small_pose(0)), uv, uv + 0.7)
    assert np.median(np.linalg.norm(ends - uv, axis=1)) < 0.01


def test_single_pixels_are_found_again_on_each_level(weights: Path) -> None:
    tracker = GnNet(weights=weights)
    reference = tracker.prepare(a_reference())
    uv = np.random.default_rng(1).uniform(40, (150, 100), (100, 2))
    by_level = tracker.match_levels(reference, a_query(small_pose(0)), uv, uv + 0.3)
    finest = tracker.net.options.finest
    assert len(by_level) == finest + tracker.net.options.levels
    assert all(ends.shape == uv.shape for ends in by_level)
    assert all(np.isnan(ends).all() for ends in by_level[:finest])
    assert np.median(np.linalg.norm(by_level[finest] - uv, axis=1)) < 0.01 * 2**finest


def test_too_few_points_are_a_stated_failure(weights: Path) -> None:
    whole = a_reference()
    few = KeyframePoints(np.full((5, 2), 50.0), np.full(5, 0.2), np.full(5, 0.01))
    reference = Reference(key="r", timestamp_ns=1, image=whole.image, camera=whole.camera, sparse_points=few)
    tracker = GnNet(weights=weights)
    found = tracker.track(tracker.prepare(reference), a_query(small_pose(0)))
    assert not found.answered
    assert found.message == "5 reference points with depth, at least 30 are needed"


def test_an_image_that_the_network_cannot_take_is_one_line(weights: Path) -> None:
    with refused(MethodError, "", None, "2x2"):
        GnNet(weights=weights).features(np.zeros((2, 2), np.uint8), small_camera(2, 2))


def test_the_variants_are_parts_of_the_method(weights: Path) -> None:
    """From the prior it is the method without the matched start; with PnP alone, its matched start."""
    usual = GnNet(weights=weights, matched_start=False, min_agreement=0.0)
    from_prior, pnp = GnNetFromPrior(weights=weights), GnNetPnp(weights=weights)
    reference, query = usual.prepare(a_reference()), a_query(small_pose(1))
    aligned, same = usual.track(reference, query), from_prior.track(reference, query)
    assert np.array_equal(_pose(aligned), _pose(same))
    assert aligned.info == same.info
    matched = find_landmarks(reference.landmarks, pnp.features(query.image, query.camera), pnp.start)
    start = matched.pose(pnp.seed)
    assert start is not None
    found = pnp.track(pnp.prepare(a_reference()), query, make_transform(so3_exp([0.0, 0.3, 0.0]), [5.0, 0.0, 0.0]))
    assert np.array_equal(_pose(found), start)
    assert found.info["agreement"] == matched.agreement(start) > 0.05
    assert not np.array_equal(_pose(found), _pose(aligned))
    assert (from_prior.uses_prior, pnp.uses_prior) == (True, False)


def _pose(result: TrackResult) -> Array:
    assert result.T_query_ref is not None, result.message
    return result.T_query_ref


@pytest.mark.parametrize("kind", [GnNetFromPrior, GnNetPnp])
def test_the_variants_use_and_name_the_weights_of_the_method(kind: type[GnNet]) -> None:
    assert kind.files() == GnNet.files()
    assert kind.files()["weights"].name == "gn-net.safetensors"
    described = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["relocbench.methods"]
    assert described[kind.name] == f"baselines.gn_net.tracker:{kind.__name__}"


@pytest.mark.parametrize("kind", [GnNet, GnNetFromPrior, GnNetPnp])
def test_an_answer_that_nothing_speaks_for_is_a_stated_failure(kind: type[GnNet], weights: Path) -> None:
    """Turned upside down, a query shows none of the keyframe; the limit is a parameter."""
    upright = a_query(small_pose(1))
    turned = replace(upright, image=np.ascontiguousarray(upright.image[::-1]))
    strict = kind(weights=weights, min_agreement=0.1)
    lenient = kind(weights=weights, min_agreement=0.0, most_rival=None)
    reference = strict.prepare(a_reference())
    answered, refused = lenient.track(reference, turned), strict.track(reference, turned)
    assert answered.answered
    assert not refused.answered
    count = len(reference.landmarks)
    assert refused.message == (
        f"{answered.info['agreement']:.1%} of {count} landmarks agree with the pose, at least 10.0% are needed"
    )
    assert refused.info == answered.info


def test_an_answer_that_another_pose_explains_far_better_is_a_stated_failure(weights: Path) -> None:
    tracker = GnNetFromPrior(weights=weights, prior_level=0, min_agreement=0.0)
    reference, query = tracker.prepare(a_reference()), a_query(small_pose(1))
    right = np.linalg.inv(small_pose(1)) @ small_pose(0)
    beside = make_transform(so3_exp([0.0, 0.2, 0.0]), np.zeros(3)) @ right
    answered, unchecked = tracker.track(reference, query, right), replace(tracker, most_rival=None)
    assert answered.info["agreement"] > 3 * unchecked.track(reference, query, beside).info["agreement"]
    assert (answered.answered, unchecked.track(reference, query, beside).answered) == (True, True)
    refused = tracker.track(reference, query, beside)
    matched = find_landmarks(reference.landmarks, tracker.features(query.image, query.camera), tracker.start)
    rival = max(map(matched.agreement, matched.poses(tracker.hypotheses, tracker.seed)))
    assert refused.message.endswith(
        f" of {len(reference.landmarks)} landmarks agree with the pose, {rival:.1%} with another one"
    )


def test_pnp_without_matches_is_a_stated_failure(weights: Path) -> None:
    blank = replace(a_query(small_pose(0)), image=np.full((144, 192), 90, np.uint8))
    tracker = GnNetPnp(weights=weights)
    found = tracker.track(tracker.prepare(a_reference()), blank)
    assert not found.answered
    assert "agree" in found.message


def test_variants_share_everything_but_weights_and_defaults(weights: Path) -> None:
    usual, ablation, descent = (kind(weights=weights) for kind in (GnNet, GnNetContrastive, LmNet))
    assert usual.settings == ablation.settings
    assert usual.settings.damping.first == 0.01
    assert descent.settings.damping.first == 2.0
    one_start = GnNet(weights=weights, damping="lm-reloc", **ONE_START)
    assert (one_start.settings, one_start.first_levels) == (descent.settings, descent.first_levels)


def test_the_defaults_of_each_method_are_told_and_can_be_set(weights: Path) -> None:
    """What a run is said to have been made with must be what it was made with."""
    told = {name: parse_method(name, [f"weights={weights}"]).parameters for name in ("gn-net", "lm-net")}
    assert told["gn-net"]["along"] == ALONG
    assert {name: told["lm-net"][name] for name in ONE_START} == ONE_START
    assert (told["lm-net"]["damping"], told["lm-net"]["matched_start"]) == ("lm-reloc", True)
    from_prior = parse_method("lm-net-from-prior", [f"weights={weights}", "along=[3.0]"])
    assert from_prior.parameters["matched_start"] is False
    tracker = from_prior.create()
    assert (tracker.matched_start, len(tracker._along), tracker.first_levels) == (False, 5, 1)
    with refused(MethodError, "", None, "along"):
        parse_method("gn-net", [f"weights={weights}", "along=[.inf]"])


def test_from_an_accurate_prior_there_are_no_starts_along_the_road(weights: Path) -> None:
    tracker = GnNetFromPrior(weights=weights, first_levels=2, along=(-1.0, 1.0), turns_deg=(-5.0, 0.0, 5.0))
    somewhere = tracker._starts(Start(np.eye(4)), 2)
    assert len(somewhere) == 2 * (1 + 2 * 3)
    assert {start.level for start in somewhere} == {2, 1}
    assert [start.level for start in tracker._starts(Start(np.eye(4), 1), 2)] == [1, 0]


def test_a_prior_that_is_not_finite_is_a_stated_failure(weights: Path) -> None:
    tracker = GnNetFromPrior(weights=weights)
    reference, query = tracker.prepare(a_reference()), a_query(small_pose(0))
    for value in (np.inf, np.nan):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = tracker.track(reference, query, np.full((4, 4), value))
        assert found.message == "the start is not finite"


@pytest.mark.parametrize("kind", [GnNet, GnNetFromPrior, GnNetPnp, GnNetContrastive, LmNet])
def test_a_method_without_weights_says_how_to_get_them(
    kind: type[GnNet], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("baselines.gn_net.method.SHIPPED", tmp_path)
    with refused(MethodError, "", None, kind.trainer, f"--set {kind.name}.weights=OUT/weights.safetensors") as told:
        parse_method(f"baselines.gn_net.tracker:{kind.__name__}").create()
    assert "\n" not in str(told.value)


def test_weights_are_given_by_path(weights: Path, tmp_path: Path) -> None:
    tracker = parse_method("mine=gn-net", [f"mine.weights={weights}", "mine.points=500"]).create()
    assert tracker.points == 500
    with refused(MethodError, "none.safetensors"):
        parse_method("gn-net", [f"weights={tmp_path / 'none.safetensors'}"]).create()
    with refused(MethodError, "", None, "abacus"):
        parse_method("gn-net", [f"weights={weights}", "device=abacus"]).create()


@pytest.mark.thorough
def test_answers_do_not_depend_on_what_was_asked_before(weights: Path) -> None:
    queries = [a_query(small_pose(frame)) for frame in (1, 2)]
    fresh = [GnNet(weights=weights) for _ in queries]
    alone = [t.track(t.prepare(a_reference()), q).T_query_ref for t, q in zip(fresh, queries, strict=True)]
    tracker = GnNet(weights=weights)
    reference = tracker.prepare(a_reference())
    together = [tracker.track(reference, q).T_query_ref for q in reversed(queries)][::-1]
    for a, b in zip(alone, together, strict=True):
        assert a is not None
        assert b is not None
        assert np.array_equal(a, b)

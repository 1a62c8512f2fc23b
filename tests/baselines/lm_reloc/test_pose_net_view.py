"""What the pose network sees does not depend on the camera; turned, mirrored and inverted poses agree with geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_views import POSES, MadeViews, keyframe, tiny_encoder
from refusals import refused
from small_dataset import render, small_camera

from baselines.gn_net.weights import load_weights
from baselines.lm_reloc.euler import numbers_of, pose_of
from baselines.lm_reloc.network import PoseNetwork
from baselines.lm_reloc.options import PoseNetOptions
from baselines.lm_reloc.training.options import TrainOptions
from baselines.lm_reloc.training.views import Views
from baselines.lm_reloc.view import inverse_depth_of_places, network_camera, seen_places, view_of
from baselines.options import options_from_dict
from relocbench.errors import MethodError
from relocbench.geometry import Camera, apply, invert, make_transform, rotation_angle, so3_exp
from relocbench.tracking import KeyframePoints
from relocbench.training import TrainingView

SEEN_BY = network_camera(32, 20.0)


def test_angles_and_translation_give_the_pose_back() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        T = make_transform(so3_exp(rng.uniform(-0.8, 0.8, 3)), rng.normal(size=3))
        assert np.abs(pose_of(numbers_of(T)) - T).max() < 1e-12
    # A yaw turns what lies ahead (z) towards the right (x), a pitch towards above (-y).
    assert np.allclose(pose_of(np.array([0, 0.1, 0, 1, 2, 3.0]))[:3, 2], [np.sin(0.1), 0, np.cos(0.1)])
    assert np.allclose(pose_of(np.array([0.1, 0, 0, 0, 0, 0.0]))[:3, 2], [0, -np.sin(0.1), np.cos(0.1)])


@pytest.mark.parametrize("factor", [2.0, 3.0])
def test_an_image_of_another_resolution_is_seen_alike(factor: float) -> None:
    camera = small_camera()
    views = [view_of(render(c, POSES[1])[0], c, SEEN_BY) for c in (camera, camera.scaled(factor))]
    assert np.array_equal(views[0].seen, views[1].seen)
    # The finer image also samples the texture more finely, so that single pixels differ by some grey levels.
    apart = np.abs(views[0].image.astype(float) - views[1].image)[views[0].seen]
    of_other_focal = replace(camera.scaled(factor), fx=camera.fx, fy=camera.fy)
    wrong = view_of(render(camera.scaled(factor), POSES[1])[0], of_other_focal, SEEN_BY).image[views[0].seen]
    assert apart.mean() < 5
    assert np.abs(views[0].image[views[0].seen].astype(float) - wrong).mean() > 3 * apart.mean()


def test_oblong_pixels_are_undone() -> None:
    camera = small_camera()
    oblong = replace(camera, width=192, fx=2 * camera.fx, cx=2 * camera.cx + 0.5)
    square, found = (view_of(render(c, POSES[0])[0], c, SEEN_BY) for c in (camera, oblong))
    assert np.array_equal(square.seen, found.seen)
    assert np.abs(square.image.astype(float) - found.image)[square.seen].mean() < 5


def test_a_moved_principal_point_is_undone() -> None:
    camera = small_camera()
    cut = replace(camera, width=80, height=60, cx=camera.cx - 9, cy=camera.cy - 7)
    image = render(camera, POSES[0])[0]
    whole, part = view_of(image, camera, SEEN_BY), view_of(image[7:67, 9:89], cut, SEEN_BY)
    both = whole.seen & part.seen
    assert both.sum() > 0.6 * whole.seen.sum()
    inner = part.image[both].astype(float) - whole.image[both]
    assert np.abs(inner).mean() < 12
    assert part.seen.sum() < whole.seen.sum()


def test_what_the_camera_does_not_see_is_told() -> None:
    wide = Camera("pinhole", 64, 16, 20.0, 20.0, 31.5, 7.5)
    view = view_of(np.full((16, 64), 200, np.uint8), wide, SEEN_BY)
    assert view.seen[8:24].all()
    assert not view.seen[:8].any()
    assert (view.image[view.seen] == 200).all()
    assert (view.image[~view.seen] == 115).all()
    assert np.array_equal(seen_places(view.seen, 4), np.repeat([[False], [True], [True], [False]], 4, axis=1))


def test_a_turned_view_is_what_a_turned_camera_sees() -> None:
    camera = small_camera(192, 144)
    R = so3_exp([0.03, -0.12, 0.05])
    turned = view_of(render(camera, POSES[2])[0], camera, SEEN_BY, R)
    T_world_turned = POSES[2] @ invert(make_transform(R, np.zeros(3)))
    there = view_of(render(camera, T_world_turned)[0], camera, SEEN_BY)
    other = view_of(render(camera, POSES[2])[0], camera, SEEN_BY)
    both = turned.seen & there.seen & other.seen
    off = [np.abs(each.image[both].astype(float) - there.image[both]).mean() for each in (turned, other)]
    assert off[0] < 10
    assert off[1] > 3 * off[0]


def test_inverse_depth_is_that_of_the_turned_camera() -> None:
    camera = small_camera()
    reference = keyframe(camera, 0)
    R = so3_exp([0.0, 0.15, 0.0])
    places = inverse_depth_of_places(reference.points, camera, SEEN_BY, 8, R)
    wide = Camera("pinhole", 400, 400, 200.0, 200.0, 199.5, 199.5)
    turned = keyframe(wide, 0)
    T_world_turned = POSES[0] @ invert(make_transform(R, np.zeros(3)))
    depth = render(wide, T_world_turned)[1]
    expected = inverse_depth_of_places(replace(turned, depth=depth).points, wide, SEEN_BY, 8)
    inner = np.zeros((8, 8), dtype=bool)
    inner[2:6, 3:5] = True
    assert places[1][inner].all()
    assert np.abs(places[0] / expected[0] - 1)[inner].max() < 0.1
    assert not places[0][places[1] == 0].any()


def test_without_depth_nothing_is_known() -> None:
    none = KeyframePoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert not inverse_depth_of_places(none, small_camera(), SEEN_BY, 4).any()


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Views:
    encoder = load_weights(tiny_encoder(tmp_path_factory.mktemp("weights")))
    network = options_from_dict(PoseNetOptions, {"side": 32, "focal": 24.0, "stage": 2, "channels": [4], "kernels": [1],
        "encoder": {"widths": (4, 6, 8), "dim": 4, "levels": 2}, "depth": True})  # fmt: skip
    net = PoseNetwork(network)
    net.encoder.load_state_dict(encoder.state_dict())
    return Views(MadeViews(), TrainOptions(turns=3, network=network), net)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_pose_between_turned_views_maps_the_points_of_one_to_the_other(views: Views, mirrored: bool) -> None:
    pair = MadeViews().posed(5)
    ref, query = (pair.image_ref, 2), (pair.image_query, 1)
    point = np.array([[0.7, -0.3, 5.0]])
    in_ref, in_query = point, apply(pair.T_query_ref, point)
    if mirrored:
        in_ref, in_query = in_ref * [-1, 1, 1], in_query * [-1, 1, 1]
    seen_ref, seen_query = (
        apply(views.T_view_camera(*which, mirrored), at) for which, at in ((ref, in_ref), (query, in_query))
    )
    T = views.relative(pair.T_query_ref, ref, query, mirrored)
    assert np.abs(apply(T, seen_ref) - seen_query).max() < 1e-12
    assert rotation_angle(views.T_view_camera(*ref, mirrored)[:3, :3]) > 0.005
    assert np.array_equal(views.T_view_camera(ref[0], 0, mirrored), np.eye(4))


def test_views_are_computed_once_and_do_not_depend_on_what_is_kept(views: Views) -> None:
    data = MadeViews()
    again = Views(data, replace(views._options, cache_mb=0), views._network)
    for turn in (0, 1):
        for mirrored in (False, True):
            first = views("1", turn, mirrored)
            assert views("1", turn, mirrored) is first
            assert all(np.array_equal(a, b) for a, b in zip(first, again("1", turn, mirrored), strict=True))
    assert len(data.reads) == 4
    plain, mirror = views("1", 0, False), views("1", 0, True)
    assert np.allclose(plain.depth.flip(2), mirror.depth, atol=1e-4)


def test_an_image_with_distortion_is_not_mirrored(views: Views) -> None:
    class Distorted(MadeViews):
        def view(self, name: str, *, depth: bool) -> TrainingView:
            view = super().view(name, depth=depth)
            return replace(view, camera=replace(view.camera, model="radtan", distortion=(0.1, 0.0, 0.0, 0.0)))

    made = Views(Distorted(), views._options, views._network)
    assert made("0", 0, False).seen.any()
    with refused(MethodError, "", None, "radtan", "mirror=0"):
        made("0", 0, True)

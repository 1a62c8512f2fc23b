"""The rendered street: exact truth, three lights, neither too easy nor too hard."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from relocbench.datasets.correspondences import read_correspondences
from relocbench.datasets.dataset import Dataset
from relocbench.datasets.importers import Run, scene
from relocbench.datasets.importers.scene_render import Light, render, render_depth
from relocbench.datasets.importers.scene_world import MATERIALS, TEXELS, build_world
from relocbench.errors import ConfigError
from relocbench.geometry import Camera, make_transform, so3_exp
from relocbench.progress import Silent

SMALL = {"width": 128, "height": 96, "frames": 6, "correspondences": 200, "pair_step": (2,)}
DAY = Light(sun=(-0.5, -1.0, -0.4), sun_strength=1.0, ambient=0.55, noise=0.0)


def build(out: Path, workers: int = 1, **options: object) -> Dataset:
    return scene.build([], scene.Options.model_validate({**SMALL, **options}), out, Silent(), Run(workers))


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return build(tmp_path_factory.mktemp("scene") / "out")


def test_there_are_three_traversals_with_their_conditions_and_two_splits(street: Dataset) -> None:
    assert street.traversal_names == ["bright", "dusk", "overcast"]
    assert street.traversal("dusk").condition.time_of_day == "dusk"
    assert [s.name for s in street.pair_sets("within")] == ["bright__bright__front"]
    assert {s.name for s in street.pair_sets("across")} == {"bright__dusk__front", "bright__overcast__front"}
    assert all(len(s.pairs) >= 2 for s in street.pair_sets())


def test_the_seed_makes_the_bytes_and_workers_do_not(street: Dataset, tmp_path: Path) -> None:
    assert build(tmp_path / "again", workers=2).fingerprint == street.fingerprint
    assert build(tmp_path / "other", seed=1).fingerprint != street.fingerprint


def test_an_interrupted_build_renders_only_what_is_missing(tmp_path: Path) -> None:
    before = build(tmp_path / "out", traversals=1)
    layout = before.layout.traversal("bright")
    times = before.traversal("bright").timestamps("front")
    layout.image("front", times[1]).unlink()
    whole = layout.depth("front", times[2])
    torn = layout.depth("front", times[0])
    torn.write_bytes(torn.read_bytes()[:40])
    before.layout.dataset_yaml.unlink()
    written = whole.stat().st_mtime_ns
    assert build(tmp_path / "out", traversals=1).fingerprint == before.fingerprint
    assert whole.stat().st_mtime_ns == written


def test_the_truth_carries_the_surface_from_one_image_to_the_other(street: Dataset) -> None:
    """Exact depth and poses: within the same light the same surface has the same brightness."""
    pair_set = street.pair_set("bright__bright__front")
    pair = pair_set.pairs[0]
    rows = read_correspondences(street.layout.correspondence_file(pair_set.name), pair.key)
    reference, query = street.reference(pair_set, pair), street.query(pair_set, pair)
    a = cv2.remap(reference.image, *rows.uv_ref.astype(np.float32).T[..., None], cv2.INTER_LINEAR)
    b = cv2.remap(query.image, *rows.uv_query.astype(np.float32).T[..., None], cv2.INTER_LINEAR)
    difference = np.abs(a.astype(float) - b.astype(float)).mean(axis=(1, 2))
    assert np.median(difference[rows.visible]) < 8
    shuffled = np.abs(a.astype(float) - np.roll(b, 50, axis=0)).mean(axis=(1, 2))
    assert np.median(difference[rows.visible]) < 0.4 * np.median(shuffled)


def test_the_lights_differ_by_more_than_a_gain(street: Dataset) -> None:
    """No single gain and bias takes the bright image to the dusk one along the true correspondences."""
    pair_set = street.pair_set("bright__dusk__front")
    pair = pair_set.pairs[0]
    rows = read_correspondences(street.layout.correspondence_file(pair_set.name), pair.key)
    images = street.reference(pair_set, pair).image, street.query(pair_set, pair).image
    a, b = (
        cv2.remap(i, *uv[rows.visible].astype(np.float32).T[..., None], cv2.INTER_LINEAR).mean(axis=(1, 2))
        for i, uv in zip(images, (rows.uv_ref, rows.uv_query), strict=True)
    )
    fit = np.polyval(np.polyfit(a, b, 1), a)
    explained = 1 - np.var(b - fit) / np.var(b)
    assert explained < 0.9


def test_depth_is_that_of_the_ground_in_front() -> None:
    camera = scene.scene_camera(128, 96)
    depth = render_depth(0, camera, make_transform(np.eye(3), [1.3, -1.5, 0.0]))
    # The road lies 1.5 m below: z = 1.5 f / (v - cy); the last row, right of the dashes and left of what is parked.
    column = round(camera.cx)
    assert depth[-1, column] == pytest.approx(1.5 * camera.fy / (95 - camera.cy), rel=1e-4)
    assert depth[0, column] == 0 or depth[0, column] > 20


def test_textures_tile_and_are_seeded() -> None:
    world = build_world(3)
    assert len(world.textures) == len(MATERIALS)
    for levels in world.textures:
        assert levels[0].shape == (TEXELS, TEXELS, 3)
        assert levels[-1].shape == (1, 1, 3)
        np.testing.assert_allclose(levels[-1][0, 0], levels[0].mean(axis=(0, 1), dtype=np.float64), atol=1e-5)
        assert 0 <= levels[0].min() < levels[0].max() <= 1
    assert not np.array_equal(world.textures[0][0], build_world(4).textures[0][0])


def test_nothing_shimmers() -> None:
    """Half a pixel of motion changes a picture as much as resampling it does, not more: there is no aliasing.

    The camera turns by half a pixel about its vertical axis, which moves the picture without parallax.
    """
    camera = Camera("pinhole", 160, 120, 115.0, 115.0, 79.5, 59.5)
    light = Light(sun=(0, -1, 0), sun_strength=0.0, ambient=0.8, noise=0.0)
    rng = np.random.default_rng(0)
    centre = [0.3, -1.5, 4.0]
    straight = render(0, camera, make_transform(np.eye(3), centre), light, rng).astype(np.float32)
    turn = so3_exp([0, 0.5 / camera.fx, 0])
    turned = render(0, camera, make_transform(turn, centre), light, rng).astype(np.float32)
    middle = (slice(30, 90), slice(60, 100))  # where the turn is a shift by half a pixel
    shifted = 0.5 * (straight[:, :-1] + straight[:, 1:])[middle]
    far = np.abs(shifted - turned[middle]).mean()
    whole_pixel = np.abs(np.diff(straight, axis=1))[middle].mean()
    assert far < 0.5 * whole_pixel


def test_shadows_fall_in_the_sun_only() -> None:
    camera = scene.scene_camera(128, 96)
    pose = make_transform(np.eye(3), [0.3, -1.5, 0.0])
    overcast = Light(sun=DAY.sun, sun_strength=0.0, ambient=1.2, noise=0.0)
    rng = np.random.default_rng(0)
    road = (slice(70, 96), slice(0, 128))
    sunny, grey = (render(0, camera, pose, light, rng)[road].astype(float) for light in (DAY, overcast))
    assert sunny.std() > 1.3 * grey.std()


def test_sources_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="takes no recordings"):
        scene.build([tmp_path], scene.Options(), tmp_path / "out", Silent(), Run())

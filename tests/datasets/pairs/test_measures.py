"""How hard a pair is: overlap both ways, the stated error of depth, and how alike two images look at the true pose."""

import cv2
import numpy as np
import pytest

from relocbench.arrays import Array, Image
from relocbench.datasets.pairs.correspondences import pair_correspondences
from relocbench.datasets.pairs.measures import PairMeasures, _sampled, similarity
from relocbench.datasets.pairs.visibility import DepthView
from relocbench.geometry import Camera, make_transform
from relocbench.tracking import KeyframePoints, Reference

FOCAL, DEPTH, WIDTH, HEIGHT = 100.0, 5.0, 128, 96
CAMERA = Camera("pinhole", WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
WALL = np.full((HEIGHT, WIDTH), DEPTH, np.float32)
SHIFT = 32
"""pixels by which a query a step to the side shows the wall elsewhere"""
ASIDE = make_transform(np.eye(3), [-SHIFT * DEPTH / FOCAL, 0.0, 0.0])


def texture(seed: int = 0) -> Image:
    noise = np.random.default_rng(seed).uniform(0, 255, (HEIGHT, WIDTH + SHIFT)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2)
    return np.asarray(255 * (smooth - smooth.min()) / np.ptp(smooth)).astype(np.uint8)


def keyframe(image: Image, **depth: object) -> Reference:
    return Reference("", None, image, CAMERA, **(depth or {"depth": WALL}))  # type: ignore[arg-type]


def measure(reference: Reference, query: Image, T_query_ref: Array = ASIDE, depth: bool = True) -> PairMeasures:
    view = DepthView(CAMERA, WALL if depth else None)
    return pair_correspondences(reference, T_query_ref, view, 50, np.random.default_rng(0), None, query).measures


WHOLE = texture()
LEFT, RIGHT = np.ascontiguousarray(WHOLE[:, :WIDTH]), np.ascontiguousarray(WHOLE[:, SHIFT:])


def test_a_step_aside_shows_the_same_wall_of_which_each_camera_sees_as_much() -> None:
    found = measure(keyframe(LEFT), RIGHT)
    assert found.overlap == pytest.approx(1 - SHIFT / WIDTH, abs=0.01)
    assert found.overlap_query == pytest.approx(1 - SHIFT / WIDTH, abs=0.01)
    assert found.similarity == pytest.approx(1.0, abs=1e-3)
    assert found.scale_change is not None
    assert 1.0 <= found.scale_change < 1.15
    assert found.depth_error == 0.0


def test_nothing_is_said_of_the_way_back_where_the_query_has_no_depth() -> None:
    assert measure(keyframe(LEFT), RIGHT, depth=False).overlap_query is None


def test_a_camera_that_comes_nearer_sees_less_of_the_keyframe_and_is_seen_as_a_whole() -> None:
    found = measure(keyframe(LEFT), LEFT, make_transform(np.eye(3), [0.0, 0.0, -DEPTH / 2]))
    # Its own wall is half as far away, so this pose sees one that is not there: only what the keyframe tells counts.
    assert found.overlap == 0.0
    view = DepthView(CAMERA, np.full_like(WALL, DEPTH / 2))
    nearer = pair_correspondences(
        keyframe(LEFT), make_transform(np.eye(3), [0.0, 0.0, -DEPTH / 2]), view, 50, np.random.default_rng(0)
    ).measures
    assert nearer.overlap == pytest.approx(0.25, abs=0.02)
    assert nearer.overlap_query == pytest.approx(1.0, abs=0.02)
    assert nearer.scale_change is not None
    assert 1.7 < nearer.scale_change <= 2.0
    assert nearer.similarity is None


def test_similarity_falls_with_the_look_and_not_with_light_or_sparse_depth() -> None:
    assert measure(keyframe(LEFT), (RIGHT // 2 + 20).astype(np.uint8)).similarity == pytest.approx(1.0, abs=0.01)
    assert measure(keyframe(LEFT), 255 - RIGHT).similarity == pytest.approx(-1.0, abs=0.01)
    assert abs(measure(keyframe(LEFT), np.ascontiguousarray(texture(1)[:, SHIFT:])).similarity or 1.0) < 0.2
    assert measure(keyframe(LEFT), np.full_like(LEFT, 90)).similarity == 0.0
    assert measure(keyframe(np.full_like(LEFT, 90)), RIGHT).similarity is None
    v, u = np.mgrid[8:HEIGHT:8, 8:WIDTH:8].reshape(2, -1)
    points = KeyframePoints(np.column_stack([u, v]).astype(float), np.full(len(u), 1 / DEPTH), np.full(len(u), 0.004))
    sparse = measure(keyframe(LEFT, sparse_points=points), RIGHT)
    assert sparse.similarity == pytest.approx(1.0, abs=1e-3)
    assert sparse.depth_error == pytest.approx(0.004 * DEPTH, abs=1e-6)


def test_large_images_are_compared_at_the_size_of_small_ones() -> None:
    size = 4 * WIDTH, 4 * HEIGHT
    camera = Camera("pinhole", *size, 4 * FOCAL, 4 * FOCAL, (size[0] - 1) / 2, (size[1] - 1) / 2)
    rng = np.random.default_rng(0)
    noisy = [
        np.clip(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC) + rng.normal(0, 12, size[::-1]), 0, 255)
        for image in (LEFT, RIGHT)
    ]
    grey = [image.astype(np.uint8) for image in noisy]
    reference = Reference("", None, grey[0], camera, depth=np.full(size[::-1], DEPTH, np.float32))
    v, u = np.mgrid[40 : size[1] : 16, 160 : size[0] : 16].reshape(2, -1)
    pixels = np.column_stack([u, v]).astype(np.float64)
    found = similarity(reference, camera, grey[1], ASIDE, pixels, np.full(len(u), DEPTH))
    assert found is not None
    assert found > 0.8


def test_grey_levels_are_means_around_their_pixel_for_any_size_of_image_and_no_darker_at_its_border() -> None:
    ramp = np.tile(np.arange(0, 200, 2, dtype=np.uint8), (60, 1))
    for step in range(1, 6):
        here, at_border = _sampled(ramp, np.array([[30.0, 99.4]]), np.array([[30.0, 30.0]]), step)[0]
        assert here == pytest.approx(60.0)
        assert at_border == pytest.approx(198.0, abs=step)

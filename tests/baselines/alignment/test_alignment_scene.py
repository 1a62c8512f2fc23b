"""The scene that alignment is tested on shows what it should."""

from __future__ import annotations

import numpy as np
from alignment_scene import CAMERA, motion, render

from relocbench.geometry import apply


def test_the_scene_shows_the_same_grey_level_at_corresponding_pixels() -> None:
    T = motion((0.1, -0.05, -0.2), (1, -2, 1))
    (grey, depth), (grey_query, depth_query) = render(np.eye(4)), render(T)
    v, u = np.mgrid[20:236:7, 20:300:7]
    rays, _ = CAMERA.unproject(np.stack([u, v], axis=-1))
    moved = apply(T, (rays * depth[v, u, None]).reshape(-1, 3))
    pixels, valid = CAMERA.project(moved)
    near = np.rint(pixels).astype(int)
    seen = valid & CAMERA.contains(near, 1)
    visible = np.abs(depth_query[near[seen, 1], near[seen, 0]] - moved[seen, 2]) < 0.15
    difference = grey.astype(float)[v, u].reshape(-1)[seen] - grey_query[near[seen, 1], near[seen, 0]]
    assert visible.mean() > 0.95
    assert np.median(np.abs(difference)) < 6  # half a pixel of rounding

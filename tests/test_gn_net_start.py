"""The first guess from nearest features: right where features are told apart, none where nothing agrees."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.alignment import FeaturePyramid, ReferenceFeatures
from baselines.gn_net.start import StartSettings, matched_pose
from relocbench.errors import ConfigError
from relocbench.geometry import Camera, apply, make_transform, rotation_angle, so3_exp
from relocbench.tracking import KeyframePoints

CAMERA = Camera(model="pinhole", width=256, height=256, fx=128.0, fy=128.0, cx=127.5, cy=127.5)
T_QUERY_REF = make_transform(so3_exp([0.02, 0.15, -0.03]), [0.7, -0.1, 1.1])
SETTINGS = StartSettings(level=0, points=500, threshold=1.5)


def a_scene(seed: int, right: float) -> tuple[ReferenceFeatures, FeaturePyramid]:
    """Points with a random feature each; the query shows the share ``right`` of them where they are.

    Elsewhere, and in place of the others, it shows random features.
    """
    rng = np.random.default_rng(seed)
    uv = rng.uniform(4, 251, (400, 2))
    inverse_depth = 1 / rng.uniform(5, 25, len(uv))
    rays = np.concatenate([(uv - 127.5) / 128.0, np.ones((len(uv), 1))], axis=1)
    seen, visible = CAMERA.project(apply(T_QUERY_REF, rays / inverse_depth[:, None]))
    values = rng.normal(size=(len(uv), 8)).astype(np.float32)
    maps = [rng.normal(size=(256, 256, 8)).astype(np.float32) for _ in range(2)]
    for i in np.flatnonzero(visible & (rng.random(len(uv)) < right)):
        u, v = np.rint(seen[i]).astype(int)
        if 1 <= u < 255 and 1 <= v < 255:
            maps[1][v, u] = values[i]
    reference = ReferenceFeatures.at_points(
        KeyframePoints(uv, inverse_depth, np.full(len(uv), 1e-3)), FeaturePyramid.from_maps(maps[:1], CAMERA)
    )
    reference.levels[0].values[:] = values
    return reference, FeaturePyramid.from_maps(maps[1:], CAMERA)


@pytest.mark.parametrize("right", [1.0, 0.4])
def test_the_pose_is_found_far_from_the_identity(right: float) -> None:
    found = matched_pose(*a_scene(0, right), SETTINGS, seed=0)
    assert found is not None
    off = np.linalg.inv(found) @ T_QUERY_REF
    assert np.linalg.norm(off[:3, 3]) < 0.05
    assert np.degrees(rotation_angle(off[:3, :3])) < 0.3


def test_the_same_seed_gives_the_same_pose() -> None:
    scene = a_scene(1, 0.5)
    one, other = (matched_pose(*scene, SETTINGS, seed=3) for _ in range(2))
    assert one is not None
    assert np.array_equal(one, other)


def test_too_few_points_give_no_pose() -> None:
    _, query = a_scene(2, 1.0)
    few = ReferenceFeatures.at_points(
        KeyframePoints(np.full((3, 2), 50.0), np.full(3, 0.1), np.full(3, 0.01)),
        FeaturePyramid.from_maps([query.levels[0].map], CAMERA),
    )
    assert matched_pose(few, query, SETTINGS, seed=0) is None


@pytest.mark.parametrize("changed", [{"points": 3}, {"threshold": 0.0}, {"level": -1}, {"confidence": 1.0}])
def test_settings_that_make_no_sense_are_refused(changed: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        StartSettings(**changed)  # type: ignore[arg-type]

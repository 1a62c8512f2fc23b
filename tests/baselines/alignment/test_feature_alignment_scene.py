"""Features on the surfaces of the analytic scene are what they claim to be."""

from __future__ import annotations

import numpy as np
from alignment_scene import CAMERA, motion
from feature_alignment_scene import keyframe_points, pyramid

from baselines.alignment.features.pyramid import sample
from relocbench.geometry import apply


def test_corresponding_places_have_the_same_features_on_every_level() -> None:
    moved = (0.1, -0.05, -0.2, 1, -2, 1)
    points, T = keyframe_points(), motion(moved[:3], moved[3:])
    in_ref = CAMERA.unproject(points.uv)[0] / points.inverse_depth[:, None]
    for number, (reference, query) in enumerate(zip(pyramid().levels, pyramid(moved).levels, strict=True)):
        u_ref, u_query = reference.camera.project(in_ref)[0], query.camera.project(apply(T, in_ref))[0]
        seen = np.all((u_ref > 1) & (u_query > 1), axis=1)
        seen &= np.all(np.maximum(u_ref, u_query) < np.array(query.map.shape[1::-1]) - 2, axis=1)
        apart = np.abs(sample(reference.map, u_ref[seen]) - sample(query.map, u_query[seen]))
        assert seen.mean() > 0.7
        assert np.quantile(apart, 0.95) < 0.02, number
        assert sample(reference.map, u_ref[seen]).std() > 0.5

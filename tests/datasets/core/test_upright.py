"""Poses of any frame are seen from above as those of a camera that looks ahead."""

from __future__ import annotations

import numpy as np
import pytest
from two_laps import laps

from relocbench.datasets.core.upright import R_frame_camera, with_camera_axes
from relocbench.geometry import make_transform

VEHICLE = np.array(list(laps(1).values()))
CAMERA = VEHICLE @ make_transform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.zeros(3))


@pytest.mark.parametrize("poses", [VEHICLE, CAMERA], ids=["vehicle", "camera"])
def test_up_is_where_the_tops_of_images_would_point(poses: np.ndarray) -> None:
    found = with_camera_axes(poses)
    np.testing.assert_allclose(found, CAMERA, atol=1e-12)
    assert np.all(-found[:, 2, 1] > 0.99)  # against the y axis, in a world whose z is up
    ahead = np.einsum("ni,ni->n", np.diff(found[:, :3, 3], axis=0), found[:-1, :3, 2])
    assert np.all(ahead > 0)


def test_what_does_not_move_is_taken_for_a_camera() -> None:
    for poses in (VEHICLE[:0], VEHICLE[:1], np.repeat(CAMERA[:1], 3, axis=0)):
        np.testing.assert_array_equal(with_camera_axes(poses), poses)
        np.testing.assert_array_equal(R_frame_camera(poses), np.eye(3))

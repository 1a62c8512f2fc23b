"""Matches that methods tell, in pixels of the small pictures of a pair."""

from __future__ import annotations

import json

import numpy as np
import pytest

from relocbench.geometry import Camera
from relocbench.leaderboard.html.pair_page.pictures import MOST, shown_matches, small_camera

LARGE = Camera("pinhole", 960, 720, 700.0, 700.0, 479.5, 359.5)
BENT = Camera("radtan", 160, 120, 130.0, 130.0, 79.5, 59.5, (-0.2, 0.03, 0.001, -0.001))


def told(*matches: list[float]) -> str:
    return json.dumps({"inliers": 3, "shown_matches": list(matches)})


def test_pixels_shrink_with_their_pictures() -> None:
    assert small_camera(LARGE).size == (480, 360)
    info = told([0.5, 0.5, 100.5, 200.5, 1], [958.5, 718.5, 1.5, 2.5, 0])
    assert shown_matches(info, LARGE, LARGE) == [[0.0, 0.0, 50.0, 100.0, 1], [479.0, 359.0, 0.5, 1.0, 0]]


def test_pixels_of_a_distorted_image_are_where_the_picture_shows_them() -> None:
    rays = np.array([[0.2, -0.1, 1.0]])
    (u, v), (x, y) = BENT.project(rays)[0][0], small_camera(BENT).project(rays)[0][0]
    ((a, b, c, d, _),) = shown_matches(told([u, v, 5.0, 6.0, 1]), BENT, small_camera(BENT))
    np.testing.assert_allclose([a, b], [x, y], atol=0.06)  # tenths of pixels are written
    assert (c, d) == (5.0, 6.0)


@pytest.mark.parametrize(
    "info",
    [
        "",
        "{}",
        "no JSON, but shown_matches",
        '["shown_matches"]',
        '{"shown_matches": 3}',
        '{"shown_matches": {"a": 1}}',
        '{"shown_matches": []}',
        '{"shown_matches": [[1, 2, 3, 4]]}',
        '{"shown_matches": [[1, 2, 3, 4, 1], [1, 2, 3]]}',
        '{"shown_matches": [[1, 2, "<script>", 4, 1]]}',
        '{"shown_matches": [[1, 2, 3, Infinity, 1]]}',
        '{"shown_matches": [[1, 2, 3, null, 1]]}',
        '{"shown_matches": [[[1], 2, 3, 4, 1]]}',
        json.dumps({"shown_matches": [[10**400, 2, 3, 4, 1]]}),
    ],
)
def test_what_is_no_list_of_matches_is_not_drawn(info: str) -> None:
    assert shown_matches(info, LARGE, LARGE) == []


def test_not_more_are_drawn_than_a_picture_bears() -> None:
    assert len(shown_matches(told(*[[1.0, 2.0, 3.0, 4.0, 1.0]] * (2 * MOST)), LARGE, LARGE)) == MOST

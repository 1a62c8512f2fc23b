"""Views cut from cube maps, and strong motions: exact where something is shown, and nothing is said where it is not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from relocbench.arrays import Array, Image
from relocbench.datasets.moved_views.drawing import Keyframe, View, drawn_cube_keyframe, drawn_keyframe, grid
from relocbench.datasets.moved_views.exact_correspondences import exact_correspondences
from relocbench.datasets.moved_views.faces import R_FACE_CUBE, SIDES, cube_faces, located
from relocbench.datasets.moved_views.motions import Motions, drawn_motion
from relocbench.datasets.moved_views.pictures import Reduced, view_of
from relocbench.geometry import rotation_angle
from relocbench.tracking import Reference

SIZE = 96, 72
SIDE = 160
TURNS = Motions(0.0, 5.0, 10.0, 0.5, "strong")


def colours(directions: Array) -> Array:
    """A smooth picture of all directions (..., 3), never black: (..., 3), 40 to 215."""
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.asarray(127.5 + 87.5 * np.sin(2.0 * unit + [0.3, 1.1, 2.0]))


def cube_map(faces: tuple[str, ...]) -> list[Image]:
    """What the faces of a cube map show of :func:`colours`."""
    found = []
    for face in cube_faces(faces, SIDE, np.eye(3)):
        rays, _ = face.camera.unproject(grid(face.camera))
        found.append(np.rint(colours(rays @ face.R_face_ref)).astype(np.uint8))
    return found


def keyframe_of(seed: int, faces: tuple[str, ...] = SIDES) -> Keyframe:
    return drawn_cube_keyframe(faces, SIDE, SIZE, np.random.default_rng(seed))


def pictures(keyframe: Keyframe, faces: tuple[str, ...], view: View) -> tuple[Image, Image]:
    images = cube_map(faces)
    of_keyframe = Reduced.of(keyframe.faces, images, keyframe.camera.fx)
    return view_of(of_keyframe, keyframe), view_of(Reduced.of(keyframe.faces, images, view.camera.fx), keyframe, view)


def test_the_sides_of_a_cube_map_follow_each_other_to_the_right_and_meet_at_their_borders() -> None:
    for left, right in zip(SIDES, (*SIDES[1:], SIDES[0]), strict=True):
        assert np.array_equal(R_FACE_CUBE[left][0], R_FACE_CUBE[right][2])
        assert np.array_equal(R_FACE_CUBE[left][1], [0, 1, 0])
    for axes in R_FACE_CUBE.values():
        assert np.linalg.det(axes) == pytest.approx(1)
    # Above posz is posy with its lower border, below it negy with its upper one.
    assert np.array_equal(R_FACE_CUBE["posz"][0], R_FACE_CUBE["posy"][0])
    assert np.array_equal(R_FACE_CUBE["posy"][1], R_FACE_CUBE["posz"][2])
    assert np.array_equal(R_FACE_CUBE["negy"][1], -R_FACE_CUBE["posz"][2])
    directions = np.random.default_rng(0).normal(size=(5000, 3))
    number, pixels = located(cube_faces(tuple(R_FACE_CUBE), SIDE, np.eye(3)), directions)
    assert set(number) == set(range(6))
    assert np.abs(pixels - (SIDE - 1) / 2).max() <= SIDE / 2 + 1e-5


@pytest.mark.parametrize("faces", [SIDES, tuple(R_FACE_CUBE)])
@pytest.mark.parametrize("seed", range(6))
def test_views_of_a_cube_map_differ_by_exactly_their_rotation_and_look_alike(seed: int, faces: tuple[str, ...]) -> None:
    keyframe = keyframe_of(seed, faces)
    view = drawn_motion(keyframe, TURNS, np.random.default_rng(seed))
    R_query_ref = view.T_query_ref[:3, :3]
    assert np.array_equal(view.T_query_ref[:3, 3], np.zeros(3))
    assert np.degrees(rotation_angle(R_query_ref)) > 2
    reference, query = pictures(keyframe, faces, view)
    seen_as = Reference("", None, reference, keyframe.camera, depth=keyframe.depth().astype(np.float32))
    found = exact_correspondences(keyframe, seen_as, query, view, 500, np.random.default_rng(0))
    assert len(found) > 100
    assert np.all(found.visible)
    rays, _ = keyframe.camera.unproject(found.uv_ref)
    expected, _ = view.camera.project(rays @ R_query_ref.T)
    assert np.allclose(found.uv_query, expected, rtol=0, atol=1e-6)
    at = found.uv_query.astype(np.float32)[None]
    inside = np.all((at[0] > 1) & (at[0] < np.array(SIZE) - 2), axis=1)
    shown = cv2.remap(query, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0].astype(float)
    stood = reference[found.uv_ref[:, 1].astype(int), found.uv_ref[:, 0].astype(int)].astype(float)
    # Next to what is black, pixels between are mixed with it.
    whole = cv2.remap((query.max(axis=2) > 0).astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0] > 0.999
    assert np.sum(inside & whole) > 80
    assert np.abs(shown - stood)[inside & whole].max() < 3
    assert np.abs(stood - colours(rays @ keyframe.faces[3].R_face_ref.T)).max() < 2.5


@pytest.mark.thorough
def test_what_no_face_shows_is_black_without_depth_and_without_correspondences() -> None:
    lacking = 0
    for seed in range(12):
        keyframe = keyframe_of(seed)
        view = drawn_motion(keyframe, TURNS, np.random.default_rng(seed))
        reference, query = pictures(keyframe, SIDES, view)
        for image, content in ((reference, keyframe.content(grid(keyframe.camera))), (query, None)):
            black = np.all(image == 0, axis=2)
            if content is None:
                content = keyframe.content(grid(view.camera), view)
            assert np.mean(black) <= 0.27
            # A pixel on the border may be black or show what its part beyond the middle does.
            eroded = cv2.erode((~content).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
            assert np.all(black[eroded])
            assert not np.any(black[content])
            lacking += int(black.sum())
        depth = keyframe.depth()
        assert np.array_equal(depth > 0, keyframe.content(grid(keyframe.camera)))
        seen_as = Reference("", None, reference, keyframe.camera, depth=depth.astype(np.float32))
        found = exact_correspondences(keyframe, seen_as, query, view, 500, np.random.default_rng(0))
        assert np.all(depth[found.uv_ref[:, 1].astype(int), found.uv_ref[:, 0].astype(int)] > 0)
        assert np.all(keyframe.content(found.uv_query, view))
    assert lacking > 500


def test_strong_turns_reach_far_but_not_beyond_their_limits() -> None:
    aside, rolls, zooms = [], [], []
    for seed in range(60):
        keyframe = keyframe_of(seed, tuple(R_FACE_CUBE))
        view = drawn_motion(keyframe, TURNS, np.random.default_rng(seed))
        forward = view.T_query_ref[2, :3]
        aside.append(np.degrees(np.arccos(forward[2])))
        rolls.append(np.degrees(np.arctan2(view.T_query_ref[0, 1], view.T_query_ref[1, 1])))
        zooms.append(view.camera.fx / keyframe.camera.fx)
    assert 35 < max(aside) <= 60
    assert 25 < max(np.abs(rolls)) < 55
    assert 0.5 <= min(zooms) < 0.8
    assert 1.3 < max(zooms) <= 2


@pytest.mark.parametrize("kind", ["plane", "street", "relief"])
def test_strong_motions_around_a_photograph_are_wide_and_show_mostly_photograph(kind: str) -> None:
    angles, scales = [], []
    for seed in range(12):
        keyframe = drawn_keyframe((240, 180), None, SIZE, kind, np.random.default_rng(seed))  # type: ignore[arg-type]
        view = drawn_motion(keyframe, TURNS, np.random.default_rng(seed))
        assert np.mean(keyframe.content(grid(view.camera), view)) > 0.7
        angles.append(np.degrees(rotation_angle(view.T_query_ref[:3, :3])))
        depth = float(np.median(keyframe.depth()))
        scales.append(np.linalg.norm(view.T_query_ref @ [0, 0, depth, 1] - [0, 0, 0, 1]) / depth)
    assert 20 < max(angles) <= 61
    assert max(np.abs(np.log(scales))) > 0.2

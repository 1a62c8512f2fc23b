"""Made-up views of photographs: what a query shows is where its pose says, and nothing else is in it."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow
from PIL import ImageOps

from relocbench.arrays import Array, Image
from relocbench.datasets.moved_views.drawing import (
    Keyframe,
    View,
    drawn_keyframe,
    least_size,
)
from relocbench.datasets.moved_views.exact_correspondences import exact_correspondences
from relocbench.datasets.moved_views.exif import Exif, read_exif
from relocbench.datasets.moved_views.faces import SIDES, cube_faces
from relocbench.datasets.moved_views.kinds import SURFACES, SurfaceKind
from relocbench.datasets.moved_views.motions import Motions, drawn_motion
from relocbench.datasets.moved_views.pictures import Reduced, view_of
from relocbench.datasets.moved_views.surfaces import Planes, Relief, seen_at, shown_at
from relocbench.geometry import Camera, invert, make_transform, so3_exp
from relocbench.tracking import Reference

SIZE = 96, 72
PHOTOGRAPH = 200, 140
FAR = Motions(0.4, 50.0, 10.0, 0.5)


def keyframe_of(kind: SurfaceKind, seed: int, size: tuple[int, int] = PHOTOGRAPH) -> Keyframe:
    return drawn_keyframe(size, None, SIZE, kind, np.random.default_rng(seed))


def all_pixels(camera: Camera) -> Array:
    v, u = np.mgrid[: camera.height, : camera.width].reshape(2, -1)
    return np.column_stack([u, v]).astype(np.float64)


def coded(size: tuple[int, int]) -> Image:
    """A photograph whose red tells the column and whose green the row, in 0 to 200; the outermost pixels are blue."""
    u, v = np.meshgrid(np.arange(size[0]) / (size[0] - 1), np.arange(size[1]) / (size[1] - 1))
    image = np.stack([200 * u, 200 * v, 0 * u], axis=-1).astype(np.uint8)
    image[[0, -1]] = image[:, [0, -1]] = (0, 0, 255)
    return image


def test_a_query_sees_a_plane_through_its_homography() -> None:
    camera = Camera("pinhole", 96, 72, 80.0, 82.0, 47.0, 36.5)
    other = Camera("pinhole", 120, 80, 99.0, 97.0, 61.0, 38.0)
    inverse = np.array([0.02, -0.05, 0.11])
    T_query_ref = make_transform(so3_exp([0.04, -0.08, 0.03]), [0.5, -0.2, -0.9])
    pixels = all_pixels(camera)
    moved = T_query_ref[:3, :3] + np.outer(T_query_ref[:3, 3], inverse)
    homography = other.matrix @ moved @ np.linalg.inv(camera.matrix)
    found = homography @ np.column_stack([pixels, np.ones(len(pixels))]).T
    there = (found[:2] / found[2]).T
    back = seen_at(Planes(inverse[None]), camera, other, T_query_ref, there)
    assert np.allclose(back, pixels, atol=1e-9)
    uv, depth, _ = shown_at(Planes(inverse[None]), camera, other, T_query_ref, pixels)
    assert np.allclose(uv, there, atol=1e-9)
    rays, _ = camera.unproject(pixels)
    assert np.allclose((rays * depth[:, None]) @ inverse, 1.0)


@pytest.mark.parametrize("kind", SURFACES)
def test_a_ray_of_a_moved_camera_ends_at_the_first_point_of_the_surface(kind: SurfaceKind) -> None:
    keyframe = keyframe_of(kind, 3)
    T_ref_query = invert(drawn_motion(keyframe, FAR, np.random.default_rng(1)).T_query_ref)
    rays, _ = keyframe.camera.unproject(all_pixels(keyframe.camera)[::7])
    directions, centre = rays @ T_ref_query[:3, :3].T, T_ref_query[:3, 3]
    points = keyframe.surface.meet(centre, directions)
    assert np.all(np.isfinite(points))
    on = keyframe.surface.inverse_depth(points / points[:, 2:])
    assert np.allclose(on * points[:, 2], 1.0, atol=1e-9)
    for share in np.linspace(0.02, 0.99, 60):
        before = centre + share * (points - centre)
        ahead = before[:, 2] > 0
        near = keyframe.surface.inverse_depth(before[ahead] / before[ahead, 2:])
        assert np.all(near * before[ahead, 2] < 1.0)


def test_a_spline_is_that_of_scipy() -> None:
    from scipy.interpolate import BSpline

    rng = np.random.default_rng(0)
    relief = Relief(rng.uniform(0.05, 0.2, size=(7, 8)), (-0.9, -0.6), 0.25)
    xy = rng.uniform((-0.6, -0.3), (0.3, 0.3), size=(50, 2))
    # The k-th number belongs to the basis function that is centred at its place.
    along_x, along_y = (
        BSpline.design_matrix((xy[:, i] - relief.origin[i]) / 0.25, np.arange(-2.0, count + 2.0), 3).toarray()
        for i, count in enumerate((8, 7))
    )
    expected = np.einsum("nr,rc,nc->n", along_y, relief.numbers, along_x)
    assert np.allclose(relief.inverse_depth(np.column_stack([xy, np.ones(50)])), expected, atol=1e-12)


def seen_as(keyframe: Keyframe, image: Image) -> Reference:
    """The keyframe as a dataset has it."""
    return Reference("", None, image, keyframe.camera, depth=keyframe.depth().astype(np.float32))


@pytest.mark.thorough
def test_what_a_hill_hides_is_hidden_and_what_is_visible_is_hidden_by_nothing() -> None:
    numbers = np.full((9, 9), 0.08)
    numbers[3:6, 4] = 0.4
    camera = Camera("pinhole", *SIZE, 90.0, 90.0, 47.5, 35.5)
    hill = Keyframe(cube_faces(SIDES, 64, np.eye(3)), camera, Relief(numbers, (-0.8, -0.8), 0.2))
    T_query_ref = make_transform(np.eye(3), [-1.2, 0.0, 0.0])
    blank = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    found = exact_correspondences(
        hill, seen_as(hill, blank), blank, View(camera, T_query_ref), 3000, np.random.default_rng(0)
    )
    assert found.measures.similarity is None
    assert 0.05 < np.mean(~found.visible) < 0.5
    # Independently: all pixels of the keyframe, drawn into the query, of which the nearest is seen.
    uv, _, z = shown_at(hill.surface, camera, camera, T_query_ref, all_pixels(camera))
    _, _, own = shown_at(hill.surface, camera, camera, T_query_ref, found.uv_ref)
    apart = np.linalg.norm(uv[None] - found.uv_query[:, None], axis=2)
    in_front = z[None] < 0.9 * own[:, None]
    # Next to an outline, a pixel may be on either side of what is drawn.
    assert np.mean(np.any(in_front & (apart < 0.7), axis=1)[found.visible]) < 0.05
    assert np.mean(np.any(in_front & (apart < 2.5), axis=1)[~found.visible]) > 0.9


@pytest.mark.parametrize("kind", SURFACES)
@pytest.mark.parametrize("seed", range(4))
def test_a_query_shows_each_point_where_its_correspondence_says_and_no_border(kind: SurfaceKind, seed: int) -> None:
    size = (PHOTOGRAPH[0] * 5, PHOTOGRAPH[1] * 5) if seed == 3 else PHOTOGRAPH
    keyframe = keyframe_of(kind, seed, size)
    view = drawn_motion(keyframe, FAR, np.random.default_rng(seed))
    assert not np.allclose(view.T_query_ref, np.eye(4), atol=1e-3)
    reduced = Reduced.of(keyframe.faces, [coded(size)], keyframe.camera.fx)
    reference, query = view_of(reduced, keyframe), view_of(reduced, keyframe, view)
    for image in (reference, query):
        assert image[..., 2].max() < 20
    rng = np.random.default_rng(0)
    found = exact_correspondences(keyframe, seen_as(keyframe, reference), query, view, 400, rng)
    seen = found.visible
    assert found.measures.overlap is not None
    assert found.measures.overlap > 0.25
    assert found.measures.overlap_query is not None
    assert found.measures.overlap_query > 0.25
    assert np.sum(seen) > 50
    at = found.uv_query[seen].astype(np.float32)[None]
    shown = cv2.remap(query, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0].astype(float)
    stood = reference[found.uv_ref[seen, 1].astype(int), found.uv_ref[seen, 0].astype(int)].astype(float)
    # One pixel of the photograph is one or two grey levels.
    wrong = np.abs(shown - stood)[:, :2].max(axis=1)
    assert np.quantile(wrong, 0.95) <= 1.5
    assert wrong.max() <= 4


def test_a_query_that_has_not_moved_is_the_keyframe() -> None:
    keyframe = keyframe_of("relief", 2)
    noise = np.random.default_rng(0).integers(0, 256, size=(*PHOTOGRAPH[::-1], 3)).astype(np.uint8)
    reduced = Reduced.of(keyframe.faces, [noise], keyframe.camera.fx)
    same, reference = view_of(reduced, keyframe, View(keyframe.camera, np.eye(4))), view_of(reduced, keyframe)
    # Places are rounded to 1/32 pixel by OpenCV, some of them to another side.
    assert np.abs(same.astype(int) - reference).mean() < 1


def test_forward_motions_are_along_the_viewing_direction_and_no_motion_is_larger_than_asked() -> None:
    forward, far = Motions(0.3, 50.0, 8.0, 1.0), Motions(0.3, 0.2, 8.0, 0.0)
    for seed in range(12):
        keyframe = keyframe_of("street", seed)
        T_ref_query = invert(drawn_motion(keyframe, forward, np.random.default_rng(seed)).T_query_ref)
        along = T_ref_query[:3, 3] / np.linalg.norm(T_ref_query[:3, 3])
        assert abs(along[2]) > np.cos(np.radians(10))
        anyhow = drawn_motion(keyframe, far, np.random.default_rng(seed)).T_query_ref
        assert np.linalg.norm(anyhow[:3, 3]) <= 0.2 + 1e-9


def test_a_photograph_just_large_enough_serves() -> None:
    least = least_size(SIZE)
    for seed in range(5):
        keyframe = keyframe_of("plane", seed, least)
        assert keyframe.camera.fx <= keyframe.faces[0].camera.fx * (1 + 1e-9)
        assert np.all(keyframe.content(all_pixels(keyframe.camera)))
        assert drawn_motion(keyframe, FAR, np.random.default_rng(seed)).T_query_ref.shape == (4, 4)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_turns_a_photograph_as_pillow_does_and_tells_its_focal_length(orientation: int) -> None:
    image = Pillow.fromarray(coded((40, 30)))
    exif = Pillow.Exif()
    exif[0x0112] = orientation
    exif.get_ifd(0x8769)[0xA405] = 28
    stream = io.BytesIO()
    image.save(stream, "JPEG", exif=exif, quality=95)
    read = read_exif(stream.getvalue())
    assert read == Exif(orientation, 28)
    stored = Pillow.open(io.BytesIO(stream.getvalue()))
    upright = np.asarray(ImageOps.exif_transpose(stored))
    assert np.array_equal(read.upright(np.asarray(stored)), upright)
    assert read.size((40, 30)) == upright.shape[1::-1]
    # A 28 mm lens on 36 x 24 mm film sees 75.4 degrees across the diagonal.
    diagonal_deg = 2 * np.degrees(np.arctan(np.hypot(40, 30) / 2 / (read.focal_px((40, 30)) or 1)))
    assert diagonal_deg == pytest.approx(75.4, abs=0.1)


def test_damaged_exif_tells_nothing() -> None:
    stream = io.BytesIO()
    exif = Pillow.Exif()
    exif[0x0112] = 6
    Pillow.fromarray(coded((40, 30))).save(stream, "JPEG", exif=exif)
    data = stream.getvalue()
    start = data.index(b"Exif")
    for end in range(start, start + 40):
        assert read_exif(data[:end]) in (Exif(), Exif(6))
    rng = np.random.default_rng(0)
    for _ in range(300):
        spoilt = bytearray(data)
        for place in rng.integers(2, start + 60, size=4):
            spoilt[place] = rng.integers(256)
        assert 1 <= read_exif(bytes(spoilt)).orientation <= 8
    assert Exif(1, 0).focal_px((40, 30)) is None

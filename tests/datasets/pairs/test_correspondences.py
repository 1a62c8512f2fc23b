"""Warping, visibility and correspondence files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from relocbench.arrays import Array, Floats, Mask
from relocbench.datasets.pairs.correspondence_file import read_correspondences, write_correspondences
from relocbench.datasets.pairs.correspondences import (
    PairCorrespondences,
    pair_correspondences,
    spread_sample,
)
from relocbench.datasets.pairs.measures import PairMeasures, scale_change
from relocbench.datasets.pairs.visibility import CHECKS, DepthView, ReferencePoints, reference_z_buffer, see, warp
from relocbench.errors import DatasetError
from relocbench.geometry import Camera, invert, make_transform, se3_exp, so3_exp
from relocbench.tracking import KeyframePoints, Reference

PINHOLE = Camera("pinhole", 160, 120, 120.0, 120.0, 79.5, 59.5)
RADTAN = Camera("radtan", 160, 120, 118.0, 121.0, 78.0, 61.0, (-0.2, 0.05, 0.001, -0.001))
FISHEYE = Camera("equidistant", 160, 120, 70.0, 71.0, 80.0, 58.0, (0.01, -0.02, 0.003, 0.0))

WALL, POST = 10.0, 4.0
"""metres: a wall, and a post before it"""


def world_depth(camera: Camera, x: float) -> Floats:
    """Exact depth, seen from (x, 0, 0) straight ahead, of the wall with the post |X| < 0.4 before it."""
    u = np.arange(camera.width)
    on_post = np.abs((u - camera.cx) / camera.fx * POST + x) < 0.4
    return np.tile(np.where(on_post, POST, WALL).astype(np.float32), (camera.height, 1))


def reference_at(x: float, depth: Floats | None = None) -> Reference:
    image = np.zeros((PINHOLE.height, PINHOLE.width), dtype=np.uint8)
    return Reference("r", 0, image, PINHOLE, depth=world_depth(PINHOLE, x) if depth is None else depth)


def hidden_behind_post(u_ref: Array, x_query: float) -> Mask:
    """Whether the post stands between the query at x and the wall point that pixel u of the reference at 0 sees."""
    wall_x = (u_ref - PINHOLE.cx) / PINHOLE.fx * WALL
    at_post = x_query + (wall_x - x_query) * POST / WALL
    return np.asarray(np.abs(at_post) < 0.4)


@pytest.mark.parametrize("camera_ref", [PINHOLE, RADTAN, FISHEYE])
@pytest.mark.parametrize("camera_query", [PINHOLE, RADTAN, FISHEYE])
@given(seed=st.integers(0, 10_000))
def test_a_warp_and_its_inverse_come_back(camera_ref: Camera, camera_query: Camera, seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_query_ref = se3_exp(rng.normal(scale=0.1, size=6))
    pixels = rng.uniform([20, 20], [140, 100], size=(30, 2))
    depth = rng.uniform(2, 50, size=30)
    there, z, valid = warp(np.column_stack([pixels, depth]), camera_ref, camera_query, T_query_ref)
    assert valid.sum() > 20
    moved = np.column_stack([there, z])[valid]
    back, z_back, valid_back = warp(moved, camera_query, camera_ref, invert(T_query_ref))
    np.testing.assert_allclose(back[valid_back], pixels[valid][valid_back], atol=1e-6)
    np.testing.assert_allclose(z_back[valid_back], depth[valid][valid_back], atol=1e-8)


def test_a_point_behind_the_query_has_no_pixel() -> None:
    uv, _, valid = warp([[80, 60, 1.0]], PINHOLE, PINHOLE, make_transform(np.eye(3), [0, 0, -2]))
    assert not valid[0]
    assert np.all(np.isnan(uv))


@pytest.mark.parametrize("query_has_depth", [True, False])
def test_what_the_post_hides_is_not_visible(query_has_depth: bool) -> None:
    reference, x = reference_at(0.0), 1.0
    T_query_ref = make_transform(np.eye(3), [-x, 0, 0])
    query = DepthView(PINHOLE, world_depth(PINHOLE, x) if query_has_depth else None)
    points = ReferencePoints.of(reference)
    seen = see(points, T_query_ref, DepthView(PINHOLE, reference.depth), query)
    on_wall = points.depth == WALL
    hidden = on_wall & hidden_behind_post(points.uv[:, 0], x)
    assert np.any(hidden & seen.inside)
    # An edge of the post falls between pixels: one pixel either side of it may go either way.
    near_edge = hidden_behind_post(points.uv[:, 0] + 2, x) != hidden_behind_post(points.uv[:, 0] - 2, x)
    judged = seen.inside & ~near_edge
    np.testing.assert_array_equal(seen.visible[judged], ~hidden[judged])
    wanted = "both" if query_has_depth else "self"
    assert {CHECKS[c] for c in seen.check[seen.inside]} == {wanted}


def test_a_slanted_surface_does_not_hide_itself() -> None:
    # A ground plane 1.5 m below the camera, to 15 m: the steepest depth there is on a road. Level motion leaves its
    # depth image as it is.
    v = np.arange(PINHOLE.height)
    row = np.where(v > PINHOLE.cy + 12, 1.5 * PINHOLE.fy / np.maximum(v - PINHOLE.cy, 1e-3), 0.0)
    depth = np.tile(row[:, None].astype(np.float32), (1, PINHOLE.width))
    reference = reference_at(0.0, depth)
    T_query_ref = make_transform(np.eye(3), [0.1, 0, -0.8])
    for query in (DepthView(PINHOLE), DepthView(PINHOLE, depth)):
        seen = see(ReferencePoints.of(reference), T_query_ref, DepthView(PINHOLE, depth), query)
        assert np.mean(seen.visible[seen.inside]) > 0.99


def test_a_z_buffer_stays_closed_when_the_query_comes_near() -> None:
    reference = reference_at(0.0, np.full((120, 160), 6.0, dtype=np.float32))
    T_query_ref = make_transform(np.eye(3), [0, 0, -3.5])
    buffer = reference_z_buffer(T_query_ref, DepthView(PINHOLE, reference.depth), DepthView(PINHOLE))
    assert np.all(np.isfinite(buffer[5:-5, 5:-5]))


def test_a_sparse_keyframe_against_a_query_without_depth_is_checked_by_nothing() -> None:
    points = KeyframePoints(np.array([[80.0, 60.0], [1.0, 60.0]]), np.array([0.1, 0.1]), np.array([0.001, 0.001]))
    image = np.zeros((120, 160), dtype=np.uint8)
    reference = Reference("r", 0, image, PINHOLE, sparse_points=points)
    rng = np.random.default_rng(0)
    found = pair_correspondences(
        reference, make_transform(np.eye(3), [-1.0, 0, 0]), DepthView(PINHOLE), count=10, rng=rng
    )
    assert len(found) == 1  # the other one left the image
    assert [CHECKS[c] for c in found.check] == ["none"]
    assert found.measures.overlap == 0.5


def test_a_sparse_keyframe_is_checked_against_the_querys_depth() -> None:
    points = KeyframePoints(np.array([[80.0, 60.0], [30.0, 60.0]]), np.array([0.1, 0.2]), np.full(2, 0.0005))
    image = np.zeros((120, 160), dtype=np.uint8)
    reference = Reference("r", 0, image, PINHOLE, sparse_points=points)
    query = DepthView(PINHOLE, np.full((120, 160), 10.0, dtype=np.float32))
    seen = see(ReferencePoints.of(reference), np.eye(4), DepthView(PINHOLE), query)
    assert seen.visible.tolist() == [True, False]
    assert [CHECKS[c] for c in seen.check] == ["both", "both"]


def test_overlap_is_the_share_of_the_reference_that_the_query_sees() -> None:
    reference = reference_at(0.0, np.full((120, 160), 10.0, dtype=np.float32))
    # 2.96 m to the right at 10 m is 35.52 px: 36 of 160 columns leave the image.
    T_query_ref = make_transform(np.eye(3), [-2.96, 0, 0])
    found = pair_correspondences(reference, T_query_ref, DepthView(PINHOLE), 100, np.random.default_rng(0))
    assert found.measures.overlap == pytest.approx(124 / 160, abs=1e-9)
    assert found.measures.scale_change is not None
    assert 1.0 < found.measures.scale_change < 1.1
    assert len(found) == 100


@pytest.mark.parametrize(
    ("camera", "T_query_ref", "expected"),
    [
        (PINHOLE, make_transform(np.eye(3), [0, 0, -5.0]), 2.0),  # from 10 m to 5 m
        (PINHOLE, make_transform(np.eye(3), [0, 0, 10.0]), 2.0),  # from 10 m to 20 m
        (PINHOLE.scaled(1.5), np.eye(4), 1.5),
        (PINHOLE.scaled(2.0), make_transform(np.eye(3), [0, 0, 10.0]), 1.0),
        (PINHOLE, make_transform(so3_exp([0.0, 0.4, 0.0]), np.zeros(3)), 1.0),
    ],
)
def test_a_change_of_scale_is_of_distance_and_focal_length_and_not_of_direction(
    camera: Camera, T_query_ref: Array, expected: float
) -> None:
    centre = np.array([[PINHOLE.cx, PINHOLE.cy]])
    assert scale_change(centre, np.array([10.0]), PINHOLE, camera, T_query_ref) == pytest.approx(expected, rel=1e-9)


def test_a_change_of_scale_is_the_median_and_the_same_both_ways() -> None:
    T_query_ref = se3_exp(np.array([0.3, -0.2, -1.5, 0.02, 0.05, -0.01]))
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(20, 140, (51, 2)), rng.uniform(4, 20, 51)])
    there, depth, valid = warp(points, PINHOLE, RADTAN, T_query_ref)
    assert valid.all()
    forth = scale_change(points[:, :2], points[:, 2], PINHOLE, RADTAN, T_query_ref)
    back = scale_change(there, depth, RADTAN, PINHOLE, invert(T_query_ref))
    assert forth == pytest.approx(back, rel=1e-6)
    each = [scale_change(p[None, :2], p[2:], PINHOLE, RADTAN, T_query_ref) for p in points]
    assert forth == pytest.approx(float(np.median(np.array(each, dtype=np.float64))))
    assert scale_change(points[:0, :2], points[:0, 2], PINHOLE, RADTAN, T_query_ref) is None


def test_samples_are_spread_and_repeatable() -> None:
    # Nine in ten of the candidates crowd into one corner.
    rng = np.random.default_rng(1)
    crowd, rest = rng.uniform(0, 10, (9000, 2)), rng.uniform([0, 0], [159, 119], (1000, 2))
    pixels = np.concatenate([crowd, rest])
    rows = spread_sample(pixels, PINHOLE, 500, np.random.default_rng(7))
    assert np.mean(rows < 9000) < 0.05
    assert np.all(np.diff(rows) > 0)
    np.testing.assert_array_equal(rows, spread_sample(pixels, PINHOLE, 500, np.random.default_rng(7)))
    assert not np.array_equal(rows, spread_sample(pixels, PINHOLE, 500, np.random.default_rng(8)))


def some_rows(count: int, start: float) -> PairCorrespondences:
    values = np.arange(count, dtype=np.float64) + start
    uv = np.column_stack([values, values + 0.5])
    check = (np.arange(count) % 3).astype(np.int8)
    return PairCorrespondences(uv, values + 1, uv + 2, np.arange(count) % 2 == 0, check, PairMeasures(0.5))


def test_a_file_gives_back_what_was_written_all_or_one_pair(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    pairs = [((10, 20), some_rows(5, 0)), ((10, 30), some_rows(0, 0)), ((11, 20), some_rows(4, 100))]
    write_correspondences(path, pairs)
    whole = read_correspondences(path)
    assert whole.ref_timestamp_ns.tolist() == [10] * 5 + [11] * 4
    one = read_correspondences(path, (11, 20))
    assert one.query_timestamp_ns.tolist() == [20] * 4
    np.testing.assert_array_equal(one.uv_ref, some_rows(4, 100).uv_ref)
    np.testing.assert_array_equal(one.uv_query, some_rows(4, 100).uv_query)
    np.testing.assert_array_equal(one.depth_ref, some_rows(4, 100).depth_ref)
    assert one.visible.tolist() == [True, False, True, False]
    assert one.check == ("both", "self", "none", "both")
    assert len(read_correspondences(path, (10, 30))) == 0


def test_half_a_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    write_correspondences(path, [((1, 2), some_rows(50, 0))])
    path.write_bytes(path.read_bytes()[:-20])
    with refused(DatasetError, path, None, "whole"):
        read_correspondences(path)
    path.unlink()
    with refused(DatasetError, path, None, "missing"):
        read_correspondences(path)


@pytest.mark.parametrize(
    ("column", "values", "names"),
    [
        ("depth_ref", None, ("columns", "depth_ref")),
        ("depth_ref", pa.array([1, 2], pa.int32()), ("depth_ref", "int32", "float")),
        ("depth_ref", pa.array([1.0, None], pa.float32()), ("depth_ref", "1 rows")),
    ],
)
def test_a_column_that_does_not_fit_is_named(
    tmp_path: Path, column: str, values: pa.Array | None, names: tuple[str, ...]
) -> None:
    path = tmp_path / "a.parquet"
    write_correspondences(path, [((1, 2), some_rows(2, 0))])
    table = pq.read_table(path)
    at = table.column_names.index(column)
    pq.write_table(table.remove_column(at) if values is None else table.set_column(at, column, values), path)
    with refused(DatasetError, path, None, *names):
        read_correspondences(path)

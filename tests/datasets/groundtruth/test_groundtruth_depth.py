"""Depth drawn from lidar submaps: closed walls hide, holes stay holes, sigma is honest, stereo agrees."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from refusals import refused

from relocbench.arrays import Array, Floats
from relocbench.datasets.groundtruth.depth.depth import (
    DepthImage,
    DepthNoise,
    DepthOptions,
    fit_sigma,
    make_scene,
    scene_depth,
)
from relocbench.datasets.groundtruth.depth.stereo import (
    cross_check,
    rectified,
)
from relocbench.datasets.groundtruth.depth.surfels import SECTORS, SurfelOptions, make_surfels
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.pairs.correspondence_file import read_correspondences, write_correspondences
from relocbench.datasets.pairs.correspondences import PairCorrespondences, pair_correspondences, pixel_sigma
from relocbench.datasets.pairs.measures import PairMeasures
from relocbench.datasets.pairs.visibility import DepthView, ReferencePoints, warp
from relocbench.errors import ConfigError
from relocbench.geometry import Camera, apply, invert, make_transform, se3_exp
from relocbench.tracking import Reference

CAMERA = Camera("pinhole", 320, 240, 245.0, 245.0, 159.5, 119.5)
T_NODE_CAM = make_transform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), [0, 0, 1.5])
"""node: x forward, y left, z up, on the road"""
T_CAM_NODE = invert(T_NODE_CAM)
EXACT = DepthNoise(range_m=1e-3, surface_m=0.0, along_per_m=0.0, across_per_m=0.0)
THROUGH_ALL = DepthOptions(noise=EXACT, through_m=np.inf)
"""no sight line ends in a shadow"""
Rectangle = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
"""a corner and two sides"""

ROAD: Rectangle = ((1.0, -8.0, 0.0), (24.0, 0, 0), (0, 16.0, 0))
END: Rectangle = ((20.0, -8.0, 0.0), (0, 16.0, 0), (0, 0, 8.0))
LEFT: Rectangle = ((1.0, 6.0, 0.0), (19.0, 0, 0), (0, 0, 8.0))
SCREEN: Rectangle = ((10.0, -2.0, 0.0), (0, 3.0, 0), (0, 0, 3.0))


def sampled(
    rectangles: list[Rectangle],
    spacing: tuple[float, float] = (0.1, 0.16),
    noise: float = 0.0,
    seed: int = 0,
    back_m: float = 4.0,
) -> Submap:
    """Points of rectangles in lines, as a push-broom scanner leaves them, seen from the road ``back_m`` before each."""
    rng = np.random.default_rng(seed)
    points, normals = [], []
    for corner, a, b in (np.asarray(r, dtype=float) for r in rectangles):
        lengths = np.linalg.norm(a), np.linalg.norm(b)
        s, t = np.meshgrid(*(np.arange(d / 2, n, d) / n for d, n in zip(spacing, lengths, strict=True)))
        grid = corner + s.reshape(-1, 1) * a + t.reshape(-1, 1) * b
        normal = np.cross(a, b) / np.prod(lengths)
        points.append(grid + rng.normal(scale=max(noise, 1e-12), size=(len(grid), 1)) * normal)
        normals.append(np.repeat(normal[None], len(grid), 0))
    p, n = np.concatenate(points), np.concatenate(normals)
    origins = np.column_stack([np.clip(p[:, 0] - back_m, 0, None), np.zeros(len(p)), np.full(len(p), 1.0)])
    n = np.where(np.einsum("ni,ni->n", n, origins - p)[:, None] < 0, -n, n)
    return as_submap(p, n, origins)


def submap_depth(
    submap: Submap, camera: Camera, T_cam_node: np.ndarray, options: DepthOptions | None = None
) -> DepthImage:
    return scene_depth(make_scene(submap, options), camera, T_cam_node, options)


def as_submap(points: NDArray[np.floating], normals: NDArray[np.floating], origins: NDArray[np.floating]) -> Submap:
    count = len(points)
    p, n, o = (a.astype(np.float32) for a in (points, normals, origins))
    return Submap(p, n, o, np.zeros(count, np.uint8), np.ones(count, np.float32), np.zeros(count, np.int32))


def joined(*submaps: Submap) -> Submap:
    names = ("points", "normals", "origins", "surface", "steady", "block")
    return Submap(*(np.concatenate([getattr(s, n) for s in submaps]) for n in names))


def exact(rectangles: list[Rectangle], T_node_cam: Array = T_NODE_CAM) -> Floats:
    """Depth along z of rectangles by intersecting each pixel's ray, 0 where there is none."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], -1)
    directions = rays @ T_node_cam[:3, :3].T
    nearest = np.full(u.shape, np.inf)
    for corner, a, b in (np.asarray(r, dtype=float) for r in rectangles):
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = ((corner - T_node_cam[:3, 3]) @ np.cross(a, b)) / (directions @ np.cross(a, b))
            on = T_node_cam[:3, 3] + depth[..., None] * directions - corner
        s, t = on @ a / (a @ a), on @ b / (b @ b)
        inside = (depth > 0) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
        nearest = np.where(inside & (depth < nearest), depth, nearest)
    return np.where(np.isfinite(nearest), nearest, 0).astype(np.float32)


@pytest.mark.thorough
def test_a_scanned_street_is_closed_and_exact() -> None:
    truth = exact([ROAD, END, LEFT])
    found = submap_depth(sampled([ROAD, END, LEFT]), CAMERA, T_CAM_NODE, DepthOptions(noise=EXACT))
    both = (truth > 0) & (found.depth > 0)
    assert both.sum() > 0.95 * (truth > 0).sum()
    error = np.abs(found.depth - truth)[both]
    assert np.percentile(error, 99) < 0.02


def test_nothing_is_seen_through_a_wall() -> None:
    truth = exact([SCREEN])
    found = submap_depth(sampled([ROAD, END, LEFT, SCREEN]), CAMERA, T_CAM_NODE, DepthOptions(noise=EXACT))
    on_screen = truth > 0
    # The outermost points lie up to 8 cm inside the screen's rim.
    within = exact([((10.0, -1.9, 0.0), (0, 2.8, 0), (0, 0, 2.9))]) > 0
    assert not (within & (found.depth > 10.5)).any()
    assert (found.depth[on_screen] > 0).mean() > 0.95
    # What is covered beyond the screen's rim is less than a third of the way between points.
    whole = exact([ROAD, END, LEFT, SCREEN])
    bleeding = (found.depth > 0) & (whole > 10.5) & (found.depth < 10.5) & (whole > 0)
    assert bleeding.sum() < 0.02 * on_screen.sum()


def test_a_wall_scanned_with_large_gaps_shows_no_background_and_invents_no_surface() -> None:
    # Beams every 0.8 m: further apart than points of a closed surface, nearer than what a hole may show.
    sparse = sampled([SCREEN], spacing=(0.1, 0.8))
    found = submap_depth(joined(sampled([END]), sparse), CAMERA, T_CAM_NODE, THROUGH_ALL)
    inner = exact([((10.0, -1.7, 0.5), (0, 2.4, 0), (0, 0, 2.0))]) > 0
    assert not (found.depth[inner] > 10.5).any()
    assert (found.depth[inner] > 0).mean() < 0.6


def test_a_gap_wider_than_a_window_is_seen_through() -> None:
    posts = [((10.0, y, 0.0), (0, 0.6, 0), (0, 0, 3.0)) for y in (-2.6, 1.6)]
    found = submap_depth(sampled([END, *posts]), CAMERA, T_CAM_NODE, DepthOptions(noise=EXACT))
    gap = exact([((10.0, -1.8, 1.0), (0, 3.2, 0), (0, 0, 1.6))]) > 0
    assert (np.abs(found.depth[gap] - 20.0) < 0.1).mean() > 0.95


def test_the_side_of_a_box_that_was_never_scanned_does_not_show_what_is_behind() -> None:
    # A parked car's side and roof are seen from the road; its front, towards the camera, is not.
    side: Rectangle = ((6.0, 2.0, 0.2), (4.0, 0, 0), (0, 0, 1.5))
    wall: Rectangle = ((1.0, 6.0, 0.0), (19.0, 0, 0), (0, 0, 4.0))
    scene = sampled([side, wall], back_m=0.5)
    # The wall's points behind the car were not seen from beside it.
    behind = (scene.points[:, 1] > 5) & (np.abs(scene.points[:, 0] - 8) < 2) & (scene.points[:, 2] < 2.4)
    names = ("points", "normals", "origins", "surface", "steady", "block")
    scene = Submap(*(getattr(scene, n)[~behind] for n in names))
    front = exact([((6.0, 2.2, 0.4), (0, 1.4, 0), (0, 0, 1.0))]) > 0
    seeing = submap_depth(scene, CAMERA, T_CAM_NODE, THROUGH_ALL)
    found = submap_depth(scene, CAMERA, T_CAM_NODE, DepthOptions(noise=EXACT))
    assert (seeing.depth[front] > 7).mean() > 0.2
    assert (found.depth[front] > 7).mean() < 0.1 * (seeing.depth[front] > 7).mean()


def test_unsteady_points_are_left_out() -> None:
    screen = sampled([SCREEN])
    gone = replace(screen, steady=np.zeros(len(screen), np.float32))
    found = submap_depth(joined(sampled([END]), gone), CAMERA, T_CAM_NODE, THROUGH_ALL)
    upper = exact([((10.0, -2.0, 1.0), (0, 3.0, 0), (0, 0, 2.0))]) > 0
    assert (np.abs(found.depth[upper] - 20.0) < 0.1).all()


def test_points_without_a_plane_before_a_wall_hide_it() -> None:
    rng = np.random.default_rng(0)
    leaves = rng.uniform([9.5, -1.5, 1.0], [10.5, 1.5, 3.0], (1500, 3))
    bush = as_submap(leaves, np.zeros((1500, 3)), np.tile([8.0, 0.0, 1.0], (1500, 1)))
    options = DepthOptions(noise=EXACT, surfels=SurfelOptions(adopt_m=0.0))
    found = submap_depth(joined(sampled([END]), bush), CAMERA, T_CAM_NODE, options)
    inner = exact([((10.0, -1.2, 1.3), (0, 2.4, 0), (0, 0, 1.4))]) > 0
    assert (found.depth[inner] > 15).mean() < 0.05


def test_a_surface_scanned_twice_and_a_little_apart_becomes_one() -> None:
    # 3 cm between the visits, as odometry drifts.
    again = replace(sampled([END], seed=1), points=sampled([END]).points + np.array([0.03, 0.05, 0.08], np.float32))
    options = DepthOptions(noise=DepthNoise(0.01, 0.0, 0.0, 0.001, 0.0))
    found = submap_depth(joined(sampled([END]), again), CAMERA, T_CAM_NODE, options)
    inner = exact([((20.0, -6.0, 1.0), (0, 12.0, 0), (0, 0, 5.0))]) > 0
    depth = found.depth[inner]
    assert (depth > 0).all()
    assert abs(np.median(depth) - 20.015) < 0.005
    assert depth.std() < 0.012


def test_depth_agrees_with_rays_cast_against_the_surfels_triangles() -> None:
    submap = sampled([ROAD, END, LEFT, SCREEN], noise=0.01)
    surfels = make_surfels(submap)
    vertices, triangles = star_triangles(surfels.points, surfels.normals, surfels.axes, surfels.reach)
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(triangles))
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], -1)
    origins = np.broadcast_to(T_NODE_CAM[:3, 3], rays.shape)
    cast = np.concatenate([origins, rays @ T_NODE_CAM[:3, :3].T], -1).astype(np.float32)
    hit = scene.cast_rays(o3d.core.Tensor.from_numpy(cast))["t_hit"].numpy()
    found = submap_depth(submap, CAMERA, T_CAM_NODE)
    both = np.isfinite(hit) & (found.depth > 0)
    assert both.sum() > 0.9 * (found.depth > 0).sum()
    # The rays meet the very first star, the z-buffer takes the mean of those that agree.
    difference = np.abs(found.depth - hit)[both]
    assert (difference < 5 * found.sigma[both] + 0.02).mean() > 0.995
    assert np.median(difference) < 0.02


def star_triangles(points: Floats, normals: Floats, axes: Floats, reach: Floats) -> tuple[Floats, NDArray[np.uint32]]:
    shown = reach.max(axis=1) > 0
    points, normals, axes, reach = points[shown], normals[shown], axes[shown], reach[shown]
    angle = 2 * np.pi * np.arange(SECTORS) / SECTORS
    across = np.cross(normals, axes)
    rim = np.cos(angle)[:, None] * axes[:, None] + np.sin(angle)[:, None] * across[:, None]
    corners = points[:, None] + reach[:, :, None] * rim
    vertices = np.concatenate([points[:, None], corners], axis=1).reshape(-1, 3).astype(np.float32)
    k = np.arange(SECTORS)
    fan = np.stack([np.zeros(SECTORS, int), 1 + k, 1 + (k + 1) % SECTORS], axis=1)
    triangles = (fan[None] + 9 * np.arange(len(points))[:, None, None]).reshape(-1, 3)
    return vertices, triangles.astype(np.uint32)


def test_sigma_is_that_of_the_errors() -> None:
    noise = DepthNoise(0.02, 0.0, 0.05, 0.0, 0.0)
    truth = exact([ROAD, END, LEFT])
    squares = []
    for seed in range(3):
        found = submap_depth(
            sampled([ROAD, END, LEFT], noise=0.02, seed=seed), CAMERA, T_CAM_NODE, DepthOptions(noise=noise)
        )
        known = (truth > 0) & (found.depth > 0)
        scaled = (found.depth - truth)[known] / found.sigma[known]
        squares.append(np.mean(scaled[np.abs(scaled) < 5] ** 2))
    assert 0.5 < np.mean(squares) < 2.0


def test_drift_of_odometry_makes_far_depth_uncertain() -> None:
    still = submap_depth(sampled([END]), CAMERA, T_CAM_NODE, DepthOptions(noise=EXACT))
    drifting = submap_depth(
        sampled([END]), CAMERA, T_CAM_NODE, DepthOptions(noise=DepthNoise(1e-3, 0.0, 0.05, 0.01, 0.0))
    )
    middle = (120, 160)
    assert still.sigma[middle] < 0.002
    # The end of the street was scanned 16 m further on.
    assert drifting.sigma[middle] == pytest.approx(0.01 * 16.0, rel=0.02)


def test_the_fitted_model_gives_back_the_sigma_it_was_made_of() -> None:
    depth = np.linspace(2, 60, 48 * 64).reshape(48, 64).astype(np.float32)
    image = DepthImage(depth, (0.01 + 0.002 * depth + 0.0003 * depth**2).astype(np.float32))
    a, b, c = fit_sigma([image, image])
    z = np.array([5.0, 20.0, 50.0])
    np.testing.assert_allclose(a + b * z + c * z * z, 0.01 + 0.002 * z + 0.0003 * z * z, rtol=0.01)
    assert fit_sigma([DepthImage(np.zeros((4, 4), np.float32), np.zeros((4, 4), np.float32))]) == (0, 0, 0)


def test_the_same_submap_gives_the_same_bytes() -> None:
    submap = sampled([ROAD, END, LEFT, SCREEN], noise=0.01)
    first, second = (submap_depth(submap, CAMERA, T_CAM_NODE) for _ in range(2))
    assert first.depth.tobytes() == second.depth.tobytes()
    assert first.sigma.tobytes() == second.sigma.tobytes()


def test_an_empty_submap_has_no_depth() -> None:
    empty = as_submap(*(np.zeros((0, 3)) for _ in range(3)))
    assert submap_depth(empty, CAMERA, T_CAM_NODE).coverage == 0


def test_a_camera_with_distortion_is_refused() -> None:
    bent = Camera("radtan", 320, 240, 245.0, 245.0, 159.5, 119.5, (-0.2, 0.05, 0.0, 0.0))
    with refused(ConfigError, "", None, "pinhole"):
        submap_depth(sampled([END]), bent, T_CAM_NODE)


def test_agreement_is_in_pixels_of_disparity() -> None:
    lidar = np.full((10, 10), 10.0, np.float32)
    stereo = lidar.copy()
    stereo[:, :3] = 245.0 * 0.5 / (245.0 * 0.5 / 10 + 2)  # two pixels nearer
    stereo[:, 3] = 0
    found = cross_check(lidar, stereo, CAMERA, 0.5)
    assert found.pixels == 90
    assert found.median_px == pytest.approx(0.0, abs=1e-6)
    assert found.within_1px == pytest.approx(60 / 90)
    assert found.within_3px == 1.0
    assert cross_check(lidar, lidar * 0, CAMERA, 0.5).pixels == 0


def test_a_pair_that_is_not_rectified_is_refused() -> None:
    aside = make_transform(np.eye(3), [-0.5, 0, 0])
    assert rectified(CAMERA, CAMERA, aside).focal_baseline == pytest.approx(122.5)
    for wrong in (invert(aside), se3_exp([-0.5, 0, 0, 0.02, 0, 0]), make_transform(np.eye(3), [-0.5, 0.1, 0])):
        with refused(ConfigError):
            rectified(CAMERA, CAMERA, wrong)


@pytest.mark.thorough
def test_sigma_of_pixels_is_the_spread_of_warped_pixels() -> None:
    rng = np.random.default_rng(3)
    T_query_ref = se3_exp([0.3, -0.1, -1.0, 0.02, 0.1, -0.03])
    uv, depth = np.array([[80.0, 60.0], [250.0, 200.0], [160.0, 120.0]]), np.array([6.0, 12.0, 30.0])
    points = ReferencePoints(uv, depth, np.array([0.05, 0.2, 0.4]))
    sigma = pixel_sigma(points, CAMERA, CAMERA, T_query_ref, 0.02, 0.002)
    moved = []
    for _ in range(4000):
        xi = np.concatenate([rng.normal(scale=0.02, size=3), rng.normal(scale=0.002, size=3)])
        z = depth + points.sigma * rng.normal(size=3)
        moved.append(warp(np.column_stack([uv, z]), CAMERA, CAMERA, se3_exp(xi) @ T_query_ref)[0])
    spread = [np.sqrt(np.linalg.eigvalsh(np.cov(np.array(moved)[:, i].T))[1]) for i in range(3)]
    np.testing.assert_allclose(sigma, spread, rtol=0.06)
    hidden = ReferencePoints(uv, np.full(3, 0.5), np.full(3, 0.1))
    assert np.isnan(pixel_sigma(hidden, CAMERA, CAMERA, T_query_ref)).all()


def test_correspondences_from_submap_depth_tell_what_a_wall_hides() -> None:
    rectangles = [ROAD, END, LEFT, SCREEN]
    submap, aside = sampled(rectangles, noise=0.01), make_transform(np.eye(3), [0, 1.5, 0])
    T_node_query = aside @ T_NODE_CAM
    ref, query = (submap_depth(submap, CAMERA, invert(T)) for T in (T_NODE_CAM, T_node_query))
    model = fit_sigma([ref, query])
    reference = Reference("r", 0, np.zeros((240, 320), np.uint8), CAMERA, depth=ref.depth, depth_sigma=model)
    T_query_ref = invert(T_node_query) @ T_NODE_CAM
    found = pair_correspondences(
        reference, T_query_ref, DepthView(CAMERA, query.depth, model), 2000, np.random.default_rng(0), (0.02, 0.001)
    )
    # The truth: is the query's exact depth that of the point?
    truth = exact(rectangles, T_node_query)
    u, v = np.rint(found.uv_query).astype(int).T
    rays, _ = CAMERA.unproject(found.uv_ref)
    z = apply(T_query_ref, rays * found.depth_ref[:, None])[:, 2]
    visible = np.abs(truth[v, u] - z) < 0.1 * z
    assert (found.visible & ~visible).sum() < 0.01 * len(found)
    assert (found.visible == visible).mean() > 0.95
    assert (~visible).sum() >= 20
    assert found.sigma_px is not None
    assert np.isfinite(found.sigma_px).all()
    assert (found.sigma_px > 0.2).all()


def test_files_tell_the_sigma_of_pixels_where_they_have_one(tmp_path: Path) -> None:
    uv = np.arange(6.0).reshape(3, 2)
    rows = PairCorrespondences(uv, uv[:, 0] + 1, uv, np.ones(3, bool), np.zeros(3, np.int8), PairMeasures(1.0))
    known = replace(rows, sigma_px=np.array([0.5, 1.0, 2.0]))
    write_correspondences(tmp_path / "a.parquet", [((1, 2), rows), ((1, 3), known)], sigma=True)
    write_correspondences(tmp_path / "b.parquet", [((1, 2), rows)])
    found = read_correspondences(tmp_path / "a.parquet").sigma_px
    np.testing.assert_array_equal(found, [np.nan, np.nan, np.nan, 0.5, 1.0, 2.0])
    assert read_correspondences(tmp_path / "b.parquet").sigma_px is None

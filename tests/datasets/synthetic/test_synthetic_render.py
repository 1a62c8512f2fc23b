"""The renderer against independent geometry, and one factor at a time."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, TypedDict

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refused

from relocbench.arrays import Array, Indices, Mask
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS, Factors
from relocbench.datasets.synthetic.renderer.lamps import (
    NIGHT_LUX,
    Beam,
    headlight_irradiance,
    make_lamps,
    strongest_lamp,
)
from relocbench.datasets.synthetic.renderer.render import Frame, Renderer
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.network import LANE_M
from relocbench.errors import ConfigError
from relocbench.geometry import Camera

SIZE = 96
CAMERA = Camera("pinhole", SIZE, SIZE, 60.0, 60.0, (SIZE - 1) / 2, (SIZE - 1) / 2)
QUIET = {"read_noise": 0.0, "shot_noise": 0.0, "vignetting": 0.0}
CLEAR = Factors(sun_elevation_deg=40, sun_azimuth_deg=135, auto_exposure=False, **QUIET)
ROAD, WALL, BLOCK = 0, 7, 9


class Changes(TypedDict, total=False):
    """Factors that a test sets apart from ``CLEAR``."""

    cloud_cover: float
    exposure_ev: float
    fog_density: float
    gamma: float
    headlights: bool
    lens_drops: float
    puddles: float
    rain_mm_h: float
    snow_cover: float
    street_lamps: bool
    sun_elevation_deg: float
    wetness: float


def quad(corner: Array, a: Array, b: Array, material: Material, semantic: Semantic, instance: int) -> Mesh:
    """The parallelogram corner + s a + t b, seen from the side of a x b."""
    vertices = np.array([corner, corner + a, corner + a + b, corner + b], dtype=np.float32)
    along, up = np.linalg.norm(a), np.linalg.norm(b)
    uv = np.array([[0, 0], [along, 0], [along, up], [0, up]], dtype=np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)

    def full(value: int, kind: type) -> NDArray[Any]:
        return np.full(2, value, dtype=kind)

    return Mesh(
        vertices,
        triangles,
        uv[triangles.astype(int)],
        full(material, np.uint8),
        full(semantic, np.uint8),
        full(instance, np.uint32),
        full(instance * 17, np.uint32),
        np.zeros(2, dtype=np.float32),
    )


def block(low: Array, high: Array, material: Material, instance: int) -> Mesh:
    x, y, z = np.diag(high - low)
    sides = [(low, x, z), (low + x + y, -x, z), (low + y, -y, z), (low + x, y, z), (low + z, x, y)]
    return merge([quad(c, a, b, material, Semantic.BUILDING, instance) for c, a, b in sides])


@lru_cache
def street() -> Mesh:
    """A road, a wall of bricks beside it and a block of concrete on it."""
    road = quad(
        np.array([-60.0, -60, 0]),
        np.array([120.0, 0, 0]),
        np.array([0, 120.0, 0]),
        Material.ASPHALT,
        Semantic.ROAD,
        ROAD,
    )
    wall = quad(
        np.array([-5.0, 6, 0]), np.array([60.0, 0, 0]), np.array([0.0, 0, 8]), Material.BRICK, Semantic.BUILDING, WALL
    )
    return merge([road, wall, block(np.array([9.0, -3, 0]), np.array([11.0, -1, 2]), Material.CONCRETE, BLOCK)])


def pose(x: float = 0.0, y: float = 0.3, z: float = 1.6, yaw: float = 0.05, pitch: float = -0.08) -> Array:
    """T_world_cam of a camera that looks along x, turned."""
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = x, y, z
    return T


@lru_cache
def renderer(factors: Factors = CLEAR) -> Renderer:
    return Renderer(street(), factors, np.array([[6.0, 3.0, 5.5]]), 3)


def shot(T_world_cam: Array | None = None, seed: int = 1, camera: Camera = CAMERA, **factors: object) -> Frame:
    chosen = Factors.model_validate({**CLEAR.model_dump(), **factors})
    return renderer(chosen).render(camera, pose() if T_world_cam is None else T_world_cam, seed)


def grey(frame: Frame) -> Array:
    out: Array = frame.rgb.astype(float).mean(axis=2)
    return out


def shown_points(frame: Frame, T_world_cam: Array) -> Array:
    """World points (SIZE, SIZE, 3) that the pixels of ``CAMERA`` show."""
    v, u = np.mgrid[:SIZE, :SIZE].astype(float)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], -1)
    points: Array = (rays * frame.depth[..., None]) @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]
    return points


def by_hand(mesh: Mesh, camera: Camera, T_world_cam: Array) -> tuple[Array, Indices]:
    """Depth and triangle of each pixel by trying all triangles in double precision (Moeller-Trumbore)."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1).reshape(-1, 3)
    d, o = rays @ T_world_cam[:3, :3].T, T_world_cam[:3, 3]
    depth, which = np.full(len(d), np.inf), np.full(len(d), -1)
    for t, corners in enumerate(mesh.vertices.astype(float)[mesh.triangles]):
        a, e1, e2 = corners[0], corners[1] - corners[0], corners[2] - corners[0]
        p = np.cross(d, e2)
        det = p @ e1
        with np.errstate(all="ignore"):
            s = p @ (o - a) / det
            q = np.cross(o - a, e1)
            r, z = d @ q / det, (e2 @ q) / det
        hit = (s >= 0) & (r >= 0) & (s + r <= 1) & (z > 1e-6) & (z < depth)
        depth[hit], which[hit] = z[hit], t
    shape = camera.height, camera.width
    return np.where(np.isfinite(depth), depth, 0).reshape(shape), which.reshape(shape)


@pytest.mark.thorough
def test_depth_normals_and_objects_are_those_of_a_ray_cast_by_hand() -> None:
    mesh, T = street(), pose(yaw=0.21, pitch=-0.13)
    frame = shot(T)
    depth, which = by_hand(mesh, CAMERA, T)
    # Where a ray meets the rim of a face, two roundings may choose two faces.
    same = frame.instance == np.where(which >= 0, mesh.instance[which], 0)
    same &= frame.semantic == np.where(which >= 0, mesh.semantic[which], Semantic.SKY)
    assert same.mean() > 0.999
    assert np.abs(frame.depth - depth)[same].max() < 1 / 256
    corners = mesh.vertices.astype(float)[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = same & (which >= 0) & (np.abs(frame.depth - depth) < 1e-3)
    np.testing.assert_allclose(np.abs((frame.normal[seen] * normals[which[seen]]).sum(-1)), 1, atol=1e-5)
    assert (frame.depth[~seen & same] == 0).all()
    assert set(np.unique(frame.instance)) == {ROAD, WALL, BLOCK}


@pytest.mark.thorough
def test_depth_of_a_grazed_road_is_exact_far_away() -> None:
    T = pose(z=0.4, pitch=0.0, yaw=0.0)
    frame, camera_rows = shot(T), np.arange(SIZE)
    below = camera_rows > CAMERA.cy + 0.4 * CAMERA.fy / 55
    expected = 0.4 * CAMERA.fy / (camera_rows - CAMERA.cy)
    road = (frame.semantic == Semantic.ROAD) & below[:, None]
    assert frame.depth[road].max() > 40
    error = np.abs(frame.depth - expected[:, None])[road]
    assert error.max() < 1 / 256


@pytest.mark.thorough
def test_a_frame_is_the_same_bytes_alone_and_after_others() -> None:
    hard = {
        "rain_mm_h": 8.0,
        "snowfall_mm_h": 1.0,
        "lens_drops": 0.8,
        "wetness": 1.0,
        "puddles": 1.0,
        "read_noise": 2.0,
    }
    factors = Factors.model_validate({**CLEAR.model_dump(), **hard})
    alone = renderer(factors).render(CAMERA, pose(), 5)
    fresh = Renderer(street(), factors, np.array([[6.0, 3.0, 5.5]]), 3)
    fresh.render(CAMERA, pose(x=2.0), 4)
    after = fresh.render(CAMERA, pose(), 5)
    for name in ("rgb", "depth", "normal", "instance", "semantic"):
        assert getattr(alone, name).tobytes() == getattr(after, name).tobytes()
    assert alone.rgb.tobytes() != fresh.render(CAMERA, pose(), 6).rgb.tobytes()


@pytest.mark.parametrize(
    "factors",
    [
        {"fog_density": 0.05},
        {"wetness": 1.0, "puddles": 1.0},
        {"snow_cover": 1.0},
        {"rain_mm_h": 20.0, "lens_drops": 1.0},
        {"cloud_cover": 1.0},
        {"sun_elevation_deg": -20.0, "street_lamps": True, "headlights": True},
        {"exposure_ev": 1.0},
    ],
)
def test_weather_and_light_change_the_image_and_leave_the_truth(factors: Changes) -> None:
    clear, changed = shot(), shot(**factors)
    assert np.abs(grey(clear) - grey(changed)).mean() > 2
    for name in ("depth", "normal", "instance", "semantic"):
        np.testing.assert_array_equal(getattr(clear, name), getattr(changed, name))


def test_snow_whitens_what_faces_up_and_nothing_else() -> None:
    overcast: Changes = {"cloud_cover": 1.0}
    bare, snow = shot(**overcast), shot(snow_cover=1.0, **overcast)
    # Pixels of edges mix their surfaces, and windows of a wall its neighbours: look at the inside of surfaces.
    up = bare.normal[..., 2] > 0.9
    wall = np.abs(bare.normal[..., 2]) < 0.1
    inside = np.ones_like(wall)
    for axis in (0, 1):
        for step in (-1, 1):
            inside &= np.roll(bare.instance, step, axis) == bare.instance
            inside &= np.roll(up, step, axis) == up
    change = grey(snow) - grey(bare)
    walls = wall & inside & (bare.depth > 0)
    assert up.any()
    assert walls.any()
    assert change[up & inside].min() > 25
    np.testing.assert_array_equal(snow.rgb[walls], bare.rgb[walls])
    rgb = snow.rgb[up & inside].astype(float)
    assert np.ptp(rgb, axis=1).mean() < 20


@pytest.mark.thorough
def test_wheels_press_snow_into_darker_slush() -> None:
    """The road is a street along y = 0, where wheels roll 0.74 m from the middle of each lane."""
    mesh = street()
    along = replace(mesh, uv=mesh.uv - np.where(mesh.semantic == Semantic.ROAD, 60, 0)[:, None, None] * [0, 1])
    darker = []
    for snow_cover in (0.0, 0.85):
        factors = CLEAR.model_copy(update={"snow_cover": snow_cover, "cloud_cover": 1.0})
        T = pose(x=-2.0, y=-LANE_M / 2, z=4.0, yaw=0.0, pitch=-0.9)
        frame = Renderer(along, factors, np.zeros((0, 3)), 3).render(CAMERA, T, 1)
        lateral = np.abs(np.arange(SIZE) - CAMERA.cx) / CAMERA.fx * frame.depth
        road = frame.semantic == Semantic.ROAD
        track, middle = road & (np.abs(lateral - 0.74) < 0.1), road & (lateral < 0.25)
        assert min(track.sum(), middle.sum()) > 200
        darker.append(grey(frame)[middle].mean() - grey(frame)[track].mean())
    assert abs(darker[0]) < 10
    assert darker[1] > 40


@pytest.mark.thorough
def test_a_clear_day_in_snow_has_shadows_and_no_flakes() -> None:
    """At noon the block's shadow falls along y."""
    T = pose(x=2.0, y=-2.0, z=12.0, pitch=-0.9, yaw=0.0)
    flakes, lit = [], []
    for name in ("ClearSnow", "Snow"):
        factors = CONDITIONS[name].factors.model_copy(update=QUIET)
        first, second = (renderer(factors).render(CAMERA, T, seed) for seed in (1, 2))
        flakes.append(np.abs(grey(first) - grey(second)).mean())
        x, y, _ = np.moveaxis(shown_points(first, T), -1, 0)
        beside = (first.semantic == Semantic.ROAD) & (y > 0) & (y < 4)
        lit.append(grey(first)[beside & (x > 9.5) & (x < 10.5)].mean() / grey(first)[beside & (x < 8)].mean())
    assert flakes[0] == 0 < flakes[1]
    assert lit[0] < 0.6 < 0.9 < lit[1]


def test_fog_hides_the_far_more_than_the_near() -> None:
    clear, fog = shot(cloud_cover=1.0), shot(cloud_cover=1.0, fog_density=0.05)
    wall = clear.instance == WALL
    near, far = wall & (clear.depth < 12), wall & (clear.depth > 30)
    contrast = [grey(f)[m].std() / grey(c)[m].std() for m in (near, far) for f, c in [(fog, clear)]]
    assert contrast[1] < 0.6 * contrast[0] < 1.0


def test_the_sun_throws_a_shadow_where_the_geometry_says_and_an_overcast_sky_none() -> None:
    T = pose(x=2.0, y=-2.0, z=12.0, pitch=-0.9, yaw=0.0)
    sunny = shot(T)
    ground = shown_points(sunny, T)
    elevation, azimuth = np.radians(CLEAR.sun_elevation_deg), np.radians(CLEAR.sun_azimuth_deg)
    to_sun = np.array([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)])
    low, high = np.array([9.0, -3, 0]), np.array([11.0, -1, 2])
    with np.errstate(divide="ignore"):
        t = (np.stack([low, high]) - ground[..., None, :]) / to_sun
    enters, leaves = t.min(-2).max(-1), t.max(-2).min(-1)
    road = (sunny.semantic == Semantic.ROAD) & (sunny.normal[..., 2] > 0.99)
    shaded = road & (leaves > np.maximum(enters, 0) + 0.6)
    open_road = road & (enters > leaves + 0.6) & (np.abs(ground[..., 1]) < 5.5) & (ground[..., 0] < 14)
    assert shaded.sum() > 30
    assert grey(sunny)[shaded].mean() < 0.6 * grey(sunny)[open_road].mean()
    # Without the sun the block dims the ground beside it, softly. Snow takes the asphalt's own pattern away.
    inside = road.copy()
    for axis in (0, 1):
        for move in (-2, -1, 1, 2):
            inside &= np.roll(road, move, axis)
    pairs = inside[:, 1:] & inside[:, :-1]
    hard, soft = (
        np.abs(np.diff(grey(shot(T, cloud_cover=c, snow_cover=1.0)), axis=1))[pairs].max() for c in (0.0, 1.0)
    )
    assert soft < 0.3 * hard


def test_wet_ground_mirrors_the_wall() -> None:
    T = pose(x=-5.0, y=-4.0, z=1.6, yaw=np.pi / 2, pitch=0.0)
    overcast: Changes = {"cloud_cover": 1.0}
    wet, dry = shot(T, wetness=1.0, puddles=1.0, **overcast), shot(T, **overcast)
    # Looking at the wall's end, road pixels k rows below the horizon mirror the wall or the sky k rows above it.
    road = (wet.semantic == Semantic.ROAD)[SIZE // 2 :]
    road[:10], road[28:] = False, False
    wall = (wet.instance == WALL)[: SIZE // 2][::-1]
    sky = (wet.semantic == Semantic.SKY)[: SIZE // 2][::-1]
    assert (road & wall).sum() > 300
    assert (road & sky).sum() > 300
    steps = []
    for frame in (wet, dry):
        lower = grey(frame)[SIZE // 2 :]
        steps.append(lower[road & sky].mean() - lower[road & wall].mean())
    assert steps[0] > steps[1] + 20


def test_texture_keeps_still_when_the_camera_moves_by_less_than_a_pixel() -> None:
    quarter = Camera("pinhole", SIZE, SIZE, CAMERA.fx, CAMERA.fy, CAMERA.cx + 0.25, CAMERA.cy)
    whole = Camera("pinhole", SIZE, SIZE, CAMERA.fx, CAMERA.fy, CAMERA.cx + 1.0, CAMERA.cy)
    overcast: Changes = {"cloud_cover": 1.0}
    still, moved, next_pixel = (grey(shot(camera=c, **overcast)) for c in (CAMERA, quarter, whole))
    inside = (np.abs(still - np.roll(still, 1, 1)) < 40) & (np.arange(SIZE) > 2)
    np.testing.assert_allclose(next_pixel[:, 2:], still[:, 1:-1], atol=12)
    change = np.abs(moved - still)[inside].mean()
    step = np.abs(next_pixel - still)[inside].mean()
    assert change < 0.45 * step + 0.2


@pytest.mark.thorough
def test_textures_hold_no_energy_that_eightfold_sampling_does_not_have() -> None:
    fine = CAMERA.scaled(8)
    overcast: Changes = {"cloud_cover": 1.0, "gamma": 1.0}
    frame, reference = shot(**overcast), shot(camera=fine, **overcast)
    averaged = grey(reference).reshape(SIZE, 8, SIZE, 8).mean(axis=(1, 3))
    image = grey(frame)
    for surface in (WALL, ROAD):
        mask = (frame.instance == surface) & (frame.depth > 0)
        for axis in (0, 1):
            for step in (-2, -1, 1, 2):
                mask &= np.roll(frame.instance, step, axis) == surface
        assert mask.sum() > 500

        def rough(picture: Array, where: Mask = mask) -> float:
            second = picture - 0.5 * (np.roll(picture, 1, 1) + np.roll(picture, -1, 1))
            return float((second[where] ** 2).mean())

        assert rough(image) < 1.3 * rough(averaged) + 0.3
        assert np.abs(image - averaged)[mask].mean() < 4


def test_a_moving_car_darkens_the_road_under_it_and_leaves_the_rest_of_the_light() -> None:
    low, high = np.array([5.0, -1.5, 0.3]), np.array([8.0, 0.5, 1.5])
    car = block(low, high, Material.CONCRETE, 11)
    moving = replace(car, semantic=np.full(len(car), Semantic.MOVING_CAR, dtype=np.uint8))
    overcast = Factors.model_validate({**CLEAR.model_dump(), "cloud_cover": 1.0})
    still = renderer(overcast)
    with_car = still.with_moving(moving)
    T = pose(x=-3.0, y=-0.5)
    before, after = still.render(CAMERA, T, 1), with_car.render(CAMERA, T, 1)
    changed = np.abs(grey(after) - grey(before)) > 2
    ground = shown_points(after, T)
    beneath = (
        (after.semantic == Semantic.ROAD) & (ground[..., :2] > low[:2]).all(-1) & (ground[..., :2] < high[:2]).all(-1)
    )
    assert beneath.sum() > 10
    assert grey(after)[beneath].mean() < 0.85 * grey(before)[beneath].mean()
    # Beyond 2 m from the car, and where the picture does not show it, nothing is another.
    far = (np.abs(ground[..., :2] - (low + high)[:2] / 2) > (high - low)[:2] / 2 + 2).any(-1)
    shown = after.instance == before.instance
    for axis in (0, 1):
        shown = shown & np.roll(shown, 1, axis) & np.roll(shown, -1, axis)
    assert not (changed & far & shown & (after.depth > 0)).any()


@pytest.mark.thorough
def test_edges_are_smooth() -> None:
    overcast: Changes = {"cloud_cover": 1.0, "gamma": 1.0}
    frame, reference = shot(**overcast), shot(camera=CAMERA.scaled(8), **overcast)
    averaged = grey(reference).reshape(SIZE, 8, SIZE, 8).mean(axis=(1, 3))
    block_seen = frame.instance == BLOCK
    rim = block_seen ^ np.roll(block_seen, 1, 1)
    error = np.abs(grey(frame) - averaged)[rim]
    nearest = np.abs(grey(reference).reshape(SIZE, 8, SIZE, 8)[:, 4, :, 4] - averaged)[rim]
    assert error.mean() < 0.6 * nearest.mean()


@pytest.mark.thorough
def test_noise_has_the_stated_deviation() -> None:
    flat: Changes = {"cloud_cover": 1.0, "sun_elevation_deg": 60.0}
    clean = shot(**flat)
    noisy = np.stack([shot(seed=k, read_noise=3.0, shot_noise=0.04, **flat).rgb for k in range(12)]).astype(float)
    level = clean.rgb.astype(float)
    inside = (level > 30) & (level < 200)
    expected = np.sqrt(3.0**2 + (0.04 * 255) ** 2 * level / 255 + 1 / 12)
    measured = np.sqrt(((noisy - level) ** 2).mean(0))
    for low, high in ((30, 90), (90, 140), (140, 200)):
        band = inside & (level >= low) & (level < high)
        if band.sum() > 200:
            ratio = np.sqrt((measured[band] ** 2).mean()) / np.sqrt((expected[band] ** 2).mean())
            assert ratio == pytest.approx(1.0, abs=0.05)
    assert inside.sum() > 2000


@pytest.mark.thorough
def test_exposure_follows_the_stops() -> None:
    linear: Changes = {"gamma": 1.0, "cloud_cover": 1.0}
    levels = [grey(shot(exposure_ev=ev, **linear)).mean() for ev in (-2.0, -1.0, 0.0)]
    assert levels[0] < levels[1] < levels[2]
    dim, bright = (grey(shot(auto_exposure=True, sun_elevation_deg=e, **linear)).mean() for e in (12.0, 60.0))
    assert dim == pytest.approx(bright, rel=0.2)


def test_only_a_pinhole_camera_is_rendered() -> None:
    fisheye = Camera("equidistant", SIZE, SIZE, 60, 60, 47.5, 47.5, (0.0, 0.0, 0.0, 0.0))
    with refused(ConfigError, "", None, "pinhole"):
        renderer().render(fisheye, pose(), 0)


@pytest.mark.thorough
def test_a_row_of_lamps_lights_the_road_as_town_streets_are_lit() -> None:
    # Posts every 23 m on both sides of a road 7 m wide; EN 13201-2, classes C4 to C1: 10 to 30 lx, uniformity 0.4.
    x = np.arange(-92.0, 93.0, 23.0)
    heads = np.concatenate(
        [
            np.column_stack([x + shift, np.full(len(x), y), np.full(len(x), 5.62)])
            for y, shift in ((-2.7, 0.0), (2.7, 11.5))
        ]
    )
    lamps = make_lamps(heads)
    lux = []
    for along in np.arange(0.0, 23.0, 0.5):
        for across in np.arange(-3.25, 3.5, 0.5):
            _, most, rest = strongest_lamp(lamps, along, across, 0.0, 0.0, 0.0, 1.0)
            lux.append(NIGHT_LUX * (most + rest))
    assert 10 <= np.mean(lux) <= 30
    assert np.min(lux) / np.mean(lux) >= 0.4


def test_dipped_headlights_end_at_a_cut_off() -> None:
    # UN Regulation 112, class B, a lamp's limits on a screen 25 m ahead: two are taken as one here.
    beam = Beam(np.array([0, 0, 0.65], np.float32), np.array([1, 0, 0], np.float32))

    def lux(left: float, up_deg: float) -> float:
        return NIGHT_LUX * headlight_irradiance(
            beam, 25.0, left, 0.65 + 25 * np.tan(np.radians(up_deg)), -1.0, 0.0, 0.0
        )

    assert lux(0.0, -0.86) >= 2 * 12, "50R: the road 50 m ahead"
    assert lux(0.0, 0.57) <= 2 * 0.7, "zone III"
    assert all(lux(0.0, up) < lux(0.0, -0.86) for up in (-10.0, -5.0, 0.0, 5.0))
    assert lux(9.0, -1.7) < 0.5 * lux(0.0, -1.7)

"""Lidar scans measure the scene as the sensor's own motion, the weather and other cars let them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from small_street import box, quads

from relocbench.arrays import Array, Times
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.lidar.echo import extinction, signal
from relocbench.datasets.synthetic.lidar.lidar import (
    Lidar,
    LidarScene,
    Motion,
    MovingObject,
    RayHits,
    compensate,
    push_broom,
    scan,
    spinning,
    trace,
)
from relocbench.datasets.synthetic.town.mesh import Material, Mesh
from relocbench.errors import ConfigError
from relocbench.geometry import apply, make_transform, se3_exp, so3_exp

CLEAR = Factors()
LOW, HIGH = np.array([-9.0, -7.0, 0.0]), np.array([11.0, 8.0, 6.0])
ROOM = box(LOW.tolist(), HIGH.tolist(), Material.PLASTER, 7)


def unit(vectors: Array) -> Array:
    out: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return out


def random_rays(count: int, seed: int = 0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.uniform(LOW + 0.5, HIGH - 0.5, size=(count, 3)), unit(rng.normal(size=(count, 3)))


def way_out(origins: Array, directions: Array) -> Array:
    """Distance to the walls of the room, from inside: the nearest of the three planes that the ray runs towards."""
    with np.errstate(divide="ignore"):
        ahead = np.where(directions > 0, HIGH, LOW)
        out: Array = np.min((ahead - origins) / directions, axis=1)
        return out


class Driving:
    """Forward at 12 m/s while turning by 40 degrees a second and nodding."""

    twist = np.array([12.0, 0.0, 0.0, 0.0, np.radians(5), np.radians(40)])

    def __call__(self, times_ns: Times, /) -> Array:
        start = make_transform(np.eye(3), [-1.0, 0.2, 1.8])
        return np.asarray(start @ se3_exp(times_ns[:, None] / 1e9 * self.twist))


def standing(pose: Array) -> Motion:
    return lambda times_ns: np.repeat(pose[None], len(times_ns), axis=0)


def test_ranges_agree_with_analytic_planes() -> None:
    origins, directions = random_rays(5000)
    hits = LidarScene(ROOM).hits(origins, directions)
    distance, material, instance = hits.range, hits.material, hits.instance
    np.testing.assert_allclose(distance, way_out(origins, directions), atol=2e-5)
    assert set(material.tolist()) == {Material.PLASTER}
    assert set(instance.tolist()) == {7}


def test_ranges_are_in_lengths_of_the_direction() -> None:
    origins, directions = random_rays(50)
    scene = LidarScene(ROOM)
    np.testing.assert_allclose(
        scene.hits(origins, 4 * directions).range, scene.hits(origins, directions).range / 4, rtol=1e-5
    )


def test_a_ray_that_meets_nothing_has_an_infinite_range() -> None:
    floor = quads(np.array([[(-5.0, -5, 0), (5, -5, 0), (5, 5, 0), (-5, 5, 0)]]), Material.GRASS, 3)
    for mesh in (floor, floor.select(np.zeros(2, dtype=np.bool_))):
        hits = LidarScene(mesh).hits(np.array([[0.0, 0, 1]]), np.array([[0.0, 0, 1]]))
        distance, material, instance = hits.range, hits.material, hits.instance
        assert (distance[0], material[0], instance[0]) == (np.inf, 0, 0)


def test_the_push_broom_scans_270_degrees_in_half_degrees_and_turns_50_times_a_second() -> None:
    lms = push_broom()
    angles = np.degrees(np.arctan2(lms.directions[:, 1], lms.directions[:, 0]))
    np.testing.assert_allclose(angles, np.linspace(-135, 135, 541), atol=1e-9)
    assert not lms.directions[:, 2].any()
    assert lms.period_ns == 20_000_000
    # 270 of 360 degrees of a turn, the middle beam at the scan's own time.
    assert (lms.offsets_ns[0], lms.offsets_ns[270], lms.offsets_ns[-1]) == (-7_500_000, 0, 7_500_000)


@pytest.mark.parametrize("rings", [16, 32, 64])
def test_the_spinning_lidar_fires_all_rings_of_an_azimuth_together(rings: int) -> None:
    velodyne = spinning(rings, 360)
    directions = velodyne.directions.reshape(rings, 360, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    elevation = np.degrees(np.arcsin(directions[:, 0, 2]))
    assert (round(elevation[0], 9), round(elevation[-1], 9)) == (2.0, -24.8)
    azimuth = np.degrees(np.unwrap(np.arctan2(directions[0, :, 1], directions[0, :, 0])))
    np.testing.assert_allclose(np.diff(azimuth), -1.0)
    offsets = velodyne.offsets_ns.reshape(rings, 360)
    assert (offsets == offsets[0]).all()
    # Looking forward at the scan's own time.
    np.testing.assert_allclose(np.interp(0.0, offsets[0], azimuth), 0.0, atol=1e-6)


def test_a_spinning_lidar_of_too_many_or_too_few_rings_is_refused() -> None:
    for rings in (8, 128):
        with refused(ConfigError, "", None, 16, 64):
            spinning(rings)


def distance_to_room(points: Array) -> Array:
    out: Array = np.min(np.abs(np.stack([points - LOW, points - HIGH])), axis=(0, 2))
    return out


@pytest.mark.parametrize(("lidar", "times_worse"), [(push_broom(), 1.5), (spinning(32, 1000), 5.0)])
def test_exact_poses_undo_the_distortion_of_motion(lidar: Lidar, times_worse: float) -> None:
    motion = Driving()
    measured = scan(lidar, LidarScene(ROOM), motion, 0, CLEAR, np.random.default_rng(1))
    assert measured.returned.mean() > 0.95
    T_world_now = motion(np.array([0]))[0]
    flat = distance_to_room(apply(T_world_now, compensate(lidar, measured, motion)[measured.returned]))
    distorted = distance_to_room(apply(T_world_now, measured.points[measured.returned]))
    assert np.sqrt(np.mean(flat**2)) < lidar.sigma_m
    # A push-broom scan takes 15 ms, a turn of the spinning lidar 100 ms.
    assert np.sqrt(np.mean(distorted**2)) > times_worse * np.sqrt(np.mean(flat**2))


def test_a_sensor_that_stands_has_no_distortion() -> None:
    lidar, motion = spinning(16, 200), standing(make_transform(so3_exp([0.1, 0.2, 2.0]), [1.0, 2.0, 1.5]))
    measured = scan(lidar, LidarScene(ROOM), motion, 5, CLEAR, np.random.default_rng(1))
    np.testing.assert_allclose(compensate(lidar, measured, motion), measured.points, atol=1e-12)


def test_ranges_have_the_stated_noise() -> None:
    lidar = spinning(32, 1000)
    pose = make_transform(np.eye(3), [1.0, 0.5, 1.5])
    measured = scan(lidar, LidarScene(ROOM), standing(pose), 0, CLEAR, np.random.default_rng(2))
    exact = way_out(np.repeat(pose[None, :3, 3], len(lidar.directions), 0), lidar.directions)
    error = (np.linalg.norm(measured.points, axis=1) - exact)[measured.returned]
    # Five standard errors of the mean and of the standard deviation.
    assert abs(error.mean()) < 5 * 0.02 / np.sqrt(len(error))
    assert abs(error.std() - 0.02) < 0.001


class Crossing:
    """Something that crosses the room at 15 m/s while it turns; it enters at time 0."""

    def __call__(self, times_ns: Times, /) -> Array:
        seconds = times_ns / 1e9
        zero = np.zeros_like(seconds)
        rotation = so3_exp(np.stack([zero, zero, 2.0 * seconds], axis=-1))
        pose = make_transform(rotation, np.stack([2 + zero, -4 + 15 * seconds, 1.5 + zero], axis=-1))
        pose[times_ns < 0] = np.nan
        return pose


THING = box((-1, -0.5, -0.5), (1, 0.5, 0.5), Material.CAR_PAINT, 99)


def test_a_beam_meets_a_moving_object_where_it_is_when_the_beam_is_fired() -> None:
    origins, directions = random_rays(400, seed=3)
    directions[:300] = unit(np.array([2.0, 0.0, 1.5]) + np.random.default_rng(4).normal(size=(300, 3)) - origins[:300])
    times = np.linspace(-50_000_000, 450_000_000, 400).astype(np.int64)
    room = LidarScene(ROOM)
    found = trace(room, [MovingObject(LidarScene(THING), Crossing(), 1.3)], origins, directions, times)
    expected = [room.hits(o[None], d[None]) for o, d in zip(origins, directions, strict=True)]
    poses = Crossing()(times)
    for i in range(400):
        if np.isfinite(poses[i, 0, 0]):
            thing = replace(THING, vertices=apply(poses[i], THING.vertices).astype(np.float32))
            hit = LidarScene(thing).hits(origins[i : i + 1], directions[i : i + 1])
            expected[i] = min(expected[i], hit, key=lambda hit: float(hit.range[0]))
    np.testing.assert_allclose(found.range, [hit.range[0] for hit in expected], atol=1e-4)
    np.testing.assert_array_equal(found.instance, [hit.instance[0] for hit in expected])
    assert (found.instance == 99).sum() > 40
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0, atol=1e-5)


FLOOR = quads(np.array([[(-80.0, -80, 0), (80, -80, 0), (80, 80, 0), (-80, 80, 0)]]), Material.ASPHALT, 1)


def share_returned(factors: Factors, mesh: Mesh = FLOOR) -> float:
    pose = standing(make_transform(np.eye(3), [0.0, 0.0, 1.8]))
    lidar = spinning(32, 300)
    measured = scan(lidar, LidarScene(mesh), pose, 0, factors, np.random.default_rng(0))
    below = lidar.directions[:, 2] < 0
    return float(measured.returned[below].mean())


@pytest.mark.parametrize(
    "worse",
    [{"wetness": 1.0}, {"fog_density": 0.05}, {"lens_drops": 1.0}, {"wetness": 1.0, "rain_mm_h": 20.0}],
    ids="+".join,
)
def test_weather_costs_echoes(worse: dict[str, float]) -> None:
    assert share_returned(Factors.model_validate(worse)) < share_returned(CLEAR) - 0.02


def test_snow_brightens_the_road_and_sends_echoes_from_the_air() -> None:
    assert share_returned(Factors(snow_cover=1.0)) > share_returned(CLEAR)
    lidar, pose = spinning(32, 1000), make_transform(np.eye(3), [1.0, 0.5, 1.5])
    args = (lidar, LidarScene(ROOM), standing(pose), 0, Factors(snowfall_mm_h=2.0), np.random.default_rng(2))
    measured = scan(*args)
    air = measured.returned & (measured.instance == 0)
    assert 0.003 < air.mean() < 0.012
    exact = way_out(np.repeat(pose[None, :3, 3], len(lidar.directions), 0), lidar.directions)
    assert (np.linalg.norm(measured.points, axis=1)[air] < exact[air]).all()


def test_nothing_is_measured_beyond_the_range_or_too_near() -> None:
    for x, seen in ((0.3, 0.0), (10.0, 1.0), (49.0, 1.0), (51.0, 0.0)):
        wall = quads(np.array([[(x, -90.0, -90.0), (x, 90, -90), (x, 90, 90), (x, -90, 90)]]), Material.LANE_MARKING)
        measured = scan(push_broom(), LidarScene(wall), standing(np.eye(4)), 0, CLEAR, np.random.default_rng(0))
        assert measured.returned[270] == seen
        assert not measured.points[~measured.returned].any()


@settings(max_examples=50)
@given(st.floats(1.0, 200.0), st.floats(0.0, 0.1))
def test_the_echo_of_the_data_sheets_dark_surface_is_just_seen_at_its_range(dark_m: float, fog: float) -> None:
    power = signal(np.array([dark_m, np.inf]), np.array([0.1, 0.1]), fog, dark_m)
    np.testing.assert_allclose(power, [np.exp(-2 * fog * dark_m), 0.0])


def test_extinction_follows_the_recommendation() -> None:
    # ITU-R P.1814: 1.076 R^0.67 dB/km, so 5.03 dB/km at 10 mm/h; a decibel is ln(10)/10.
    np.testing.assert_allclose(extinction(Factors(rain_mm_h=10.0)), 5.033e-3 * np.log(10) / 10, rtol=1e-3)
    assert extinction(Factors(fog_density=0.02)) == 0.02


def test_the_same_seed_gives_the_same_scan_and_another_seed_another() -> None:
    def points(seed: int) -> Array:
        return scan(push_broom(), LidarScene(ROOM), Driving(), 0, CLEAR, np.random.default_rng(seed)).points

    np.testing.assert_array_equal(points(1), points(1))
    assert (points(1) != points(2)).any()


def test_hits_of_no_rays_are_empty() -> None:
    hits = LidarScene(ROOM).hits(np.zeros((0, 3)), np.zeros((0, 3)))
    assert isinstance(hits, RayHits)
    assert len(hits.range) == 0

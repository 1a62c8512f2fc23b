"""Between scans a car sways smoothly: splines follow it where straight lines cut its curves."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from relocbench.arrays import Array, Times
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import invert, is_rotation, make_transform, rotation_angle, se3_exp

TENTH = 100_000_000
START = 1_700_000_000_000_000_000


def swaying(times_ns: Times) -> Array:
    """A bend at 10 m/s, whose radius is 30 m, with a roll of 0.4 degrees at 1.5 Hz and heave of 2 cm."""
    t = (times_ns - START) / 1e9
    yaw = t / 3.0
    position = np.stack([30 * np.sin(yaw), 30 * (1 - np.cos(yaw)), 0.02 * np.sin(8 * t)], axis=-1)
    turn = se3_exp(np.stack([0 * t, 0 * t, 0 * t, 0 * t, 0 * t, yaw], axis=-1))
    roll = se3_exp(np.stack([0 * t, 0 * t, 0 * t, np.radians(0.4) * np.sin(3 * np.pi * t), 0 * t, 0 * t], axis=-1))
    return np.asarray(make_transform((turn @ roll)[:, :3, :3], position))


def worst(found: Array, true: Array) -> tuple[float, float]:
    apart = invert(true) @ found
    return float(np.linalg.norm(apart[:, :3, 3], axis=1).max()), float(
        np.degrees(rotation_angle(apart[:, :3, :3]).max())
    )


def test_splines_follow_what_lines_cut() -> None:
    times = START + TENTH * np.arange(60)
    smooth = Trajectory(times, swaying(times), smooth=True)
    between = START + np.arange(5 * TENTH, 54 * TENTH, 7_000_001)
    straight = worst(replace(smooth, smooth=False).at(between), swaying(between))
    curved = worst(smooth.at(between), swaying(between))
    assert straight[1] > 0.03
    assert curved[0] < 0.1 * straight[0]
    assert curved[1] < 0.1 * straight[1]
    assert all(is_rotation(T[:3, :3]) for T in smooth.at(between[:20]))


def test_the_poses_themselves_stay() -> None:
    times = START + TENTH * np.arange(12)
    smooth = Trajectory(times, swaying(times), smooth=True)
    np.testing.assert_array_equal(smooth.at(times), smooth.T_odom_rig)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(smooth)).at(times + 0), smooth.T_odom_rig)


@pytest.mark.parametrize("apart_ns", [1, 100_000, 1_000_000, 5_000_000, 15_000_000])
@pytest.mark.parametrize("row", [0, 30, 58])
def test_noise_of_poses_that_are_close_in_time_makes_no_bulge(apart_ns: int, row: int) -> None:
    times = START + TENTH * np.arange(60)
    times = np.sort(np.append(times, times[row] + apart_ns))
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(size=(61, 6)) * np.repeat([0.01, 0.002], 3)
        noisy = swaying(times) @ se3_exp(noise)
        between = np.arange(times[0], times[-1], 3_333_333)
        metres, degrees = worst(Trajectory(times, noisy, smooth=True).at(between), swaying(between))
        assert metres < 0.08
        assert degrees < 0.9


@pytest.mark.parametrize("spacing", [0.1, 0.01])
@pytest.mark.parametrize("pause", [0.3, 0.9])
@pytest.mark.parametrize("place", ["first", "second", "middle", "last"])
def test_noise_is_not_enlarged_beside_a_pause(spacing: float, pause: float, place: str) -> None:
    gaps = np.full(40, spacing)
    gaps[{"first": 0, "second": 1, "middle": 20, "last": -1}[place]] = pause
    seconds = np.concatenate([[0.0], np.cumsum(gaps)])
    times = START + np.round(seconds * 1e9).astype(np.int64)
    between = np.linspace(times[0], times[-1], 2000).astype(np.int64)
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(size=(41, 3)) * 0.01
        poses = make_transform(np.tile(np.eye(3), (41, 1, 1)), np.outer(seconds, [10.0, 0.0, 0.0]) + noise)
        found = Trajectory(times, poses, smooth=True).at(between)[:, :3, 3]
        off = found - np.outer((between - START) / 1e9, [10.0, 0.0, 0.0])
        assert np.linalg.norm(off, axis=1).max() < 0.11


def test_breaks_are_between_poses() -> None:
    times = START + TENTH * np.arange(6)
    for wrong in (0, 6, -1):
        with refused(ValueError, "", None, wrong):
            Trajectory(times, swaying(times), breaks=(wrong,))
    assert not Trajectory(times[:0], np.zeros((0, 4, 4))).covers(times).any()


def test_a_finer_trajectory_is_the_same_in_straight_lines() -> None:
    times = START + TENTH * np.array([*range(20), *range(40, 60)])
    smooth = Trajectory(times, swaying(times), breaks=(10,), smooth=True)
    finer = smooth.finer()
    assert not finer.smooth
    between = START + np.arange(0, 59 * TENTH, 3_333_333)
    np.testing.assert_array_equal(finer.covers(between), smooth.covers(between))
    np.testing.assert_array_equal(finer.pieces(between), smooth.pieces(between))
    known = between[smooth.covers(between)]
    metres, degrees = worst(finer.at(known), smooth.at(known))
    assert metres < 5e-4
    assert degrees < 3e-3
    assert replace(smooth, smooth=False).finer().times_ns is times


def test_nothing_is_smoothed_across_a_break_and_short_pieces_are_straight() -> None:
    times = START + TENTH * np.arange(30)
    poses = swaying(times)
    poses[15:, 0, 3] += 5.0
    broken = Trajectory(times, poses, breaks=(15,), smooth=True)
    alone = Trajectory(times[:15], poses[:15], smooth=True)
    between = START + np.arange(0, 14 * TENTH, 9_999_999)
    np.testing.assert_array_equal(broken.at(between), alone.at(between))
    three = Trajectory(times[:3], poses[:3], smooth=True)
    np.testing.assert_array_equal(three.at(between[:20]), replace(three, smooth=False).at(between[:20]))
    with pytest.raises(ValueError, match="outside"):
        broken.at(times[-1:] + 1)

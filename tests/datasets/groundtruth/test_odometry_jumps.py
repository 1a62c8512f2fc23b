"""Jumps of odometry are found at the step where they are, and motion that vehicles have is none."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import Notes

from relocbench.arrays import Array
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.jumps import interrupted, jumps_of
from relocbench.datasets.sensors.recording import FieldRecording, Trajectory
from relocbench.geometry import invert, make_transform, se3_exp, so3_exp

STEP_NS = 62_500_000
AT = 150


def driven(count: int = 400, seed: int = 0) -> Trajectory:
    """A drive that brakes at 6 m/s^2 to a stop, a bend, bumps, and noise of 1 cm and 0.05 degrees a step."""
    rng = np.random.default_rng(seed)
    speed, poses = 12.0, [np.eye(4)]
    for k in range(count - 1):
        braking = 60 <= k < 120
        speed = max(speed - 6.0 * STEP_NS / 1e9, 0.0) if braking else min(speed + 3.0 * STEP_NS / 1e9, 12.0)
        yaw = 0.5 * STEP_NS / 1e9 * speed / 12.0 if 200 <= k < 260 else 0.0
        pitch = np.radians(0.15) if k % 37 == 0 else 0.0
        twist = np.array([speed * STEP_NS / 1e9, 0.0, 0.0, 0.0, pitch, yaw])
        noise = rng.normal(size=6) * np.repeat([0.01, np.radians(0.05)], 3)
        poses.append(poses[-1] @ se3_exp(twist + noise))
    return Trajectory(np.arange(count) * STEP_NS + 1, np.array(poses))


def with_jump(odometry: Trajectory, at: int, twist: list[float]) -> Trajectory:
    """The odometry whose step to pose ``at`` is off by a twist (6,)."""
    T = odometry.T_odom_rig.copy()
    T[at:] = T[at - 1] @ se3_exp(np.array(twist)) @ invert(T[at - 1]) @ T[at:]
    return replace(odometry, T_odom_rig=T)


def recording(odometry: Trajectory) -> FieldRecording:
    """A recording of which only the odometry is read."""
    return FieldRecording(
        "summer", Path("summer"), Condition(weather="clear", season="summer", time_of_day="day"), odometry, ()
    )


@pytest.mark.parametrize("seed", range(8))
def test_motion_of_a_vehicle_is_no_jump(seed: int) -> None:
    assert jumps_of(driven(seed=seed)) == ()


@pytest.mark.parametrize(
    "twist",
    [
        [0.3, 0.1, 0.0, 0.0, 0.0, np.radians(1.0)],
        [0.0, -0.4, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, np.radians(4.0), 0.0],
        [-2.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ],
)
@pytest.mark.parametrize("at", [1, 2, 30, AT, 230, 396, 398, 399])
def test_a_jump_is_found_where_it_is(twist: list[float], at: int) -> None:
    (jump,) = jumps_of(with_jump(driven(), at, twist))
    assert (jump.index, jump.time_ns) == (at, at * STEP_NS + 1)
    assert jump.metres == pytest.approx(np.linalg.norm(twist[:3]), abs=0.08)
    assert jump.degrees == pytest.approx(np.degrees(np.linalg.norm(twist[3:])), abs=0.5)


@pytest.mark.parametrize("acceleration", [-3.0, -1.5, 1.5, 3.0])
@pytest.mark.parametrize("metres", [-0.3, 0.3])
def test_a_jump_is_found_while_the_vehicle_brakes_or_accelerates(acceleration: float, metres: float) -> None:
    seconds = np.arange(0.0, 20.0, 0.1)
    speed = np.where(acceleration > 0, 2.0, 14.0) + acceleration * np.clip(seconds - 8.0, 0.0, 4.0)
    along = np.concatenate([[0.0], np.cumsum(np.diff(seconds) * (speed[1:] + speed[:-1]) / 2)])
    positions = np.stack([along, 0 * along, 0 * along], axis=1)
    poses = make_transform(np.tile(np.eye(3), (len(along), 1, 1)), positions)
    drive = Trajectory(np.round(seconds * 1e9).astype(np.int64), poses)
    assert jumps_of(drive) == ()
    for at in range(70, 130):
        assert [jump.index for jump in jumps_of(with_jump(drive, at, [metres, 0, 0, 0, 0, 0]))] == [at]


def test_odometry_is_interrupted_at_its_jumps_and_this_is_told() -> None:
    spoken = Notes()
    before = recording(with_jump(driven(), AT, [0.5, 0, 0, 0, 0, 0]))
    after = interrupted(before, spoken)
    assert after.odometry.breaks == (AT,)
    times = before.odometry.times_ns
    assert not after.odometry.covers(np.array([times[AT] - 1]))[0]
    assert np.ptp(after.odometry.pieces(times[[AT - 1, AT]])) == 1
    (note,) = spoken.notes
    assert re.match(
        r"summer: the odometry jumps in 1 of its 399 steps, most by 0\.[45]\d m and 0\.\d deg at \d+ ns", note
    )
    assert interrupted(recording(driven()), spoken).odometry.breaks == ()
    assert len(spoken.notes) == 1


def test_breaks_that_are_known_stay_and_are_not_judged() -> None:
    odometry = replace(with_jump(driven(), AT, [0.5, 0, 0, 0, 0, 0]), breaks=(AT,))
    assert jumps_of(odometry) == ()
    other = with_jump(odometry, 300, [0.5, 0, 0, 0, 0, 0])
    assert interrupted(recording(other), Notes()).odometry.breaks == (AT, 300)


def straight(seconds: Array, speed: float = 10.0, **sway: Array) -> Trajectory:
    """A straight drive, with heave in metres, and pitch and yaw in radians, of each pose."""
    zero = np.zeros(len(seconds))
    angles = np.stack([zero, sway.get("pitch", zero), sway.get("yaw", zero)], axis=1)
    turns = so3_exp(angles)
    positions = np.stack([speed * seconds, zero, sway.get("heave", zero)], axis=1)
    return Trajectory(np.round(seconds * 1e9).astype(np.int64), make_transform(turns, positions))


def bump(metres: Array) -> Array:
    """Height of a bump of 10 cm whose length is a metre, in the middle of 800 m."""
    return 0.1 * np.exp(-np.square((metres - 400.0) / 0.5))


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0, 30.0])
@pytest.mark.parametrize("speed", [2.0, 4.0, 8.0])
def test_a_speed_bump_is_no_jump(rate: float, speed: float) -> None:
    seconds = np.arange(0.0, 800.0 / speed, 1 / rate)
    front, rear = bump(speed * seconds + 1.3), bump(speed * seconds - 1.3)
    assert jumps_of(straight(seconds, speed, heave=(front + rear) / 2, pitch=(rear - front) / 2.6)) == ()


@pytest.mark.parametrize(("rate", "hertz", "degrees"), [(10, 2, 1), (30, 8, 2), (30, 12, 3), (20, 10, 2)])
def test_a_shaken_hand_is_no_jump_and_hides_none(rate: float, hertz: float, degrees: float) -> None:
    seconds = np.arange(0.0, 120.0, 1 / rate)
    shaken = np.sin(2 * np.pi * 1.013 * hertz * seconds)
    once, often = np.exp(-np.square((seconds - 60.0) / 0.5)) * shaken, np.where(seconds % 30 < 8, shaken, 0.0)
    for amount in (once, often):
        drive = straight(seconds, 1.2, heave=0.01 * amount, yaw=np.radians(degrees) * amount)
        at = len(seconds) // 3
        moved = interrupted(recording(with_jump(drive, at, [2.0, 0, 0, 0, 0, 0])), Notes()).odometry
        assert at in moved.breaks
    once_only = straight(seconds, 1.2, heave=0.01 * once, yaw=np.radians(degrees) * once)
    assert jumps_of(once_only) == ()


@pytest.mark.parametrize("pause_s", [0.2, 1.2, 60.0])
def test_a_jump_beside_a_pause_is_found(pause_s: float) -> None:
    seconds = np.arange(0.0, 40.0, 0.1)
    seconds[200:] += pause_s
    drive = straight(seconds)
    for at in range(196, 205):
        jumps = jumps_of(with_jump(drive, at, [1.0, 0, 0, 0, 0, 0]))
        across_a_gap = at == 200 and pause_s > 1.0
        assert [jump.index for jump in jumps] == ([] if across_a_gap else [at])


def test_jumps_between_breaks_that_are_close_are_found() -> None:
    drive = replace(straight(np.arange(0.0, 40.0, 0.1)), breaks=(200, 203))
    for at in (198, 199, 201, 202, 204, 205):
        assert [jump.index for jump in jumps_of(with_jump(drive, at, [0.0, 1.0, 0, 0, 0, 0]))] == [at]


def test_a_pose_that_is_off_or_has_a_wrong_time_is_interrupted_on_both_sides() -> None:
    drive = straight(np.arange(0.0, 40.0, 0.1))
    T, times = drive.T_odom_rig.copy(), drive.times_ns.copy()
    T[200, 1, 3] += 0.7
    assert [jump.index for jump in jumps_of(replace(drive, T_odom_rig=T))] == [200, 201]
    times[200] -= 50_000_000
    assert [jump.index for jump in jumps_of(replace(drive, times_ns=times))] == [200, 201]


@pytest.mark.parametrize(("rate", "metres"), [(1.0, 10.0), (2.0, 3.0), (5.0, 0.5), (10.0, 0.3)])
def test_what_poses_tell_that_are_far_apart_in_time(rate: float, metres: float) -> None:
    seconds = np.arange(0.0, 200.0, 1 / rate)
    braking = np.where(seconds < 100, 10 * seconds, 1000 + 10 * (seconds - 100) - 2 * np.square(seconds - 100))
    braking = np.where(seconds > 102.5, 1012.5, braking)
    positions = np.stack([braking, 0 * seconds, 0 * seconds], axis=1)
    poses = make_transform(np.tile(np.eye(3), (len(seconds), 1, 1)), positions)
    drive = Trajectory((seconds * 1e9).astype(np.int64), poses, max_gap_ns=3_000_000_000)
    assert jumps_of(drive) == ()
    at = int(50 * rate)
    assert [jump.index for jump in jumps_of(with_jump(drive, at, [metres, 0, 0, 0, 0, 0]))] == [at]


def test_odometry_that_jumps_everywhere_is_interrupted_at_large_jumps_only() -> None:
    odometry, spoken = driven(), Notes()
    for at in range(20, 380, 30):
        odometry = with_jump(odometry, at, [0.4, 0, 0, 0, 0, 0])
    assert interrupted(recording(odometry), spoken).odometry.breaks == ()
    assert "too many to interrupt it there" in spoken.notes[0]
    found = interrupted(recording(with_jump(odometry, 185, [6.0, 0, 0, 0, 0, 0])), spoken).odometry
    assert found.breaks == (185,)
    assert "at the 1 largest, since the other 12 are its noise" in spoken.notes[1]


def test_a_short_or_single_pose_has_no_jumps() -> None:
    whole = driven()
    for count in (1, 2, 5, 6):
        assert jumps_of(Trajectory(whole.times_ns[:count], whole.T_odom_rig[:count])) == ()

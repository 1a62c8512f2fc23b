"""Jumps of odometry are found at the step where they are, and motion that vehicles have is none."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from recorded_street import Spoken

from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.jumps import find_jumps, interrupted
from relocbench.datasets.sensors.recording import FieldRecording, Trajectory
from relocbench.geometry import invert, se3_exp

Array = NDArray[np.float64]
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
    assert find_jumps(driven(seed=seed)) == ()


@pytest.mark.parametrize(
    "twist",
    [
        [0.3, 0.1, 0.0, 0.0, 0.0, np.radians(1.0)],
        [0.0, -0.4, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, np.radians(4.0), 0.0],
        [-2.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ],
)
@pytest.mark.parametrize("at", [30, AT, 230, 396])
def test_a_jump_is_found_where_it_is(twist: list[float], at: int) -> None:
    (jump,) = find_jumps(with_jump(driven(), at, twist))
    assert (jump.index, jump.time_ns) == (at, at * STEP_NS + 1)
    assert jump.metres == pytest.approx(np.linalg.norm(twist[:3]), abs=0.08)
    assert jump.degrees == pytest.approx(np.degrees(np.linalg.norm(twist[3:])), abs=0.5)


def test_odometry_is_interrupted_at_its_jumps_and_this_is_told() -> None:
    spoken = Spoken()
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
    assert find_jumps(odometry) == ()
    other = with_jump(odometry, 300, [0.5, 0, 0, 0, 0, 0])
    assert interrupted(recording(other), Spoken()).odometry.breaks == (AT, 300)


def test_odometry_that_jumps_everywhere_is_left_whole() -> None:
    odometry, spoken = driven(), Spoken()
    for at in range(20, 380, 30):
        odometry = with_jump(odometry, at, [0.5, 0, 0, 0, 0, 0])
    assert interrupted(recording(odometry), spoken).odometry.breaks == ()
    assert "too many to interrupt it there" in spoken.notes[0]


def test_a_short_or_single_pose_has_no_jumps() -> None:
    whole = driven()
    for count in (1, 2, 5, 6):
        assert find_jumps(Trajectory(whole.times_ns[:count], whole.T_odom_rig[:count])) == ()

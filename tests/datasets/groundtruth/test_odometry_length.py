"""Odometry is as long as GNSS says, whatever the drift of its heading, and a wrong scale is refused before any work."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from relocbench.arrays import Array
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.alignment import two_drives
from relocbench.datasets.groundtruth.alignment.two_drives import AlignmentOptions, RegistrationUnit
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.jobs.inputs import stretch_faults
from relocbench.datasets.groundtruth.odometry.length import LengthRatio, length_ratio
from relocbench.datasets.groundtruth.registration.lengths import length_mismatch_message
from relocbench.datasets.groundtruth.registration.submap_pair import unregistered
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.sensors.recording import FieldRecording, Trajectory
from relocbench.geometry import se3_exp


def drive(metres: float, scale: float = 1.0, seed: int = 0, gnss_m: float = 0.5) -> tuple[Trajectory, Trajectory]:
    """Odometry with a drifting heading and a scale, and GNSS that wanders by decimetres, of a road with bends."""
    rng = np.random.default_rng(seed)
    count = int(metres / 0.5) + 1
    T_map_rig, odometry = (poses.copy() for poses in driven(count, scale))
    wander = np.cumsum(rng.normal(size=(count, 3)), axis=0) * gnss_m / np.sqrt(200)
    T_map_rig[:, :3, 3] += wander + np.array([620_000.0, 5_735_000.0, 40.0])
    times = np.arange(count, dtype=np.int64) * 62_500_000
    return Trajectory(times, odometry), Trajectory(times, T_map_rig)


@cache
def driven(count: int, scale: float) -> tuple[Array, Array]:
    """Poses every half metre of a road with bends, true and by odometry."""
    truth, odometry = [np.eye(4)], [np.eye(4)]
    for k in range(count - 1):
        step = np.array([0.5, 0, 0, 0, 0, 0.01 * np.sin(k / 60)])
        truth.append(truth[-1] @ se3_exp(step))
        odometry.append(odometry[-1] @ se3_exp(step * np.array([scale, 1, 1, 1, 1, 1]) + [0, 0, 0, 0, 0, 2e-4]))
    return np.array(truth), np.array(odometry)


@pytest.mark.parametrize("scale", [0.92, 1.0, 1.03, 1.08])
@pytest.mark.parametrize("metres", [130, 1000])
def test_the_ratio_is_that_of_the_scales(scale: float, metres: float) -> None:
    for seed in range(3):
        found = length_ratio(*drive(metres, scale, seed), 0.5)
        assert found is not None
        assert abs(found.ratio - scale) < found.margin
        assert found.margin >= 3 * 2**0.5 * 0.5 / (1.01 * metres)


def test_a_jump_of_gnss_and_gaps_of_odometry_do_no_harm() -> None:
    odometry, prior = drive(800, 1.08)
    T = prior.T_odom_rig.copy()
    T[700:, 0, 3] += 30.0
    found = length_ratio(replace(odometry, breaks=(400, 1000)), replace(prior, T_odom_rig=T), 0.5)
    assert found is not None
    assert found.ratio == pytest.approx(1.08, abs=0.01)


def test_gnss_may_have_heights_or_not() -> None:
    odometry, prior = drive(300)
    T = odometry.T_odom_rig.copy()
    way = np.arange(len(T)) * 0.5
    T[:, 2, 3] += 0.3 * way
    with_heights = prior.T_odom_rig.copy()
    with_heights[:, 2, 3] += 0.3 * way
    climbing = replace(odometry, T_odom_rig=T)
    found = length_ratio(climbing, replace(prior, T_odom_rig=with_heights), 0.5)
    assert found is not None
    assert found.ratio == pytest.approx(1.0, abs=0.01)
    flat = prior.T_odom_rig.copy()
    flat[:, 2, 3] = 0.0
    found = length_ratio(odometry, replace(prior, T_odom_rig=flat), 0.5)
    assert found is not None
    assert found.ratio == pytest.approx(1.0, abs=0.01)


def test_too_short_a_way_says_nothing() -> None:
    assert length_ratio(*drive(50), 0.5) is None
    assert length_ratio(*drive(95), 0.5) is None
    odometry, prior = drive(200)
    assert length_ratio(odometry, replace(prior, times_ns=prior.times_ns + 10**12), 0.5) is None
    assert length_ratio(odometry, Trajectory(prior.times_ns[:0], prior.T_odom_rig[:0]), 0.5) is None


@pytest.mark.parametrize("metres", [150, 300, 600])
@pytest.mark.parametrize("kind", ["fast", "slow", "multipath"])
def test_right_odometry_is_not_refused_where_gnss_wanders(metres: float, kind: str) -> None:
    odometry, prior = drive(metres, 1.0, gnss_m=0.0)
    seconds = prior.times_ns / 1e9
    for seed in range(30):
        rng = np.random.default_rng(seed)
        if kind == "fast":
            keep = np.exp(-0.0625 / 10.0)
            error = lfilter([1.0], [1.0, -keep], rng.normal(size=(len(seconds), 3)) * 10 * np.sqrt(1 - keep**2), axis=0)
        elif kind == "slow":
            error = 10.0 * np.sin(2 * np.pi * seconds / rng.uniform(20, 200) + rng.uniform(0, 6))[:, None]
        else:
            begin = rng.uniform(0, seconds[-1])
            error = np.where((seconds >= begin) & (seconds < begin + 10.0), 9.0, 0.0)[:, None]
        T = prior.T_odom_rig.copy()
        T[:, :3, 3] += error
        found = Path("summer"), Condition(weather="clear", season="summer", time_of_day="day"), odometry, ()
        sigma_m = 3.0 if kind == "multipath" else 10.0
        moved = replace(prior, T_odom_rig=T)
        assert stretch_faults(FieldRecording("summer", *found, prior=moved, prior_sigma_m=sigma_m)) == []


@pytest.mark.parametrize(
    ("scale", "words"), [(1.0, ""), (1.03, ""), (1.08, "% longer than by GNSS"), (0.9, "% shorter")]
)
def test_odometry_of_a_wrong_scale_is_refused_and_what_can_be_done_is_said(scale: float, words: str) -> None:
    odometry, prior = drive(300, scale)
    condition = Condition(weather="clear", season="summer", time_of_day="day")
    recording = FieldRecording("summer", Path("summer"), condition, odometry, (), prior=prior, prior_sigma_m=0.5)
    faults = stretch_faults(recording)
    assert bool(words) == bool(faults)
    if words:
        assert words in faults[0].expected
        assert "--no-use-prior" in faults[0].expected
    assert stretch_faults(replace(recording, prior=None)) == []


def test_drives_that_differ_in_length_are_told_what_gnss_says_of_each(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drives, nodes = [], Nodes(np.zeros(1, np.int64), np.eye(4)[None], np.zeros(1))
    for name, scale in (("summer", 1.0), ("winter", 1.08)):
        odometry, prior = drive(600, scale)
        condition = Condition(weather="clear", season="summer", time_of_day="day")
        recording = FieldRecording(name, tmp_path, condition, odometry, (), prior=prior, prior_sigma_m=3.0)
        drives.append(Drive(recording, nodes, tmp_path / name))
    refused = unregistered((0, 0), np.eye(4), length_mismatch_message(LengthRatio(1.08, 0.01)))
    for found, notes in (([refused], 2), ([], 0)):
        monkeypatch.setattr(two_drives, "register_along", lambda *_, found=found, **__: found)
        said: list[str] = []
        unit = RegistrationUnit(drives[0], drives[1], AlignmentOptions())
        assert two_drives.register_query(unit, said.append) == found
        assert len(said) == notes
        if notes:
            by_gnss = r"by odometry than by GNSS \(known to 2\.\d %\)"
            assert re.fullmatch(rf"summer is 0\.\d % (longer|shorter) {by_gnss}", said[0])
            assert re.fullmatch(rf"winter is [78]\.\d % longer {by_gnss}", said[1])

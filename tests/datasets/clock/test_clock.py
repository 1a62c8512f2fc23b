"""The clock of poses by images: what is found where it is known, and that nothing is found where nothing is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from relocbench.arrays import Array, Times
from relocbench.datasets.clock.check import judge
from relocbench.datasets.clock.evidence import Evidence, gather
from relocbench.datasets.clock.tracks import Tracks
from relocbench.datasets.core.images import write_image
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.importers.tum_rgbd.dataset import Options
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.errors import ConfigError
from relocbench.geometry import Camera, invert, make_transform, se3_exp, so3_exp

CAMERA = Camera("pinhole", 640, 480, 520.0, 520.0, 319.5, 239.5)
START_NS = 1_700_000_000_000_000_000
IMAGES, RATE_HZ = 14, 30.0


def by_hand(seed: int) -> Callable[[Array], Array]:
    """``T_world_cam`` at seconds (N,) of a camera in a hand: about 1 rad/s and 0.3 m/s."""
    rng = np.random.default_rng(seed)
    knots = np.arange(-1.0, 3.0, 0.25)
    move, turn = (CubicSpline(knots, rng.normal(0, size, (len(knots), 3))) for size in (0.05, 0.1))
    return lambda seconds: make_transform(so3_exp(turn(seconds)), move(seconds))


def evenly(seconds: Array) -> Array:
    """A camera that moves on at one velocity."""
    return make_transform(so3_exp(np.outer(seconds, [0.0, 0.2, 0.0])), np.outer(seconds, [0.3, 0.0, 0.0]))


def evidence(motion: Callable[[Array], Array], readout_s: float, seed: int, depth: bool = True) -> Evidence:
    """Tracks of points in a room, off by 0.3 pixels, that a camera sees whose rows are read one after the other."""
    rng = np.random.default_rng([seed, 1])
    seconds = 0.3 + np.arange(IMAGES) / RATE_HZ
    tracks = []
    for i in range(IMAGES):
        for j in (k for k in (i + 1, i + 2, i + 4) if k < IMAGES):
            z = rng.uniform(0.8, 4.0, 100)
            seen = np.column_stack([rng.uniform(-0.5, 0.5, 100), rng.uniform(-0.4, 0.4, 100), np.ones(100)])
            T_first = motion(seconds[i] + readout_s * row_of(seen[:, 1]))
            points = np.einsum("nij,nj->ni", T_first[:, :3, :3], seen * z[:, None]) + T_first[:, :3, 3]
            y = np.zeros((100, 2))
            for _ in range(4):
                T_cam_world = invert(motion(seconds[j] + readout_s * row_of(y[:, 1])))
                there = np.einsum("nij,nj->ni", T_cam_world[:, :3, :3], points) + T_cam_world[:, :3, 3]
                y = there[:, :2] / there[:, 2:]
            noise = rng.normal(0, 0.3 / CAMERA.fx, (2, 100, 2))
            tracks.append(
                Tracks(
                    i,
                    j,
                    seen[:, :2] + noise[0],
                    y + noise[1],
                    row_of(seen[:, 1]),
                    row_of(y[:, 1]),
                    z if depth else np.full(100, np.nan),
                )
            )
    return Evidence("cam0", CAMERA.fx, np.eye(4), ns(seconds), np.zeros(IMAGES, dtype=np.int64), tuple(tracks))


def row_of(y: Array) -> Array:
    """Where between the first row (-0.5) and the last (0.5) rays are seen."""
    return y * CAMERA.fy / CAMERA.height


def ns(seconds: Array) -> Times:
    return START_NS + np.round(seconds * 1e9).astype(np.int64)


def capture(motion: Callable[[Array], Array], offset_s: float, seed: int) -> Trajectory:
    """Poses at 100 Hz with the noise of motion capture; an image at t has the pose at t + offset."""
    rng = np.random.default_rng([seed, 2])
    seconds = np.arange(0.0, 1.6, 0.01)
    noise = np.hstack([rng.normal(0, 0.001, (len(seconds), 3)), rng.normal(0, 1e-3, (len(seconds), 3))])
    return Trajectory(ns(seconds + offset_s), motion(seconds) @ se3_exp(noise))


@pytest.mark.thorough
@pytest.mark.parametrize("readout_s", [0.0, 0.025])
def test_an_offset_is_found_and_a_readout_is_not_taken_for_one(readout_s: float) -> None:
    motion = by_hand(1)
    found = judge(evidence(motion, readout_s, 1), capture(motion, -0.03, 1))
    assert found.verdict == "offset"
    assert {e.method for e in found.estimates} == {"lines", "points", "rotation"}
    assert abs(found.offset_s + 0.03) < min(4 * found.sigma_s, 0.0015)
    assert found.correction_s == pytest.approx(-0.03, abs=0.0011)
    if readout_s:
        assert found.readout_s == pytest.approx(readout_s, abs=0.004)
    # The residual that no clock explains is that of the noise of the poses.
    assert found.residual is not None
    assert found.residual_at_offset is not None
    assert found.residual_at_offset.deg < 0.4 * found.residual.deg


@pytest.mark.thorough
@pytest.mark.parametrize("depth", [True, False])
def test_no_offset_is_found_where_there_is_none(depth: bool) -> None:
    for seed in (2,) if not depth else (2, 3):
        motion = by_hand(seed)
        found = judge(evidence(motion, 0.02, seed, depth), capture(motion, 0.0, seed))
        assert found.verdict == "one clock"
        assert found.correction_s == 0.0
        assert abs(found.offset_s) < 4 * found.sigma_s


@pytest.mark.thorough
def test_even_motion_tells_no_offset() -> None:
    found = judge(evidence(evenly, 0.0, 4), capture(evenly, 0.04, 4))
    assert found.verdict == "cannot tell"
    assert found.correction_s == 0.0


@pytest.mark.thorough
def test_positions_of_another_clock_than_rotations_contradict_the_images() -> None:
    hand = by_hand(8)

    def motion(seconds: Array) -> Array:
        return make_transform(hand(seconds)[..., :3, :3], 4 * hand(seconds)[..., :3, 3])

    def parted(seconds: Array) -> Array:
        return make_transform(motion(seconds)[..., :3, :3], motion(seconds + 0.05)[..., :3, 3])

    found = judge(evidence(motion, 0.0, 8), capture(parted, 0.0, 8))
    assert found.verdict == "contradiction"
    assert found.correction_s == 0.0


@pytest.mark.thorough
def test_what_no_clock_explains_is_measured() -> None:
    motion = by_hand(5)
    seen = evidence(motion, 0.0, 5)

    def bent(seconds: Array) -> Array:
        return make_transform(motion(seconds)[..., :3, :3], 1.5 * motion(seconds)[..., :3, 3])

    right, wrong = (judge(seen, capture(path, 0.0, 5)).residual_at_offset for path in (motion, bent))
    assert right is not None
    assert wrong is not None
    assert wrong.mm > 2 * right.mm
    assert wrong.deg == pytest.approx(right.deg, abs=0.03)


def test_images_without_features_or_too_few_tell_nothing(tmp_path: Path) -> None:
    writer = DatasetWriter(tmp_path / "set", "set", {"kind": "test"})
    motion, seconds = by_hand(6), 0.3 + np.arange(6) / RATE_HZ
    small = Camera("pinhole", 64, 48, 60.0, 60.0, 31.5, 23.5)
    poses = dict(zip(ns(seconds).tolist(), motion(seconds), strict=True))
    writer.traversal(TraversalFile(name="a", cameras={"cam0": CameraEntry.of(small)}), poses)
    layout = DatasetLayout(tmp_path / "set").traversal("a")
    for time in poses:
        write_image(layout.image("cam0", time), np.zeros((48, 64), dtype=np.uint8))
    found = gather(
        Traversal(layout), "cam0", capture(motion, 0.0, 6), lambda title, step, units: list(map(step, units))
    )
    assert not isinstance(found, str)
    assert judge(found, capture(motion, 0.0, 6)).verdict == "cannot tell"
    few = Trajectory(ns(seconds)[:3], motion(seconds)[:3])
    assert isinstance(gather(Traversal(layout), "cam0", few, lambda title, step, units: list(map(step, units))), str)


def test_offsets_are_one_for_all_or_one_for_each() -> None:
    both = Options(time_offset=(-0.02, "estimate"))
    assert [both.time_offset_of(i) for i in (0, 1)] == [-0.02, None]
    both.check_time_offsets(2)
    with pytest.raises(ConfigError):
        both.check_time_offsets(3)

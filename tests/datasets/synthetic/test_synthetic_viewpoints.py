"""Viewpoints that were asked for: distances and angles of pairs, other lanes and directions, other cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from refusals import assert_names

from relocbench.datasets.pairs.posed_frames import PosedFrames
from relocbench.datasets.synthetic.jobs.pairs import DistanceSpread, drawn_pairs, nearest_miss
from relocbench.geometry import make_transform, so3_exp

SMOKE = ("build-dataset", "synthetic", "--preset", "smoke")


def turning(first_deg: float, per_frame_deg: float) -> PosedFrames:
    """A hundred frames, half a metre apart along a line, each turned further."""
    turns = np.radians(first_deg + per_frame_deg * np.arange(100))
    poses = np.array([make_transform(so3_exp([0, 0, a]), [0.5 * i, 0, 0]) for i, a in enumerate(turns)])
    return PosedFrames(tuple(range(100)), poses, frozenset(range(100)))


def test_pairs_have_the_distances_and_angles_that_were_asked_for() -> None:
    frames = turning(0.0, 0.0), turning(12.0, 0.4)
    spread = DistanceSpread(1.6, 12.0, 40.0, min_m=8.0, min_angle_deg=20.0)
    pairs = drawn_pairs(*frames, spread, np.random.default_rng(0), same_traversal=False)
    distances = np.array([p.distance_m or 0.0 for p in pairs])
    angles = np.array([p.angle_deg or 0.0 for p in pairs])
    assert len(pairs) == 51  # the others are turned by less than 20 or by more than 40 degrees
    assert distances.min() >= 8.0 - 1e-9
    assert distances.max() <= 12.0 + 1e-9
    assert np.histogram(distances, [7.9, 9.25, 10.75, 12.1])[0].min() >= 8
    assert angles.min() >= 20.0
    assert angles.max() <= 40.0


def test_without_a_least_distance_the_draws_are_those_of_before() -> None:
    """Drawn by the version that had no least distance."""
    drawn = DistanceSpread(1.6, 10.0, 30.0).draw(3, np.random.default_rng(5))
    np.testing.assert_allclose(drawn, [2.2239818576083348, 2.234706181041826, 1.4982454070391875], rtol=1e-9)


@pytest.mark.parametrize(
    ("spread", "told"),
    [
        (DistanceSpread(1.6, 90.0, 30.0, min_m=60.0), "is 49.5 m away"),
        (DistanceSpread(1.6, 5.0, 90.0, min_angle_deg=50.0), "is turned by 20 deg"),
        (DistanceSpread(1.6, 5.0, 15.0), "is turned by 20 deg"),
    ],
)
def test_what_came_nearest_is_told(spread: DistanceSpread, told: str) -> None:
    frames = turning(0.0, 0.0), turning(20.0, 0.0)
    assert drawn_pairs(*frames, spread, np.random.default_rng(0), same_traversal=False) == []
    assert nearest_miss(*frames, spread, same_traversal=False).endswith(told)


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (("--min-distance", "12"), ("min_distance", "max_distance")),
        (("--min-angle", "40"), ("min_angle", "max_angle")),
        (("--min-distance", "4", "--distance", "5"), ("--distance", "--min-distance")),
        (("--min-distance", "4", "--pair-rule", "nearest"), ("min_distance", "nearest")),
        (("--min-angle", "4", "--recording", "kitti"), ("--min-angle", "--recording")),
    ],
)
def test_mistakes_are_named(tmp_path: Path, options: tuple[str, ...], names: tuple[str, ...]) -> None:
    told = relocbench(*SMOKE, *options, "--out", tmp_path / "out")
    assert told.status == 2
    assert_names(told.complaint, "", None, *names)
    assert not (tmp_path / "out").exists()


def test_a_rule_that_no_pair_meets_is_refused_before_anything_is_rendered(tmp_path: Path) -> None:
    out = tmp_path / "out"
    told = relocbench(*SMOKE, "--min-distance", "8", "--quiet", "--out", out)
    assert told.status == 2
    assert_names(told.complaint, out, None, "test-Neutral-0__test-Neutral-0__front", "--min-distance", "2.41 m")
    assert [path.name for path in out.iterdir()] == ["build.yaml"]

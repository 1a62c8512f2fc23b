"""Pairs by rule."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from relocbench.arrays import Array
from relocbench.datasets.core.build_options import RuleOptions
from relocbench.datasets.pairs.pairing import make_pairs, nearest_matches, step_matches
from relocbench.datasets.pairs.posed_frames import PosedFrames
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import make_transform, rotation_angle, se3_exp, so3_exp


def row_of_cameras(xs: list[float], yaw_deg: float = 0.0, first_time: int = 0) -> PosedFrames:
    """Cameras along x, all keyframes, one a nanosecond."""
    poses = np.array([make_transform(so3_exp([0, np.radians(yaw_deg), 0]), [x, 0, 0]) for x in xs])
    times = tuple(range(first_time, first_time + len(xs)))
    return PosedFrames(times, poses.reshape(-1, 4, 4), frozenset(times))


def test_a_step_pairs_frame_i_with_frame_i_plus_k_and_has_the_pose_between_them() -> None:
    frames = row_of_cameras([0.0, 1.0, 3.0])
    pairs = make_pairs(frames, frames, RuleOptions(pair_step=(1, 2)), same_traversal=True, source="test")
    assert [(p.ref_timestamp_ns, p.query_timestamp_ns, p.group) for p in pairs] == [
        (0, 1, "step_1"),
        (1, 2, "step_1"),
        (0, 2, "step_2"),
    ]
    # The camera moved by +1 along x, so that points move by -1.
    assert pairs[0].T_query_ref is not None
    np.testing.assert_allclose(pairs[0].T_query_ref[:3, 3], [-1, 0, 0], atol=1e-12)


def test_a_gap_in_the_frame_numbers_is_honoured() -> None:
    frames = row_of_cameras([0.0, 1.0, 2.0])
    gapped = PosedFrames(frames.timestamps, frames.T_world_cam, frames.keyframes, numbers=(20, 21, 23))
    assert step_matches(gapped, (1, 2, 3)) == [(0, 1, "step_1"), (1, 2, "step_2"), (0, 2, "step_3")]


def test_only_frames_with_depth_are_references() -> None:
    frames = row_of_cameras([0.0, 1.0, 2.0])
    one = PosedFrames(frames.timestamps, frames.T_world_cam, frozenset({1}))
    assert step_matches(one, (1, -1)) == [(1, 2, "step_1"), (1, 0, "step_-1")]


def test_the_nearest_rule_takes_the_nearest_keyframe_within_both_limits() -> None:
    reference = row_of_cameras([0.0, 1.0, 2.0])
    query = row_of_cameras([0.4, 1.8, 9.0], first_time=100)
    assert nearest_matches(reference, query, 1.0, 10.0, same_traversal=False) == [(0, 0, "nearest"), (2, 1, "nearest")]


def test_the_nearest_rule_passes_over_a_near_keyframe_that_looks_elsewhere() -> None:
    near = row_of_cameras([0.0], yaw_deg=90)
    far = row_of_cameras([0.5])
    both = PosedFrames((0, 1), np.concatenate([near.T_world_cam, far.T_world_cam]), frozenset({0, 1}))
    assert nearest_matches(both, row_of_cameras([0.0], first_time=9), 1.0, 60.0, same_traversal=False) == [
        (1, 0, "nearest")
    ]


def test_a_frame_is_never_its_own_query() -> None:
    frames = row_of_cameras([0.0, 1.0])
    found = nearest_matches(frames, frames, 5.0, 60.0, same_traversal=True)
    assert found == [(1, 0, "nearest"), (0, 1, "nearest")]


def test_frames_of_two_traversals_may_have_the_same_time() -> None:
    frames = row_of_cameras([0.0, 1.0])
    found = nearest_matches(frames, frames, 5.0, 60.0, same_traversal=False)
    assert found == [(0, 0, "nearest"), (1, 1, "nearest")]


@pytest.mark.parametrize(
    ("query", "nearest"),
    [
        (row_of_cameras([7.0], 3.0, 100), ("6 m", "3 deg", "--max-distance")),
        (row_of_cameras([7.0], 90.0, 100), ("6 m", "90 deg", "--max-distance and --max-angle")),
        (row_of_cameras([1.5], 75.0, 100), ("0.5 m", "75 deg", "--max-angle")),
    ],
)
def test_an_empty_result_says_how_near_the_nearest_were(query: PosedFrames, nearest: tuple[str, ...]) -> None:
    reference = row_of_cameras([0.0, 1.0])
    with refused(DatasetError, "", None, *nearest):
        make_pairs(reference, query, RuleOptions(), same_traversal=False, source="test")


def test_an_empty_step_says_which_step_there_is() -> None:
    frames = row_of_cameras([0.0, 2.5])
    gapped = PosedFrames(frames.timestamps, frames.T_world_cam, frozenset({0}), numbers=(0, 5))
    with refused(DatasetError, "", None, "+5", "2.5", "0", "--pair-step", "5"):
        make_pairs(gapped, gapped, RuleOptions(), same_traversal=True, source="test")


def test_no_keyframe_is_said_as_such() -> None:
    frames = row_of_cameras([0.0, 1.0])
    bare = PosedFrames(frames.timestamps, frames.T_world_cam, frozenset())
    with refused(DatasetError, "", None, "keyframe", "depth"):
        make_pairs(bare, bare, RuleOptions(), same_traversal=True, source="test")


def test_steps_across_two_traversals_are_refused() -> None:
    frames = row_of_cameras([0.0, 1.0])
    with pytest.raises(ConfigError, match="nearest"):
        make_pairs(frames, frames, RuleOptions(pair_rule="step"), same_traversal=False, source="test")


def brute_force(reference: Array, query: Array, distance: float, angle: float) -> list[int]:
    """For each query the nearest admissible reference, or -1, by looking at all."""
    found = []
    for T_world_query in query:
        best, best_distance = -1, np.inf
        for r, T_world_ref in enumerate(reference):
            T = np.linalg.inv(T_world_query) @ T_world_ref
            d, a = float(np.linalg.norm(T[:3, 3])), float(np.degrees(rotation_angle(T[:3, :3])))
            if d <= distance and a <= angle and d < best_distance:
                best, best_distance = r, d
        found.append(best)
    return found


@pytest.mark.thorough
@given(st.integers(0, 10_000), st.floats(0.1, 4.0), st.floats(5.0, 170.0))
def test_the_nearest_rule_agrees_with_looking_at_all(seed: int, distance: float, angle: float) -> None:
    rng = np.random.default_rng(seed)
    reference, query = se3_exp(rng.normal(size=(12, 6))), se3_exp(rng.normal(size=(7, 6)))
    frames = PosedFrames(tuple(range(12)), reference, frozenset(range(12)))
    others = PosedFrames(tuple(range(100, 107)), query, frozenset())
    got = {q: r for r, q, _ in nearest_matches(frames, others, distance, angle, same_traversal=False)}
    assert [got.get(q, -1) for q in range(7)] == brute_force(reference, query, distance, angle)

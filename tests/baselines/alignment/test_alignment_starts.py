"""Where the starts of an alignment stand."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from baselines.alignment.shared.starts import moved_along
from relocbench.geometry import invert, rotation_angle, se3_exp

metres = st.floats(-20, 20).filter(lambda by: abs(by) > 1e-3)
turns = st.floats(-1.5, 1.5)


def test_without_a_turn_the_camera_stays_on_its_optical_axis() -> None:
    ahead, behind = moved_along(np.eye(4), [3.0, -2.0])
    np.testing.assert_allclose(ahead, [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -3], [0, 0, 0, 1]], atol=1e-15)
    np.testing.assert_allclose(invert(behind)[:3, 3], [0, 0, -2], atol=1e-15)


@given(by=metres, turn=turns)
def test_the_camera_stands_at_the_end_of_a_level_arc(by: float, turn: float) -> None:
    """A chord of an arc of length s and angle a is 2 s / a sin(a / 2) long and leaves it at half the angle."""
    T_ref_query = invert(moved_along(np.eye(4), [by], [turn])[0])
    chord = by * np.sinc(turn / (2 * np.pi))
    expected = chord * np.array([np.sin(turn / 2), 0.0, np.cos(turn / 2)])
    np.testing.assert_allclose(T_ref_query[:3, 3], expected, atol=1e-9)
    np.testing.assert_allclose(T_ref_query[:3, 2], [np.sin(turn), 0.0, np.cos(turn)], atol=1e-9)
    assert abs(rotation_angle(T_ref_query[:3, :3]) - abs(turn)) < 1e-9


@given(by=metres, turn=turns, seed=st.integers(0, 99))
def test_arcs_begin_where_the_camera_is(by: float, turn: float, seed: int) -> None:
    T_query_ref = se3_exp(np.random.default_rng(seed).normal(size=6))
    there = moved_along(T_query_ref, [by], [turn])[0]
    np.testing.assert_allclose(moved_along(there, [-by], [-turn])[0], T_query_ref, atol=1e-9)
    np.testing.assert_allclose(there @ invert(T_query_ref), moved_along(np.eye(4), [by], [turn])[0], atol=1e-9)


def test_there_is_a_start_for_each_length_and_turn() -> None:
    poses = moved_along(np.eye(4), [1.0, 2.0], [-0.1, 0.0, 0.1])
    lengths = [round(float(np.linalg.norm(T[:3, 3])), 2) for T in poses]
    assert lengths == [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]

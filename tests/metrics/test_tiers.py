"""Tiers of difficulty: which limits make a pair easy, and what is not known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from relocbench.metrics import PairScores, PoseErrors, summarize_scores
from relocbench.metrics.pose.tiers import LIMITS, LOOKS, TIERS, looks, tiers

NAN = float("nan")


def tier(overlap: float, back: float = NAN, scale: float = 1.0, angle: float = 0.0, depth: float = 0.0) -> str:
    index = tiers(*(np.array([value]) for value in (overlap, back, scale, angle, depth)))[0]
    return "" if index < 0 else TIERS[index]


def test_a_pair_is_as_hard_as_the_hardest_of_its_measures() -> None:
    assert tier(0.5, 0.9, 1.15, 5.0, 0.015) == "easy"
    assert tier(0.9, 0.49) == tier(0.49) == tier(0.9, scale=1.16) == tier(0.9, angle=5.1) == tier(0.9, depth=0.02)
    assert tier(0.49) == "medium"
    assert tier(0.9, 0.19) == tier(0.9, scale=1.41) == tier(0.9, angle=25.1) == tier(0.9, depth=0.031) == "hard"
    assert tier(0.09) == tier(0.9, scale=1.81) == tier(0.9, angle=46.0) == tier(0.9, depth=0.061) == "extreme"


def test_what_is_not_known_makes_no_tier_and_an_unknown_error_of_depth_limits_nothing() -> None:
    assert tier(NAN, 0.9) == tier(0.9, scale=NAN) == tier(0.9, angle=NAN) == ""
    assert tier(0.0, scale=NAN) == "extreme"
    assert tier(0.9, 0.9, depth=NAN) == tier(0.9, NAN, depth=0.0) == "easy"


def test_pairs_of_datasets_that_were_built_before_these_measures_have_no_tier() -> None:
    assert tier(0.9, NAN, depth=NAN) == ""
    assert tier(0.0, NAN, depth=NAN) == "extreme"


@given(
    st.floats(0, 1), st.floats(0, 1), st.floats(1, 3), st.floats(0, 180), st.floats(0, 0.2),
    st.floats(0, 1), st.floats(0, 1), st.floats(0, 90), st.floats(0, 0.1),
)  # fmt: skip
def test_a_pair_that_demands_more_is_in_no_easier_tier(
    overlap: float, back: float, scale: float, angle: float, depth: float,
    less: float, closer: float, turn: float, worse: float,
) -> None:  # fmt: skip
    harder = overlap * less, back * less, scale + closer, angle + turn, depth + worse
    assert TIERS.index(tier(*harder)) >= TIERS.index(tier(overlap, back, scale, angle, depth))


def test_looks_follow_the_correlation_of_patches() -> None:
    found = looks(np.array([1.0, 0.8, 0.79, 0.5, 0.49, -1.0, NAN]))
    assert [LOOKS[k] for k in found[:-1]] == ["alike", "alike", "changed", "changed", "different", "different"]
    assert found[-1] == -1


def test_recall_is_given_for_each_tier_that_has_pairs() -> None:
    assert list(LIMITS) == list(TIERS[:-1])
    error = np.array([0.0, 1.0, 0.0, np.inf])
    errors = PoseErrors(error, error, error)
    overlap, ones = np.array([0.9, 0.9, 0.3, 0.05]), np.ones(4)
    scores = PairScores(
        errors,
        overlap=overlap,
        overlap_query=overlap,
        scale_change=ones,
        angle_deg=ones,
        similarity=np.array([1, 0, 0, 0.6]),
    )
    summary = summarize_scores(scores)
    name = "recall_{}@(0.25m,2deg)"
    assert [summary[name.format(t)] for t in TIERS] == [0.5, 1.0, None, 0.0]
    assert [summary[name.format(f"look_{look}")] for look in LOOKS] == [1.0, 0.0, pytest.approx(0.5)]

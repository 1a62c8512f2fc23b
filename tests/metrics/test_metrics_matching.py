"""Matching quality: shares of correspondences found again."""

from __future__ import annotations

import numpy as np
import pytest

from relocbench.metrics import matching_quality


def test_hand_value_overall_and_by_start_offset() -> None:
    truth = np.array([[10.0, 10], [20, 20], [30, 30], [40, 40]])
    end = truth + np.array([[1, 0], [0, 3], [3, 3], [0, 0]])  # 1, 3, 4.2 and 0 px off
    quality = matching_quality(end, truth, [1.0, 2.0, 16.0, 16.0])
    assert quality.count == 4
    assert quality.share == {"match@1px": 0.5, "match@3px": 0.75}
    assert quality.start_share == {"match@1px": 0.25, "match@3px": 0.5}
    groups = {(g.low_px, g.high_px): (g.count, g.share["match@1px"]) for g in quality.by_offset}
    assert groups == {(0, 1): (1, 1.0), (1, 2): (1, 0.0), (2, 4): (0, None), (4, 8): (0, None), (8, 16): (2, 0.5)}


def test_a_failed_or_lost_pixel_is_not_found_and_stays_in_the_denominator() -> None:
    truth = np.zeros((4, 2))
    end = np.array([[0, 0], [np.nan, np.nan], [0, np.inf], [0, 0]])
    assert matching_quality(end, truth, np.ones(4)).share["match@3px"] == 0.5


def test_start_offsets_may_be_vectors_whose_length_counts_up_to_rounding() -> None:
    angle = np.linspace(0, 6, 50)
    offset = 8 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    quality = matching_quality(np.zeros((50, 2)), np.zeros((50, 2)), offset)
    assert {(g.high_px, g.count) for g in quality.by_offset if g.count} == {(8.0, 50)}


def test_every_start_is_in_exactly_one_group() -> None:
    rng = np.random.default_rng(0)
    start = np.concatenate([rng.uniform(0, 16, 500), [0, 1, 2, 4, 8, 16]])
    truth = rng.uniform(0, 100, (506, 2))
    quality = matching_quality(truth + rng.normal(0, 2, (506, 2)), truth, start)
    assert sum(g.count for g in quality.by_offset) == 506
    weighted = sum(g.count * (g.share["match@3px"] or 0) for g in quality.by_offset) / 506
    assert weighted == pytest.approx(quality.share["match@3px"])


def test_starts_outside_the_groups_and_wrong_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="offsets"):
        matching_quality(np.zeros((1, 2)), np.zeros((1, 2)), [17.0])
    with pytest.raises(ValueError, match="matching"):
        matching_quality(np.zeros((2, 2)), np.zeros((1, 2)), [1.0])
    with pytest.raises(ValueError, match="matching"):
        matching_quality(np.zeros((0, 2)), np.zeros((0, 2)), [])


def test_a_solver_that_does_not_move_finds_what_the_starts_found() -> None:
    rng = np.random.default_rng(1)
    truth, angle = rng.uniform(0, 500, (400, 2)), rng.uniform(0, 2 * np.pi, 400)
    start = truth + np.repeat([1.0, 3.0], 200)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    quality = matching_quality(start, truth, start - truth)
    assert quality.share == quality.start_share == {"match@1px": 0.5, "match@3px": 1.0}

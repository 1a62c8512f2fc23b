"""Confidences are probabilities that never fall with the evidence, and the fit finds those that the data have."""

from __future__ import annotations

from typing import Any

import calibration as script
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repository import ROOT

from baselines import calibration as kept
from baselines.calibration import Calibration
from baselines.learned_pnp import AlikedPnp


def test_the_confidence_is_the_logistic_function_of_the_evidence() -> None:
    calibration = Calibration(-2.0, {"points": 0.5, "share": 3.0})
    assert calibration.confidence({"points": 4, "share": 0.0, "other": 9.0}) == 0.5
    assert calibration.confidence({"points": 4, "share": 1.0}) == pytest.approx(1 / (1 + np.exp(-3.0)))


def test_a_weight_below_zero_is_refused() -> None:
    with pytest.raises(ValueError, match="0"):
        Calibration(0.0, {"points": -0.1})


@given(st.floats(-1e6, 1e6), st.floats(0, 1e6), st.floats(0, 1e4), st.floats(0, 1e4))
def test_more_evidence_never_lowers_the_confidence(offset: float, weight: float, one: float, other: float) -> None:
    calibration = Calibration(offset, {"x": weight})
    less, more = (calibration.confidence({"x": x}) for x in sorted((one, other)))
    assert 0.0 <= less <= more <= 1.0


@pytest.mark.parametrize("seed", range(3))
def test_the_fit_finds_the_probabilities_that_right_answers_were_drawn_with(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = Calibration(-2.0, {"a": 5.0, "b": 0.5})
    evidence = rng.uniform([0, 0], [1, 4], (4000, 2))
    probability = np.array([true.confidence({"a": a, "b": b}) for a, b in evidence])
    found = script.fit(evidence, rng.random(4000) < probability, ["a", "b"])
    again = np.array([found.confidence({"a": a, "b": b}) for a, b in evidence])
    assert np.abs(again - probability).max() < 0.08


def test_evidence_that_speaks_against_an_answer_gets_no_weight() -> None:
    x = np.linspace(0, 1, 200)
    found = script.fit(np.stack([x, 1 - x], axis=1), x > 0.4, ["for", "against"])
    assert found.weights["against"] == pytest.approx(0.0, abs=1e-6)
    assert found.weights["for"] > 1.0


def test_the_reliability_table_counts_answers_and_faults() -> None:
    def answer(x: float | None, right: bool, different: bool, same_drive: bool = False) -> Any:
        return script.Answered(different, same_drive, x is not None, right, {} if x is None else {"x": x})

    answers = [
        *[answer(9.0, True, False)] * 2,
        answer(9.0, True, False, same_drive=True),
        answer(9.0, False, False, same_drive=True),
        answer(-9.0, True, False),
        answer(9.0, False, True),
        answer(-9.0, False, True),
        answer(None, False, True),
    ]
    told = script.reliability(answers, Calibration(0.0, {"x": 1.0}))
    assert (told["pairs of one place"], told["pairs of different places"]) == (5, 3)
    assert (told["sure"], told["precision of sure ones"]) == (5, 3 / 5)
    assert (told["sure, in one drive"], told["precision in one drive"]) == (2, 1 / 2)
    assert told["right ones that are sure"] == 3 / 4
    assert told["sure of different places"] == 1 / 3
    assert [(row["answers"], row["right"]) for row in told["bins"]] == [(2, 0.5), (5, 3 / 5)]


@pytest.mark.thorough
def test_every_method_of_the_script_has_a_calibration_of_its_evidence() -> None:
    constants = [value for value in vars(kept).values() if isinstance(value, Calibration)]
    for name, make in script.METHODS.items():
        calibration = AlikedPnp.calibration if name in script.GIVEN_WEIGHTS else make().calibration
        assert calibration in constants, name


def test_the_districts_are_no_test_districts_and_each_shows_another_one() -> None:
    page = (ROOT / "docs" / "test-districts.md").read_text()
    assert not any(f"| {seed} |" in page for seed in script.VALIDATION)
    assert [script.neighbour(seed, [51, 52, 53]) for seed in (51, 52, 53)] == [52, 51, 52]

"""The tables of experiments on the validation districts follow from the answers that are kept."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import keyframe_start
import numpy as np
import pytest
import refined
from answers import ANGLE_DEG, POSITION_M, Answer, Question, kept

from relocbench.geometry import se3_exp
from relocbench.metrics import pose_errors
from relocbench.tracking import Query, Reference


def answer(row: str, right: bool, same_drive: bool = False, distance_m: float = 3.0) -> Answer:
    return Answer(row, same_drive, distance_m, ("clear", "rain"), 0.01 if right else 3.0, 0.1 if right else 20.0)


def test_an_answer_is_right_at_both_thresholds_and_not_beyond_one() -> None:
    def judged(metres: float | None, degrees: float | None) -> Answer:
        return Answer("row", False, 1.0, ("clear", "rain"), metres, degrees)

    assert judged(POSITION_M, ANGLE_DEG).right == 1
    assert judged(POSITION_M + 1e-6, ANGLE_DEG).right == 0
    assert judged(POSITION_M, ANGLE_DEG + 1e-6).right == 0
    assert judged(None, None).right == judged(None, None).area == 0
    assert [judged(0.0, degrees).area for degrees in (0.0, 0.25, 0.5, 9.0)] == [1, 0.5, 0, 0]


def test_a_question_judges_by_its_truth() -> None:
    rng = np.random.default_rng(0)
    truth, pose = se3_exp(rng.standard_normal(6)), se3_exp(rng.standard_normal(6))
    question = Question(object.__new__(Reference), object.__new__(Query), truth, True, 1.5, 2.0, ("clear", "rain"))
    errors = pose_errors(pose[None], truth[None])
    found = question.answer("row", pose)
    assert (found.translation_m, found.rotation_deg) == (errors.translation_error_m[0], errors.rotation_error_deg[0])
    assert (found.same_drive, found.distance_m, found.conditions) == (True, 1.5, ("clear", "rain"))
    assert question.answer("row", None).translation_m is None


def test_kept_answers_are_made_once_and_a_failure_leaves_none(tmp_path: Path) -> None:
    path, made = tmp_path / "new" / "answers.jsonl", [answer("a", True), answer("b", False)]

    def failing() -> Iterator[Answer]:
        yield made[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kept(path, failing)
    assert not path.exists()
    assert kept(path, lambda: made) == made
    assert kept(path, failing) == made


def test_starts_are_compared_with_those_of_the_first_weights(capsys: pytest.CaptureFixture[str]) -> None:
    rights = {"first": (False, False), "second": (True, False)}
    of_weights = {
        name: {seed: [answer(start, right) for start in keyframe_start.STARTS for right in which] for seed in (1, 2, 3)}
        for name, which in rights.items()
    }
    of_weights["orb-pnp"] = {seed: [answer(keyframe_start.KEYFRAME, True)] * 2 for seed in (1, 2, 3)}
    told = keyframe_start.table("farther", of_weights, lambda each: not each.same_drive)
    page = capsys.readouterr().out
    assert "6 pairs of 3 districts" in page
    assert "| first | 0.0 | 0.0 | 0.0 | 0.0 |  |  |" in page
    assert "| second | 50.0 | 50.0 | 50.0 | 50.0 | +50.0 | +50.0 |" in page
    assert "| orb-pnp | 100.0 |  |  |  | +100.0 |  |" in page
    assert told["second"][keyframe_start.KEYFRAME] == 50.0


def test_alignment_is_compared_with_the_pose_that_it_starts_from(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {refined.ALONE: (True, True), **dict.fromkeys(refined.LEVELS, (True, False))}
    answers = {seed: [answer(row, right) for row, which in rows.items() for right in which] for seed in (1, 2, 3)}
    told = refined.table("all pairs", answers)
    page = capsys.readouterr().out
    assert f"| {refined.ALONE} | 100.0 | 80.0 |  |  |" in page
    assert "| coarsest | 50.0 | 40.0 | -50.0 | -40.0 |" in page
    assert told["0"] == {"right": 50.0, "r_auc": pytest.approx(40.0)}

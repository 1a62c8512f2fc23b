"""Checking that a tracker keeps the contract, on a few easy and hopeless pairs."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import DatasetError
from relocbench.evaluation.common.contract import Finding, attempt, constructed, constructed_again
from relocbench.evaluation.isolation.answers import CheckedAnswer, ask, checked_answer, checked_pixels, error_answer
from relocbench.evaluation.isolation.guard import batch_of, guarded, implements, neighbours_of
from relocbench.evaluation.isolation.info_text import INFO_CHARACTERS
from relocbench.evaluation.isolation.views import masked_query, masked_reference
from relocbench.execution import messages_to_stderr
from relocbench.geometry import Camera
from relocbench.methods import MethodSpec
from relocbench.metrics import CONFIDENT
from relocbench.tracking import (
    KeyframePoints,
    Query,
    Reference,
    SupportsBatch,
    SupportsMatching,
    SupportsPrepare,
)

_ADVICE = "to report a failure, return TrackResult.failure"
_WIDTH, _HEIGHT, _FOCAL, _WALL_M = 320, 240, 250.0, 4.0


@dataclass(frozen=True)
class _Question:
    name: str
    reference: Reference
    query: Query
    hopeless: bool = False
    """whether nothing in the images says where the query was taken"""

    def shown(self, times: bool) -> _Question:
        """The views as an evaluation gives them, but writable: a method that writes to them is reported."""
        reference, query = masked_reference(self.reference, times), masked_query(self.query, times)
        writable = self.reference
        return _Question(
            self.name,
            replace(reference, image=writable.image, depth=writable.depth),
            replace(query, image=self.query.image),
            self.hopeless,
        )


def check(spec: MethodSpec, dataset: Path | None = None) -> list[Finding]:
    """Try a tracker on synthetic views of a textured wall and, with a dataset, on its first pairs.

    Raises:
        MethodError: the method cannot be constructed.
        DatasetError: the dataset is bad.
    """
    tracker, finding = constructed(spec)
    findings = [finding]
    if not finding.passed:
        return findings
    if guarded(lambda: callable(getattr(tracker, "track", None)))[0] is not True:
        return [*findings, Finding("has track()", False, f"{type(tracker).__name__} has none")]
    times = guarded(lambda: bool(getattr(tracker, "uses_times", False)))[0] is True
    questions = [each.shown(times) for each in _made_up() + (_from_dataset(dataset) if dataset else [])]
    wanted, fault = neighbours_of(tracker)
    if wanted or fault is not None:
        told = f"{wanted} on each side of a keyframe; there are none where a pair set asks the keyframe's drive"
        findings.append(Finding("says how many neighbours it wants", fault is None, fault or told))
    _, fault = batch_of(tracker)
    if fault is not None:
        findings.append(Finding("says how many queries it takes at once", False, fault))
    answers = [_ask(tracker, question) for question in questions]
    for question, answer in zip(questions, answers, strict=True):
        findings.append(_answers(question, answer))
    usable = [i for i, answer in enumerate(answers) if answer.status != "error"]
    findings.append(_repeatable(spec, tracker, questions, answers, usable))
    findings.append(_leaves_input_alone(tracker, questions[0]))
    if implements(tracker, SupportsBatch) and usable:
        findings.append(_batch_agrees(tracker, questions[usable[0]], answers[usable[0]]))
    if implements(tracker, SupportsMatching):
        findings += [_matches(tracker, question) for question in questions]
        findings.append(_matches_by_pixel(spec, tracker, questions[0]))
    _close(tracker)
    return findings


def _answers(question: _Question, answer: CheckedAnswer) -> Finding:
    """Whether an answer keeps the contract; one that is confident where nothing is to be known is doubtful."""
    detail, sure = _words(answer), question.hopeless and (answer.confidence or 0.0) >= CONFIDENT
    if sure and answer.T_query_ref is not None:
        detail += f", although nothing says where it is: below {CONFIDENT:g} is expected"
        return Finding(f"answers {question.name}", True, detail, doubtful=True)
    return Finding(f"answers {question.name}", answer.status != "error", detail)


def _close(tracker: Any) -> None:
    """Ask a tracker that is a program to end."""
    close, problem = guarded(lambda: getattr(tracker, "close", None))
    if problem is None and callable(close):
        attempt(close, _ADVICE)


def _ask(tracker: Any, question: _Question) -> CheckedAnswer:
    result, problem = attempt(lambda: tracker.track(_prepared(tracker, question), question.query, None), _ADVICE)
    return error_answer(problem) if problem else checked_answer(result)


def _prepared(tracker: Any, question: _Question) -> Any:
    return tracker.prepare(question.reference) if implements(tracker, SupportsPrepare) else question.reference


def _repeatable(
    spec: MethodSpec, tracker: Any, questions: list[_Question], answers: list[CheckedAnswer], usable: list[int]
) -> Finding:
    """Ask the same tracker and a fresh one again, in another order: the answers must be equal."""
    name = "gives the same answer in any order of calls"
    fresh, unmade = constructed_again(spec)
    if unmade is not None:
        return Finding(name, False, unmade)
    message = None
    for other in (tracker, fresh):
        for i in reversed(usable):
            again = _ask(other, questions[i])
            if message is None and again.status == "error":
                message = f"{questions[i].name}: {again.message}"
            elif message is None and not _same_pose(again, answers[i]):
                message = f"{questions[i].name}: another pose than the first time"
    _close(fresh)
    return Finding(name, message is None, message or "")


def _same_pose(a: CheckedAnswer, b: CheckedAnswer) -> bool:
    if a.T_query_ref is None or b.T_query_ref is None:
        return a.T_query_ref is b.T_query_ref
    return bool(np.array_equal(a.T_query_ref, b.T_query_ref))


def _leaves_input_alone(tracker: Any, question: _Question) -> Finding:
    reference, query = question.reference, question.query
    given: list[NDArray[Any]] = [reference.image, query.image]
    if reference.depth is not None:
        given.append(reference.depth)
    before = [array.copy() for array in given]
    _ask(tracker, question)
    kept = all(np.array_equal(was, now) for was, now in zip(before, given, strict=True))
    return Finding("leaves the images it is given unchanged", kept)


def _batch_agrees(tracker: Any, question: _Question, single: CheckedAnswer) -> Finding:
    name = "track_batch agrees with track"
    reference, problem = attempt(lambda: _prepared(tracker, question), _ADVICE)
    if problem is None:
        with messages_to_stderr():
            answers, _ = ask(tracker, reference, [question.query] * 2)
        problem = next((answer.message for answer in answers if answer.status == "error"), None)
        if problem is None and not all(_close_pose(answer, single) for answer in answers):
            problem = "another pose than track() by more than 1e-6"
    return Finding(name, problem is None, problem or "")


def _pixels(question: _Question) -> tuple[Array, Array]:
    """A grid of reference pixels that reaches into the corners, and start pixels in the query near them."""
    camera = question.reference.camera
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 9), np.linspace(0, camera.height - 1, 7))
    uv_ref = np.stack([u, v], axis=-1).reshape(-1, 2)
    return uv_ref, np.clip(uv_ref + np.array([2.5, -1.5]), 0, np.array(camera.size) - 1)


def _match(tracker: Any, question: _Question, rows: slice = slice(None)) -> tuple[Any, str | None]:
    uv_ref, uv_start = (uv[rows].copy() for uv in _pixels(question))
    ends, problem = attempt(
        lambda: tracker.match(_prepared(tracker, question), question.query, uv_ref, uv_start), _ADVICE
    )
    return checked_pixels(ends, problem, len(uv_ref))


def _matches(tracker: Any, question: _Question) -> Finding:
    ends, problem = _match(tracker, question)
    message = problem or f"{np.isfinite(ends).all(axis=1).sum()} of {len(ends)} pixels answered"
    return Finding(f"match answers {question.name}", problem is None, message)


def _matches_by_pixel(spec: MethodSpec, tracker: Any, question: _Question) -> Finding:
    """Match from a fresh tracker, with half of the pixels, and with none: results must be equal to the last bit."""
    name = "match answers each pixel by itself, and the same again"
    fresh, problem = constructed_again(spec)
    if problem:
        return Finding(name, False, problem)
    whole, problem = _match(tracker, question)
    for other, rows in ((fresh, slice(None)), (tracker, slice(1, None, 2)), (fresh, slice(0, 0))):
        again, fault = _match(other, question, rows)
        problem = problem or fault
        if problem is None and not np.array_equal(again, whole[rows], equal_nan=True):
            problem = "other pixels than the first time"
    _close(fresh)
    return Finding(name, problem is None, problem or "")


def _close_pose(a: CheckedAnswer, b: CheckedAnswer) -> bool:
    if a.T_query_ref is None or b.T_query_ref is None:
        return a.T_query_ref is b.T_query_ref
    return bool(np.abs(a.T_query_ref - b.T_query_ref).max() < 1e-6)


def _words(answer: CheckedAnswer) -> str:
    if answer.T_query_ref is None:
        return f"{'failure: ' if answer.status == 'failed' else ''}{answer.message}"
    confidence = "" if answer.confidence is None else f", confidence {answer.confidence:.4g}"
    cut = json.loads(answer.info).get("cut") is True
    return f"a pose{confidence}{f', info over {INFO_CHARACTERS} characters is not kept' if cut else ''}"


def _made_up() -> list[_Question]:
    """Synthetic pairs: a textured wall 4 m away, moved sideways, with dense and sparse depth, and hopeless variants."""
    camera = Camera("pinhole", _WIDTH, _HEIGHT, _FOCAL, _FOCAL, _WIDTH / 2 - 0.5, _HEIGHT / 2 - 0.5)
    rng = np.random.default_rng(0)
    texture = _smooth(rng.random((_HEIGHT + 80, _WIDTH + 80)))
    here, moved = texture[40:-40, 40:-40], texture[40:-40, 45:-35]
    depth = np.full((_HEIGHT, _WIDTH), _WALL_M, dtype=np.float32)
    elsewhere = _smooth(np.random.default_rng(1).random((_HEIGHT, _WIDTH)))
    noise = (rng.random((_HEIGHT, _WIDTH)) * 255).astype(np.uint8)
    dense = Reference("check/dense", 0, here, camera, depth=depth)
    uv = np.stack(np.meshgrid(np.arange(8.0, _WIDTH - 8, 6), np.arange(8.0, _HEIGHT - 8, 6)), -1).reshape(-1, 2)
    points = KeyframePoints(uv, np.full(len(uv), 1 / _WALL_M), np.full(len(uv), 1e-3))
    sparse = Reference("check/sparse", 1, here, camera, sparse_points=points)
    colour = Reference("check/colour", 2, np.stack([here] * 3, axis=-1), camera, depth=depth)
    nothing = Reference("check/no-depth", 3, here, camera, depth=np.zeros_like(depth))
    black = np.zeros((_HEIGHT, _WIDTH), dtype=np.uint8)
    return [
        _Question("a pair with dense depth", dense, Query("check/a", 10, moved, camera)),
        _Question("a pair with sparse points", sparse, Query("check/b", 11, moved, camera)),
        _Question("a pair in colour", colour, Query("check/c", 12, np.stack([moved] * 3, axis=-1), camera)),
        _Question("a query that shows nothing known", dense, Query("check/d", 13, noise, camera), hopeless=True),
        _Question("a query of a different place", dense, Query("check/g", 16, elsewhere, camera), hopeless=True),
        _Question("a black query", dense, Query("check/e", 14, black, camera), hopeless=True),
        _Question("a keyframe without depth", nothing, Query("check/f", 15, moved, camera)),
    ]


def _smooth(values: Array) -> Image:
    """Smooth noise at several scales into a texture with corners and slopes."""
    total = np.zeros_like(values)
    for size in (3, 9, 27):
        kernel = np.ones(size) / size
        level = values
        for axis in (0, 1):
            level = np.apply_along_axis(np.convolve, axis, level, kernel, mode="same")
        total += (level - level.mean()) / level.std()
    scaled = (total - total.min()) / (total.max() - total.min())
    out: Image = np.rint(scaled * 255).astype(np.uint8)
    return out


def _from_dataset(path: Path) -> list[_Question]:
    dataset = Dataset(path)
    dataset.require_images(dataset.pair_sets(), "there is nothing to try a method on")
    for pair_set in dataset.pair_sets():
        if pair_set.pairs:
            asked = [*((p, "") for p in pair_set.pairs[:2]), *((p, "negative ") for p in pair_set.negative_pairs[:2])]
            return [
                _Question(
                    f"{negative}pair {p.key[0]} {p.key[1]}",
                    dataset.reference(pair_set, p),
                    dataset.query(pair_set, p),
                    hopeless=bool(negative),
                )
                for p, negative in asked
            ]
    raise DatasetError("holds no pair to try the method on", path)

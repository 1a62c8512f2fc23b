"""The optional capabilities of a method, and whether it can be constructed, tested in a worker and within limits."""

from __future__ import annotations

from dataclasses import dataclass

from relocbench.evaluation.common.guard import guarded
from relocbench.evaluation.common.worker import CONSTRUCTOR
from relocbench.execution import MANY_TIMES, Loss, Run, run_limited, step
from relocbench.methods import SUBPROCESS, MethodSpec, method_class


@dataclass(frozen=True)
class Offers:
    """The optional questions that a tracker can answer."""

    match: bool = False
    """where single pixels of the reference are in the query"""
    prior: bool = False
    """the pose of a query, started from a prior"""
    fault: str = ""
    """why nothing is known: constructing the tracker exceeded a limit or ended its process"""


def offers_of(spec: MethodSpec, run: Run) -> Offers:
    """The capabilities of a method. Those of a class are read from it; a factory has to be called for them.

    Raises:
        MethodError: no such method, or its constructor raised.
    """
    if spec.target.startswith(SUBPROCESS):
        return Offers()
    target = method_class(spec.target)
    return _told_by(target) if isinstance(target, type) else _made(spec, run)


def can_be_made(spec: MethodSpec, run: Run) -> str:
    """Why a method cannot be constructed within limits; empty if it can. Raises MethodError where that raises."""
    return "" if spec.target.startswith(SUBPROCESS) else _made(spec, run).fault


def _made(spec: MethodSpec, run: Run) -> Offers:
    here = Run(min(run.workers, 1), limits=run.limits)
    found = run_limited(_make, [spec], here, on_loss=_lost)
    return next(offers for _, offers in found)


def _make(spec: MethodSpec) -> Offers:
    with step(CONSTRUCTOR, times=MANY_TIMES):
        return _told_by(spec.create())


def _told_by(target: object) -> Offers:
    match = guarded(lambda: callable(getattr(target, "match", None)))[0] is True
    return Offers(match, guarded(lambda: bool(getattr(target, "uses_prior", False)))[0] is True)


def _lost(spec: MethodSpec, loss: Loss) -> Offers:
    died = "the worker process died " if loss.kind == "death" else ""
    return Offers(fault=f"{CONSTRUCTOR}: {died}{f'({loss.words})' if died else loss.words}")

"""What a method offers, and whether it can be made: found out where it is asked, in a worker and within limits."""

from __future__ import annotations

from dataclasses import dataclass

from relocbench.evaluation.common.guard import guarded
from relocbench.evaluation.common.worker import CONSTRUCTOR
from relocbench.execution import MANY_TIMES, Loss, Run, run_limited, step
from relocbench.methods import SUBPROCESS, MethodSpec, method_class


@dataclass(frozen=True)
class Offers:
    """What a tracker can be asked beside the pose of a query."""

    match: bool = False
    """where single pixels are"""
    prior: bool = False
    """to start from a given pose"""
    fault: str = ""
    """why nothing is known: constructing it passed a limit or ended its process"""


def offers_of(spec: MethodSpec, run: Run) -> Offers:
    """What a method offers. A class tells it as it stands; anything else that makes trackers has to make one.

    Raises:
        MethodError: no such method, or its constructor raised.
    """
    if spec.target.startswith(SUBPROCESS):
        return Offers()
    target = method_class(spec.target)
    return _told_by(target) if isinstance(target, type) else _made(spec, run)


def can_be_made(spec: MethodSpec, run: Run) -> str:
    """Why a method cannot be constructed within limits; empty if it can. Raises MethodError where it raises."""
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

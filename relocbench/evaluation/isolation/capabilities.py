"""The optional capabilities of a method, and whether it can be constructed, tested in a worker and within limits."""

from __future__ import annotations

from dataclasses import dataclass

from relocbench.evaluation.isolation.guard import capabilities
from relocbench.evaluation.isolation.tracker import IsolatedTracker
from relocbench.evaluation.isolation.worker import CONSTRUCTOR
from relocbench.execution import MANY_TIMES, Loss, Run, Sandbox, run_limited, step
from relocbench.methods import SUBPROCESS, MethodSpec, method_class
from relocbench.methods.discovery import is_ours


@dataclass(frozen=True)
class Capabilities:
    """The optional questions that a tracker can answer."""

    match: bool = False
    """where single pixels of the reference are in the query"""
    prior: bool = False
    """the pose of a query, started from a prior"""
    fault: str = ""
    """why nothing is known: constructing the tracker exceeded a limit or ended its process"""


def capabilities_of(spec: MethodSpec, run: Run) -> Capabilities:
    """The capabilities of a method. Those of a class are read from it; a factory has to be called for them.

    Raises:
        MethodError: no such method, or its constructor raised.
    """
    if spec.target.startswith(SUBPROCESS):
        return Capabilities()
    target = method_class(spec.target) if is_ours(spec.target) else None
    return Capabilities(*capabilities(target)) if isinstance(target, type) else _made(spec, run)


def construction_fault(spec: MethodSpec, run: Run) -> str:
    """Why a method cannot be constructed within limits; empty if it can. Raises MethodError where that raises."""
    return "" if spec.target.startswith(SUBPROCESS) else _made(spec, run).fault


def _made(spec: MethodSpec, run: Run) -> Capabilities:
    one = Run(min(run.workers, 1), limits=run.limits)
    found = run_limited(_make, [[(spec, run.in_subprocess, run.sandbox_of_methods())]], one, on_loss=_lost)
    return next(capabilities for _, capabilities in found)


def _make(made: tuple[MethodSpec, bool, Sandbox]) -> Capabilities:
    spec, isolated, sandbox = made
    with step(CONSTRUCTOR, times=MANY_TIMES):
        if not isolated:
            return Capabilities(*capabilities(spec.create()))
        tracker = IsolatedTracker(spec, sandbox)
    tracker.close()
    return Capabilities(tracker.declared.match, tracker.declared.prior)


def _lost(made: tuple[MethodSpec, bool, Sandbox], loss: Loss) -> Capabilities:
    return Capabilities(fault=f"{CONSTRUCTOR}: {loss.how}")

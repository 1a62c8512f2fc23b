"""Checking that a method keeps its contract: what was found, and calls that may raise anything."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from relocbench.evaluation.isolation.guard import guarded
from relocbench.execution import messages_to_stderr
from relocbench.methods import MethodSpec


@dataclass(frozen=True)
class Finding:
    """A requirement of the contract, and whether the method met it."""

    check: str
    passed: bool
    detail: str = ""
    doubtful: bool = False
    """whether the contract is kept, but the answer is hard to believe"""


def constructed(spec: MethodSpec) -> tuple[Any, Finding]:
    """The method, and whether it could be constructed."""
    method, problem = guarded(spec.create)
    parameters = ", ".join(f"{k}={v}" for k, v in spec.parameters.items())
    return method, Finding("is constructed", not problem, problem or parameters)


def constructed_again(spec: MethodSpec) -> tuple[Any, str | None]:
    """Another instance of a method that could be constructed before, or what went wrong."""
    method, problem = guarded(spec.create)
    return method, problem and f"constructed a second time, it raised {problem}"


def attempt(call: Callable[[], Any], advice: str) -> tuple[Any, str | None]:
    """What a call of a method returns, or what it raised.

    Args:
        advice: what the method should do instead of raising.
    """
    with messages_to_stderr():
        value, problem = guarded(call, placed=True)
    return value, problem and f"raised {problem} ({advice})"

"""What the process of a method reports of it is bounded, and a method that reports something else is named."""

from __future__ import annotations

import json
from typing import Any

import pytest
from refusals import refused

from relocbench.errors import MethodError
from relocbench.evaluation.common.foreign import _can_be_recorded
from relocbench.evaluation.isolation.tracker import IsolatedTracker
from relocbench.execution import Sandbox
from relocbench.methods import MethodSpec


def test_a_method_that_answers_infinitely_many_queries_at_once_is_refused_and_named() -> None:
    with refused(MethodError, "", None, "endless"):
        IsolatedTracker(MethodSpec("endless", "misbehaving:ManyQueriesAtOnce"), Sandbox("none"))


@pytest.mark.parametrize(
    "value", ["\ud800", 10**400, "x" * 2**18, json.loads("[" * 100 + "]" * 100)], ids=["half", "digits", "long", "deep"]
)
def test_parameters_that_no_record_can_hold_are_recognised(value: Any) -> None:
    assert _can_be_recorded({"parameters": {"a": 1.5, "b": [None, True]}})
    assert not _can_be_recorded({"parameters": {"a": value}})

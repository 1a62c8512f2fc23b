"""Methods that differ in defaults alone say so where parameters are read."""

from __future__ import annotations

import inspect
from typing import get_type_hints

import pytest

from baselines.defaults import with_defaults


class Plain:
    def __init__(self, first: int, second: int = 2, third: str = "c") -> None:
        self.given = first, second, third


@with_defaults(second=20)
class Changed(Plain):
    pass


@with_defaults(third="z")
class Twice(Changed):
    pass


def test_other_defaults_hold_unless_a_value_is_given() -> None:
    assert Plain(1).given == (1, 2, "c")
    assert Changed(1).given == (1, 20, "c")
    assert Changed(1, 3).given == Changed(first=1, second=3).given == (1, 3, "c")
    assert Twice(1).given == (1, 20, "z")
    assert Twice(1, third="y").given == (1, 20, "y")


def test_the_signature_tells_them_and_the_types() -> None:
    assert str(inspect.signature(Twice)) == "(first: 'int', second: 'int' = 20, third: 'str' = 'z') -> 'None'"
    assert get_type_hints(Twice.__init__)["second"] is int
    assert str(inspect.signature(Plain)) == "(first: 'int', second: 'int' = 2, third: 'str' = 'c') -> 'None'"


def test_a_parameter_that_does_not_exist_is_a_mistake() -> None:
    with pytest.raises(TypeError, match="fourth"):
        with_defaults(fourth=4)(type("Plain", (Plain,), {}))
    with pytest.raises(TypeError, match="fourth"):
        Changed(1, fourth=4)  # type: ignore[call-arg]

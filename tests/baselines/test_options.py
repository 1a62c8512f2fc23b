"""Options of trainings: a refused value is named as the user writes it."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field

import pytest

from baselines.options import OptionError, at_least, options_from_dict
from relocbench.errors import ConfigError


@dataclass(frozen=True)
class Loss:
    weight: float = 1.0
    form: str = "round"

    def __post_init__(self) -> None:
        at_least(self, 0, "weight")


@dataclass(frozen=True)
class Options:
    steps: int = 3
    loss: Loss = field(default_factory=Loss)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"loss": {"weight": -1}}, "loss.weight is -1.0, expected 0 or more"),
        ({"loss": {"form": None}}, "loss.form is null: Input should be a valid string"),
    ],
)
def test_a_nested_option_is_named_in_full(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError) as told:
        options_from_dict(Options, values)
    assert str(told.value) == message


def test_the_error_says_the_same_after_it_left_a_process() -> None:
    with pytest.raises(OptionError) as told:
        Loss(weight=float("nan"))
    assert str(pickle.loads(pickle.dumps(told.value))) == str(told.value) == "weight is nan, expected 0 or more"

"""Options as dataclasses, and as plain values in files and on command lines."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Annotated, Any, TypeVar

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from relocbench.errors import ConfigError, quoted

Kind = TypeVar("Kind")
Finite = Annotated[float, Field(allow_inf_nan=False)]
"""a parameter that is a number, not an infinite one"""


class Options:
    """A dataclass of options, of which unknown keys are refused by name.

    Where a value is out of range, or does not fit another one, constructing it raises :class:`OptionError`.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")


class OptionError(ConfigError, ValueError):
    """An option has a value that it cannot have; the message has the option's name, the value and what was expected.

    Raised while a dataclass of options is constructed. A dataclass that contains it puts its own name for it in front
    (``loss.weight``): see :func:`options_from_dict`.
    """

    def __init__(self, name: str, value: object, expected: str) -> None:
        self.option, self.value, self.rule = name, value, expected
        super().__init__(f"{name} is {_quoted_value(value)}, expected {expected}")

    def __reduce__(self) -> Any:
        return type(self), (self.option, self.value, self.rule)


def require(options: object, names: str, holds: Callable[[Any], bool], expected: str) -> None:
    """Raise OptionError for the first of the options, named with spaces between, for whose value a rule does not
    hold."""
    for name in names.split():
        value = getattr(options, name)
        if not holds(value):
            raise OptionError(name, value, expected)


def at_least(options: object, least: float, names: str) -> None:
    """Raise OptionError unless all of the options are ``least`` or more."""
    require(options, names, lambda value: value >= least, f"{least} or more")


def above_0(options: object, names: str) -> None:
    """Raise OptionError unless all of the options are positive."""
    require(options, names, lambda value: value > 0, "more than 0")


def share(options: object, names: str) -> None:
    """Raise OptionError unless all of the options are between 0 and 1, or one of these."""
    require(options, names, lambda value: 0 <= value <= 1, "0 to 1")


def share_below_1(options: object, names: str) -> None:
    """Raise OptionError unless all of the options are 0 or more and below 1."""
    require(options, names, lambda value: 0 <= value < 1, "0 or more and below 1")


def valid_shares(options: Any) -> None:
    """Raise OptionError unless each of the option ``shares`` is above 0, and all of them together are at most 1."""
    require(
        options,
        "shares",
        lambda shares: all(0 < each <= 1 for each in shares.values()) and sum(shares.values()) <= 1 + 1e-9,
        "shares above 0, at most 1 together",
    )


def options_from_dict(kind: type[Kind], values: Mapping[str, Any]) -> Kind:
    """An instance of the dataclass ``kind`` from plain values; absent ones have their defaults.

    Raises:
        ConfigError: a key is unknown, or a value has the wrong type or is out of range; it is named.
    """
    try:
        return TypeAdapter(kind).validate_python(dict(values))
    except ValidationError as bad:
        raise ConfigError("; ".join(_fault_text(fault) for fault in bad.errors())) from bad


def _fault_text(fault: Any) -> str:
    """One fault that pydantic found: the option by its full name, its value and what was expected."""
    name = ".".join(str(part) for part in fault["loc"])
    raised = fault.get("ctx", {}).get("error")
    if isinstance(raised, OptionError):
        return str(OptionError(f"{name}.{raised.option}" if name else raised.option, raised.value, raised.rule))
    if fault["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return f"unknown option {name}"
    if fault["type"] == "missing":
        return f"option {name} is missing"
    return f"{name} is {_quoted_value(fault['input'])}: {fault['msg']}"


def _quoted_value(value: object) -> str:
    """A value as it is written in YAML, in quotation marks if it is text."""
    if isinstance(value, str):
        return quoted(value)
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(list(value) if isinstance(value, tuple) else value)[:200]


def plain(options: Any) -> dict[str, Any]:
    """A dataclass of options as plain values, with lists instead of tuples, as YAML and JSON return them."""
    values: dict[str, Any] = json.loads(json.dumps(asdict(options)))
    return values


def filled(defaults: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """``given`` values over ``defaults``, nested; unknown keys are kept, to be refused by name later."""
    nested = {
        key for key, value in defaults.items() if isinstance(value, Mapping) and isinstance(given.get(key), Mapping)
    }
    return {**defaults, **given, **{key: filled(defaults[key], given[key]) for key in nested}}

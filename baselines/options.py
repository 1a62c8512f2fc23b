"""Options as dataclasses, and as plain values in files and on command lines."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from relocbench.errors import ConfigError

Kind = TypeVar("Kind")


class Options:
    """A dataclass of options, of which unknown keys are refused by name."""

    __pydantic_config__ = ConfigDict(extra="forbid")


def options_to_dict(options: Any) -> dict[str, Any]:
    """A dataclass of options as plain values, for JSON or YAML."""
    return asdict(options)


def options_from_dict(kind: type[Kind], values: Mapping[str, Any]) -> Kind:
    """An instance of the dataclass ``kind`` from plain values; absent ones have their defaults.

    Raises:
        ConfigError: a key is unknown, or a value has the wrong type or is out of range; it is named.
    """
    try:
        return TypeAdapter(kind).validate_python(dict(values))
    except ValidationError as bad:
        faults = "; ".join(f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in bad.errors())
        raise ConfigError(f"{kind.__name__}: {faults}") from bad


def plain(options: Any) -> dict[str, Any]:
    """As :func:`options_to_dict`, with lists instead of tuples, as YAML and JSON return them."""
    values: dict[str, Any] = json.loads(json.dumps(options_to_dict(options)))
    return values


def filled(defaults: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """``given`` values over ``defaults``, nested; unknown keys are kept, to be refused by name later."""
    nested = {
        key for key, value in defaults.items() if isinstance(value, Mapping) and isinstance(given.get(key), Mapping)
    }
    return {**defaults, **given, **{key: filled(defaults[key], given[key]) for key in nested}}

"""Options as dataclasses, and as the plain values that files and command lines hold."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from relocbench.errors import ConfigError

Options = TypeVar("Options")

NO_OTHER_KEYS = ConfigDict(extra="forbid")
"""for ``__pydantic_config__`` of a dataclass of options: a key that does not exist is refused by name"""


def options_to_dict(options: Any) -> dict[str, Any]:
    """A dataclass of options as plain values, for JSON or YAML."""
    return asdict(options)


def options_from_dict(kind: type[Options], values: Mapping[str, Any]) -> Options:
    """The dataclass of options ``kind`` from plain values; what is absent keeps its default.

    Raises:
        ConfigError: an unknown key, a wrong type or an impossible value, each named.
    """
    try:
        return TypeAdapter(kind).validate_python(dict(values))
    except ValidationError as bad:
        faults = "; ".join(f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in bad.errors())
        raise ConfigError(f"{kind.__name__}: {faults}") from bad


def plain(options: Any) -> dict[str, Any]:
    """As :func:`options_to_dict`, with lists in place of tuples: as YAML and JSON give them back."""
    values: dict[str, Any] = json.loads(json.dumps(options_to_dict(options)))
    return values


def filled(usual: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """``usual`` where ``given`` says nothing; keys that do not exist stay, to be refused by name."""
    nested = {key for key, value in usual.items() if isinstance(value, Mapping) and isinstance(given.get(key), Mapping)}
    return {**usual, **given, **{key: filled(usual[key], given[key]) for key in nested}}

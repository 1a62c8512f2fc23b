"""Finding trainers, and reading what they are told: installed ones by entry point, anybody's by dotted path."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import yaml

from relocbench.errors import ConfigError, MethodError
from relocbench.files import load_yaml_values
from relocbench.training import Trainer

TRAINER_GROUP = "relocbench.trainers"


def installed_trainers() -> dict[str, metadata.EntryPoint]:
    """Name -> entry point of every installed trainer, sorted by name; nothing is imported."""
    return {point.name: point for point in sorted(metadata.entry_points(group=TRAINER_GROUP), key=lambda p: p.name)}


def trainer_named(name: str) -> Trainer:
    """The trainer of an installed name, or of a ``package.module:Class`` whose constructor needs no arguments.

    Raises:
        MethodError: there is none, it cannot be imported, or it does not keep the contract.
    """
    installed = installed_trainers()
    target = name if ":" in name else installed[name].value if name in installed else ""
    if not target:
        close = difflib.get_close_matches(name, installed, n=1)
        hint = f" (did you mean '{close[0]}'?)" if close else ""
        raise MethodError(
            f"no trainer '{name}'{hint}; installed: {', '.join(installed) or 'none'} (or package.module:Class)"
        )
    module_name, _, attribute = target.partition(":")
    try:
        made = getattr(import_module(module_name), attribute)()
    except (ImportError, AttributeError, TypeError) as bad:
        raise MethodError(f"trainer '{name}' cannot be made from {target}: {bad}") from bad
    if not isinstance(made, Trainer):
        raise MethodError(f"trainer '{name}': {target} has no train() or no default_options()")
    return made


def trainer_options(defaults: Mapping[str, Any], config: Path | None, settings: Sequence[str]) -> dict[str, Any]:
    """A trainer's options, nested: its defaults, then those of a YAML file, then ``some.key=value`` settings.

    Raises:
        ConfigError: an unknown key, named with its file, or a setting without a value.
    """
    chosen = _copy(defaults)
    if config is not None:
        values, _ = load_yaml_values(config, "a trainer's options with their values", ConfigError)
        _merge(chosen, values, config, "")
    for setting in settings:
        key, separator, text = setting.partition("=")
        if not separator:
            raise ConfigError(f"--set {setting}: expected key=value, as in learning_rate=0.001 or network.dim=8")
        nested: Any = _value(text)
        for part in reversed(key.split(".")):
            nested = {part: nested}
        _merge(chosen, nested, None, "")
    return chosen


def _merge(into: dict[str, Any], values: Mapping[str, Any], path: Path | None, prefix: str) -> None:
    for key, value in values.items():
        name = f"{prefix}{key}"
        if key not in into:
            close = difflib.get_close_matches(str(key), into, n=1)
            hint = f" (did you mean '{prefix}{close[0]}'?)" if close else ""
            raise ConfigError(f"unknown option '{name}'{hint}; there is {', '.join(into)}", path)
        if isinstance(into[key], dict):
            if not isinstance(value, Mapping):
                raise ConfigError(f"option '{name}' is a group of options: {', '.join(into[key])}", path)
            _merge(into[key], value, path, f"{name}.")
        else:
            into[key] = value


def _value(text: str) -> Any:
    """As YAML; it reads 1e-3 as a word, a number is meant."""
    try:
        value = yaml.safe_load(text) if text else ""
        return float(value) if isinstance(value, str) and value[:1] in "+-.0123456789" else value
    except (yaml.YAMLError, ValueError):
        return text


def _copy(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _copy(value) if isinstance(value, Mapping) else value for key, value in values.items()}

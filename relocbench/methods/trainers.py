"""Finding trainers, by entry point or dotted path, and reading their options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from importlib import metadata
from pathlib import Path
from typing import Any

from relocbench.errors import ConfigError, MethodError, available, cut, hint, quoted
from relocbench.files import YamlFault, load_yaml_values, parse_yaml_setting
from relocbench.methods.lookup import call_third_party, entry_points_of, load_dotted
from relocbench.training import ConfiguredTrainer, PlaceTrainer, Trainer

TRAINER_GROUP = "relocbench.trainers"
_CONFIGURATION = "configuration"
_OPTIONS = "a file of a trainer's options"


def installed_trainers() -> dict[str, metadata.EntryPoint]:
    """The entry points of all installed trainers, sorted by name; nothing is imported."""
    return entry_points_of(TRAINER_GROUP, "trainer")


def trainer_named(name: str) -> Trainer | PlaceTrainer:
    """The trainer of an installed name, or of a ``package.module:Class`` whose constructor needs no arguments.

    Raises:
        MethodError: there is none, it cannot be imported, or it does not keep the contract.
    """
    installed = installed_trainers()
    target = name if ":" in name else installed[name].value if name in installed else ""
    if not target:
        raise MethodError(
            f"no trainer '{name}'{hint(name, installed)}; installed: {', '.join(installed) or 'none'} "
            "(or package.module:Class)"
        )
    made = call_third_party(f"trainer '{name}' cannot be made from {target}", load_dotted(target, "trainer"))
    if not isinstance(made, Trainer | PlaceTrainer):
        raise MethodError(f"trainer '{name}': {target} has no train() or train_places(), or no default_options()")
    return made


def chosen_options(trainer: Trainer | PlaceTrainer, config: str | None, settings: Sequence[str]) -> dict[str, Any]:
    """A trainer's options, nested: its defaults, overridden by a file or configuration, then by ``key=value`` settings.

    Args:
        config: a YAML file, or the name of one of the trainer's configurations. The key ``configuration`` of a file
            names the configuration whose defaults it overrides.

    Raises:
        ConfigError: ``config`` is neither, a key is unknown, or a setting has no value.
    """
    if not isinstance(trainer, ConfiguredTrainer):
        return trainer_options(trainer.default_options(), Path(config) if config else None, settings)
    path = None
    named = [text.partition("=")[2] for text in settings if text.startswith(f"{_CONFIGURATION}=")]
    if config is not None and config not in trainer.configurations:
        path = Path(config)
        if not path.exists():
            others = available(config, trainer.configurations)
            raise ConfigError(f"no configuration and no file '{config}'{others}")
        named = named or [str(load_yaml_values(path, _OPTIONS, ConfigError)[0].get(_CONFIGURATION, ""))]
    elif config is not None:
        named = named or [config]
    for name in named:
        if name and name not in trainer.configurations:
            raise ConfigError(f"no configuration '{name}'{available(name, trainer.configurations)}")
    usual = trainer.options_of(named[-1]) if named and named[-1] else trainer.default_options()
    return trainer_options(usual, path, settings)


def trainer_options(defaults: Mapping[str, Any], config: Path | None, settings: Sequence[str]) -> dict[str, Any]:
    """A trainer's options, nested: its defaults, overridden by a YAML file, then by ``some.key=value`` settings.

    Raises:
        ConfigError: an unknown key, with the file, or a setting without a value.
    """
    chosen = deepcopy(dict(defaults))
    if config is not None:
        values, _ = load_yaml_values(config, _OPTIONS, ConfigError)
        _merge(chosen, defaults, values, config, "")
    for setting in settings:
        key, separator, text = setting.partition("=")
        if not separator:
            raise ConfigError(f"--set {cut(setting)}: expected key=value, as in learning_rate=0.001 or network.dim=8")
        nested: Any = _value(setting, text)
        for part in reversed(key.split(".")):
            nested = {part: nested}
        _merge(chosen, defaults, nested, None, "")
    return chosen


def _merge(
    into: dict[str, Any], usual: Mapping[str, Any], values: Mapping[str, Any], path: Path | None, prefix: str
) -> None:
    """Override options in place. A group that is empty by default takes any names."""
    for key, value in values.items():
        name = f"{prefix}{key}"
        if key not in into and usual:
            raise ConfigError(f"unknown option '{name}'{available(str(key), into, prefix)}", path)
        if isinstance(into.get(key), dict):
            if not isinstance(value, Mapping):
                names = ", ".join(into[key]) or "NAME=VALUE"
                raise ConfigError(f"option '{name}' is a group of options: {names}", path)
            _merge(into[key], usual.get(key, {}), value, path, f"{name}.")
        else:
            into[key] = value


def _value(setting: str, text: str) -> Any:
    """The value of a setting: YAML, except that a string such as 1e-3 becomes a number."""
    try:
        value = parse_yaml_setting(text)
    except YamlFault as bad:
        raise ConfigError(f"--set {quoted(setting)}: {bad}") from None
    try:
        return float(value) if isinstance(value, str) and value[:1] in "+-.0123456789" else value
    except ValueError:
        return value

"""Options from a YAML file and from the command line, checked together by one pydantic model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from relocbench.cli.options import split_commas, takes_several
from relocbench.cli.spellings import other_number
from relocbench.errors import ConfigError, hint, quoted
from relocbench.execution.scheduler_setting import SchedulerSetting
from relocbench.files import first_fault, load_yaml_values, yaml_line

Model = TypeVar("Model", bound=BaseModel)


class Where(BaseModel):
    """Where a command's work runs, for commands whose own options decide what is made and nothing else."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    workers: int | None = Field(None, ge=1)
    scheduler: SchedulerSetting | None = None


def merged(
    model: type[Model],
    config: Path | None,
    given: dict[str, Any],
    beside: type[BaseModel] | None = None,
    *,
    elsewhere: Callable[[str], str] = lambda key: "",
) -> Model:
    """The model filled from ``config`` and then from ``given``, which wins.

    Args:
        beside: another model, whose keys stand in the same file and are passed over.
        elsewhere: returns the other commands that have an unknown key as their option, or nothing.

    Raises:
        ConfigError: naming the option, or the file, line and key.
    """
    values: dict[str, Any] = {}
    written: dict[str, str] = {}
    node = None
    if config is not None:
        values, node = load_yaml_values(config, "a file of options", ConfigError)
        passed_over = set() if beside is None else beside.model_fields.keys() - model.model_fields.keys()
        written = {other_number(name, model.model_fields): name for name in values if name not in passed_over}
        values = {name: values[key] for name, key in written.items()}
    chosen = {**values, **{name: _parts(model, name, value) for name, value in given.items()}}
    try:
        return model.model_validate(chosen)
    except ValidationError as bad:
        message, location = first_fault(bad)
        key = str(location[0]) if location else ""
        if config is not None and key in values and key not in given:
            if bad.errors()[0]["type"] == "extra_forbidden" and len(location) == 1:
                message = f"unknown key {quoted(key)}{_where_else(key, model, elsewhere)}"
            raise ConfigError(message, config, yaml_line(node, (written[key], *location[1:]))) from None
        if not key:
            raise ConfigError(message) from None
        option = f"--{key.replace('_', '-')}"
        detail = message.removeprefix(f"key '{key}': ")
        if bad.errors()[0]["type"] == "missing":
            detail = "must be given"
        raise ConfigError(f"{option}: {detail}") from None


def _where_else(key: str, model: type[BaseModel], elsewhere: Callable[[str], str]) -> str:
    """The commands that have an unknown key, or else a key of this one that is spelled alike."""
    if others := elsewhere(key):
        return f"; it is an option of {others}"
    return hint(key, model.model_fields)


def _parts(model: type[BaseModel], name: str, value: Any) -> Any:
    """Words of an option that takes several: parted by commas."""
    field = model.model_fields.get(name)
    if field is None or not isinstance(value, str) or not takes_several(field.annotation):
        return value
    return split_commas([value])

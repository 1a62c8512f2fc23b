"""YAML files checked against pydantic models; a fault names file, line and key."""

from __future__ import annotations

import re
import reprlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

from relocbench.errors import MOST_QUOTED, RelocbenchError, cut, hint, printable
from relocbench.files.text import read_text
from relocbench.files.yaml_text import YamlFault, YamlPlaces, parse_yaml

if TYPE_CHECKING:  # every process imports this module, and few of them read a file by a model
    from pydantic import BaseModel, ValidationError
    from pydantic_core import ErrorDetails

Model = TypeVar("Model", bound="BaseModel")
MAX_YAML_BYTES = 16 * 2**20
"""the scores of a method on some ten thousand pair sets"""


def dump_yaml(values: Any) -> str:
    """YAML in the order given, short lists on one line."""
    return str(yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110))


def load_yaml(path: Path, model: type[Model], what: str, error: type[RelocbenchError] = RelocbenchError) -> Model:
    """A YAML file checked against a pydantic model.

    Raises:
        RelocbenchError: (as ``error``) with file, line and key: no YAML, an unknown key, a wrong type.
    """
    from pydantic import ValidationError

    values, places = load_yaml_values(path, what, error)
    try:
        return model.model_validate(values)
    except ValidationError as bad:
        message, location = first_fault(bad)
        raise error(message, path, yaml_line(places, location)) from None


def load_yaml_values(
    path: Path, what: str, error: type[RelocbenchError] = RelocbenchError
) -> tuple[dict[str, Any], YamlPlaces]:
    """The mapping that a YAML file holds, and where its parts stand. Raises ``error`` with file and line."""
    value, places = _load(path, what, error)
    if not isinstance(value, dict):
        raise error(f"expected {what} with keys and values", path)
    for key in value:
        if not isinstance(key, str):
            written = yaml.safe_dump(key).splitlines()[0]
            raise error(f"a key is {written}, expected a name", path, yaml_line(places, (written,)))
    return value, places


def load_yaml_value(path: Path, what: str, error: type[RelocbenchError] = RelocbenchError) -> Any:
    """Whatever a YAML file holds; None where that is nothing. Raises ``error`` with file and line."""
    return _load(path, what, error)[0]


def _load(path: Path, what: str, error: type[RelocbenchError]) -> tuple[Any, YamlPlaces]:
    text = read_text(path, what, error, MAX_YAML_BYTES)
    try:
        return parse_yaml(text), YamlPlaces(text)
    except YamlFault as bad:
        raise error(f"not valid YAML ({bad.problem}); expected {what}", path, bad.line) from None


_PLAIN = {
    "tuple_type": "expected a list",
    "list_type": "expected a list",
    "dict_type": "expected keys and values",
    "model_type": "expected keys and values",
    "dataclass_type": "expected keys and values",
}
"""what pydantic says in words of Python, in words of YAML, by the type of its error"""


def first_fault(bad: ValidationError) -> tuple[str, tuple[str | int, ...]]:
    """One line about a pydantic error (the first, and how many more), and where it is."""
    faults = bad.errors(include_url=False)
    first = faults[0]
    location = tuple(first["loc"])
    key = cut(printable(".".join(str(part) for part in location)), MOST_QUOTED)
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        message = f"unknown key '{key}'"
    elif first["type"] == "missing":
        message = f"key '{key}' is missing"
    else:
        plain = _PLAIN.get(first["type"], str(first["msg"]).removeprefix("Value error, "))
        shown = cut(printable(_INPUT.sub(_expected, plain)), 2 * MOST_QUOTED)
        alike = _alike(first) if first["type"] == "literal_error" else ""
        message = f"key '{key}': {shown}, got {_shown(first.get('input'))}{alike}" if key else shown
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return message + more, location


_INPUT = re.compile("^Input should be (?=(greater|less)?)")
"""how pydantic begins to say what it expected"""


def _expected(found: re.Match[str]) -> str:
    return "expected a number " if found[1] else "expected "


def _alike(fault: ErrorDetails) -> str:
    """The one of the expected words that is like what is there, if any."""
    return hint(str(fault["input"])[:MOST_QUOTED], re.findall("'([^']*)'", fault["ctx"]["expected"]))


def _shown(value: Any) -> str:
    """A value as Python writes it, of at most :data:`MOST_QUOTED` characters; more than that is not looked at."""
    shortened = reprlib.Repr()
    shortened.maxlevel = 4
    shortened.maxlist = shortened.maxtuple = shortened.maxset = shortened.maxdict = 50
    shortened.maxstring = shortened.maxlong = shortened.maxother = MOST_QUOTED
    return cut(printable(shortened.repr(value)), MOST_QUOTED)


def yaml_line(places: YamlPlaces | None, location: tuple[str | int, ...]) -> int | None:
    """1-based line of the innermost part of ``location`` that exists in the text."""
    return None if places is None else places.line(location)

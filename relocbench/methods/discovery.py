"""Finding and configuring methods: installed ones, anybody's class, anybody's program.

A method is named by

- an entry point of the group ``relocbench.methods`` (``orb-pnp``),
- a dotted path to a class (``mypackage.trackers:MyTracker``),
- a command line that speaks the line protocol (``subprocess:./my_tracker --fast``),

each with an optional label in front that results are kept under (``dso-fast=dso``).
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, get_type_hints

import yaml
from pydantic import TypeAdapter, ValidationError

from relocbench.datasets.schema import check_name
from relocbench.errors import MethodError
from relocbench.files import first_fault
from relocbench.methods.lookup import hint, load_dotted, of_theirs, offered

ENTRY_POINT_GROUP = "relocbench.methods"
SUBPROCESS = "subprocess:"


@dataclass(frozen=True)
class MethodSpec:
    """A method with its label and parameters: picklable, so that a worker can build the tracker itself."""

    label: str
    target: str
    """entry point, dotted path or ``subprocess:COMMAND``"""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """all of them, defaults included, as plain values"""

    def create(self) -> Any:
        """The tracker, constructed. Raises MethodError."""
        factory = method_class(self.target)
        return of_theirs(f"method '{self.label}' cannot be made", lambda: factory(**self.parameters))


@dataclass(frozen=True)
class Parameter:
    """One keyword argument of a method's constructor."""

    name: str
    annotation: Any
    default: Any
    """``inspect.Parameter.empty`` where it must be given"""

    @property
    def required(self) -> bool:
        return self.default is inspect.Parameter.empty

    @property
    def type_name(self) -> str:
        return inspect.formatannotation(getattr(self.annotation, "__origin__", self.annotation)).replace("typing.", "")


def installed_methods() -> dict[str, metadata.EntryPoint]:
    """Name -> entry point of every installed method, sorted by name; nothing is imported."""
    return offered(ENTRY_POINT_GROUP, "method")


def parse_method(text: str, settings: Sequence[str] = (), seed: int = 0) -> MethodSpec:
    """A method from ``[LABEL=]TARGET`` and ``key=value`` or ``LABEL.key=value`` settings.

    Settings meant for another label are passed over. A parameter called ``seed`` gets ``seed`` unless it is set.

    Raises:
        MethodError: unknown method, unknown parameter, a value of the wrong type, a parameter that must be given.
    """
    label, target = _split_label(text)
    known = {p.name: p for p in parameters_of(target)}
    chosen: dict[str, Any] = {}
    for setting in settings:
        key, separator, value = setting.partition("=")
        if not separator:
            raise MethodError(f"--set {setting}: expected key=value or LABEL.key=value")
        prefix, dot, rest = key.rpartition(".")
        if dot and prefix != label:
            continue
        name = rest if dot else key
        if name not in known:
            have = ", ".join(known) or "none"
            raise MethodError(f"method '{label}' has no parameter '{name}'{hint(name, known)}; it has: {have}")
        chosen[name] = _validated(label, known[name], yaml.safe_load(value) if value else "", value)
    if "seed" in known:
        chosen.setdefault("seed", seed)
    for name, parameter in known.items():
        if name not in chosen and parameter.required:
            raise MethodError(f"method '{label}' needs its parameter '{name}': --set {label}.{name}=VALUE")
        chosen.setdefault(name, parameter.default)
    return MethodSpec(label, target, {name: chosen[name] for name in known})


def parse_methods(texts: Sequence[str], settings: Sequence[str] = (), seed: int = 0) -> list[MethodSpec]:
    """Several methods with one list of settings.

    Raises:
        MethodError: as :func:`parse_method`; also two methods of one label, or a setting for a label that is not
            among them.
    """
    specs = [parse_method(text, settings, seed) for text in texts]
    labels = [spec.label for spec in specs]
    for label in labels:
        if labels.count(label) > 1:
            raise MethodError(f"two methods are called '{label}'; give one a label of its own: LABEL={label}")
    for setting in settings:
        prefix, dot, _ = setting.partition("=")[0].rpartition(".")
        if dot and prefix not in labels:
            raise MethodError(f"--set {setting}: no method '{prefix}' in this run; there is {', '.join(labels)}")
    return specs


def method_class(target: str) -> Any:
    """What is called with the parameters to get a tracker. Raises MethodError."""
    if target.startswith(SUBPROCESS):
        from relocbench.methods.subprocess_tracker import subprocess_tracker

        return subprocess_tracker(target.removeprefix(SUBPROCESS))
    if ":" in target:
        return _load_class(target)
    points = installed_methods()
    if target not in points:
        raise MethodError(
            f"no method '{target}'{hint(target, points)}; installed: {', '.join(points) or 'none'} "
            "(or name a class as package.module:Class, or a program as subprocess:COMMAND)"
        )
    return _load_class(points[target].value)


def parameters_of(target: str) -> list[Parameter]:
    """The parameters of a method, in the order of its constructor. Raises MethodError."""
    factory = method_class(target)
    signature = inspect.signature(factory)
    function = factory.__init__ if inspect.isclass(factory) else factory
    try:
        hints = get_type_hints(function, include_extras=True)
    except (NameError, TypeError):
        hints = {}
    out = []
    for p in signature.parameters.values():
        if p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD):
            continue
        out.append(Parameter(p.name, hints.get(p.name, Any), p.default))
    return out


def distribution_version(target: str) -> str:
    """``name version`` of the package that offers the method, as far as it can be known."""
    point = installed_methods().get(target)
    if point is not None and point.dist is not None:
        return f"{point.dist.name} {point.dist.version}"
    top = target.removeprefix(SUBPROCESS).split(":")[0].split(".")[0]
    owners = [] if target.startswith(SUBPROCESS) else metadata.packages_distributions().get(top, [])
    return f"{owners[0]} {metadata.version(owners[0])}" if owners else "unknown"


def _split_label(text: str) -> tuple[str, str]:
    label, separator, target = text.partition("=")
    if separator and ":" not in label and " " not in label and "/" not in label:
        if not target:
            raise MethodError(f"'{text}' names no method; expected LABEL=METHOD")
    else:
        target = text
        command = text.removeprefix(SUBPROCESS)
        if text.startswith(SUBPROCESS):
            words = command.split()
            label = Path(words[0]).stem if words else ""
        else:
            label = text.rpartition(":")[2] if ":" in text else text
    try:
        check_name(label, "method label")
    except ValueError as bad:
        raise MethodError(f"{bad}; give one: LABEL={target}") from None
    return label, target


def _load_class(target: str) -> Any:
    found = load_dotted(target, "method")
    attribute = target.partition(":")[2]
    if not callable(getattr(found, "track", None)) and inspect.isclass(found):
        raise MethodError(f"method '{target}': class '{attribute}' has no track() method")
    if not callable(found):
        raise MethodError(f"method '{target}': '{attribute}' is not a class or function that makes a tracker")
    return found


def _validated(label: str, parameter: Parameter, value: Any, text: str) -> Any:
    adapter: TypeAdapter[Any] = TypeAdapter(parameter.annotation)
    try:
        return adapter.validate_python(value)
    except ValidationError as bad:
        try:
            return adapter.validate_python(text)  # YAML reads 1e-3 and 007 as words, the type may know better
        except ValidationError:
            message, _ = first_fault(bad)
            raise MethodError(f"method '{label}': parameter '{parameter.name}={text}': {message}") from None

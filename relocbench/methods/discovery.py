"""Finding and configuring methods: installed ones, anybody's class, anybody's program.

A method is named by

- an entry point of the group ``relocbench.methods`` (``orb-pnp``),
- a dotted path to a class (``mypackage.trackers:MyTracker``),
- a command line that speaks the line protocol (``subprocess:./my_tracker --fast``),

each with an optional label in front that results are kept under (``dso-fast=dso``).
"""

from __future__ import annotations

import difflib
import inspect
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, get_type_hints

import yaml
from pydantic import TypeAdapter, ValidationError

from relocbench.datasets.schema import check_name
from relocbench.errors import MethodError, RelocbenchError
from relocbench.execution import messages_to_stderr
from relocbench.files import first_fault

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
        return _of_theirs(f"method '{self.label}' cannot be made", lambda: factory(**self.parameters))


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
    found: dict[str, metadata.EntryPoint] = {}
    for point in metadata.entry_points(group=ENTRY_POINT_GROUP):
        if point.name in found and found[point.name].value != point.value:
            raise MethodError(
                f"method '{point.name}' is offered twice ({found[point.name].value} and {point.value}); "
                "uninstall one, or name the class by its dotted path"
            )
        found[point.name] = point
    return dict(sorted(found.items()))


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
            raise MethodError(f"method '{label}' has no parameter '{name}'{_hint(name, known)}; it has: {have}")
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
        return _load_dotted(target)
    points = installed_methods()
    if target not in points:
        raise MethodError(
            f"no method '{target}'{_hint(target, points)}; installed: {', '.join(points) or 'none'} "
            "(or name a class as package.module:Class, or a program as subprocess:COMMAND)"
        )
    return _load_dotted(points[target].value)


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


def _load_dotted(target: str) -> Any:
    module_name, _, attribute = target.partition(":")
    # A class beside the user's data, without installing anything, as `python -m` would find it.
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    found = _of_theirs(f"method '{target}' cannot be imported", lambda: _import(module_name, target))
    for part in attribute.split("."):
        found = getattr(found, part, None)
    if found is None:
        raise MethodError(f"method '{target}': module '{module_name}' has no '{attribute}'")
    if not callable(getattr(found, "track", None)) and inspect.isclass(found):
        raise MethodError(f"method '{target}': class '{attribute}' has no track() method")
    if not callable(found):
        raise MethodError(f"method '{target}': '{attribute}' is not a class or function that makes a tracker")
    return found


def _import(module_name: str, target: str) -> Any:
    try:
        return import_module(module_name)
    except ModuleNotFoundError as bad:
        raise MethodError(f"method '{target}': no module '{bad.name}' (looked on the Python path and here)") from bad


def _of_theirs(failed: str, call: Callable[[], Any]) -> Any:
    """What code that is not ours returns. Raises MethodError with what it raised, and where."""
    try:
        with messages_to_stderr():
            return call()
    except RelocbenchError:
        raise
    except (Exception, SystemExit) as bad:
        last = traceback.extract_tb(bad.__traceback__)[-1]
        told = " ".join(str(bad).split())
        place = "" if isinstance(bad, SyntaxError) else f" ({last.filename}, line {last.lineno})"
        raise MethodError(f"{failed}: {type(bad).__name__}: {told}{place}") from bad


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


def _hint(name: str, known: Mapping[str, Any]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""

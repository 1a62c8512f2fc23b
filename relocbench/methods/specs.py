"""Configuring methods: their labels and parameters, as a user names them, until they are made.

A method is named by its target, as :mod:`relocbench.methods.discovery` finds it, optionally preceded by the label that
its results are kept under (``dso-fast=dso``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from relocbench.errors import MethodError, available, cut, hint, one_line, quoted
from relocbench.files import YamlFault, check_distinct, check_label, first_fault, parse_yaml_setting, sha256_file
from relocbench.methods.discovery import SUBPROCESS, TRACKERS, MethodKind, is_ours, method_class, parameters_of
from relocbench.methods.lookup import call_third_party
from relocbench.methods.parameters import Parameter

START = "start"
"""the setting that names the tracker whose pose another one starts from"""
MOST_ASSUMED = 60
"""characters of what a method says that it assumes"""


@dataclass(frozen=True)
class MethodSpec:
    """A method with its label and parameters. It can be pickled, so that a worker can construct the method itself."""

    label: str
    target: str
    """entry point, dotted path or ``subprocess:COMMAND``"""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """all parameters, with defaults filled in, as plain values; ``start`` and ``start.KEY`` are of :attr:`start`"""
    kind: MethodKind = TRACKERS

    @property
    def start(self) -> MethodSpec | None:
        """The tracker whose pose this one starts from, if the user named one."""
        target = self.parameters.get(START)
        if target is None or START in _names(self.target, self.kind):
            return None
        prefix = f"{START}."
        own = {name.removeprefix(prefix): value for name, value in self.parameters.items() if name.startswith(prefix)}
        return MethodSpec(f"{self.label}.{START}", target, own, self.kind)

    @property
    def runs_only_our_code(self) -> bool:
        """Whether it is relocbench's own, and no program."""
        targets = self.target, str(self.parameters.get(START, self.target))
        return all(is_ours(each, self.kind) and not each.startswith(SUBPROCESS) for each in targets)

    def create(self) -> Any:
        """Construct the tracker or retriever. Raises MethodError."""
        factory = method_class(self.target, self.kind)
        start = self.start
        own = self.parameters
        if start is not None:
            own = {name: value for name, value in own.items() if name.partition(".")[0] != START}
        made = call_third_party(f"{self.kind.noun} '{self.label}' cannot be made", lambda: factory(**own))
        if start is None:
            return made
        from relocbench.methods.started import StartedTracker

        return StartedTracker(made, start.create())

    def uses_times(self) -> bool:
        """Whether the method asks for the times of images: by the attribute ``uses_times`` of its class or factory.

        A program asks by the parameter of that name. Raises MethodError.
        """
        if self.start is not None and self.start.uses_times():
            return True
        if self.target.startswith(SUBPROCESS):
            return bool(self.parameters.get("uses_times", False))
        return _declares(self.target, self.kind, "uses_times")

    def assumes(self) -> str:
        """What the method says that it assumes of how cameras move: a few words, or nothing. Raises MethodError.

        Its class says so by a class method ``assumes`` that gets all parameters, if it has one; what a tracker assumes
        from whose pose it starts is assumed, too.
        """
        tell = getattr(method_class(self.target, self.kind), "assumes", None)
        own = ""
        if callable(tell):
            own = call_third_party(f"what '{self.label}' assumes cannot be read", lambda: tell(**self.parameters))
        before = self.start.assumes() if self.start else ""
        return one_line(", ".join(dict.fromkeys(filter(None, (own, before)))), MOST_ASSUMED)

    def files(self) -> dict[str, str]:
        """The SHA-256 of each file that affects the answers, by name: a file may change while its path does not.

        These are the files that parameters name as a ``Path``, and those that the class reports by its ``files``, if it
        has one (such as weights that come with the package). Missing files are left out. Raises MethodError.
        """
        named = {name: value for name, value in self.parameters.items() if isinstance(value, Path)}
        tell = getattr(method_class(self.target, self.kind), "files", None)
        if callable(tell):
            known = _names(self.target, self.kind)
            own = {name: value for name, value in self.parameters.items() if name in known}
            named |= call_third_party(f"the files of '{self.label}' cannot be listed", lambda: tell(**own))
        own = {name: sha256_file(path) for name, path in sorted(named.items()) if path.is_file()}
        return own | ({f"{START}.{name}": digest for name, digest in self.start.files().items()} if self.start else {})


def parse_method(text: str, settings: Sequence[str] = (), seed: int = 0, kind: MethodKind = TRACKERS) -> MethodSpec:
    """Parse a method from ``[LABEL=]TARGET`` and settings ``key=value`` or ``LABEL.key=value``.

    Settings for other labels are ignored. A parameter called ``seed`` gets ``seed`` unless it is set. The setting
    ``start=METHOD`` of a tracker that uses a prior, and has no parameter of that name, names the tracker whose pose it
    starts from, and ``LABEL.start.key=value`` sets the parameters of that one.

    Raises:
        MethodError: an unknown method, one of another kind, an unknown parameter, a value of the wrong type, or a
            required parameter that is missing.
    """
    label, target = split_label(text, kind)
    known = {p.name: p for p in parameters_of(target, kind)}
    noun = kind.noun
    chosen: dict[str, Any] = {}
    of_start: list[str] = []
    for setting in settings:
        key, separator, value = setting.partition("=")
        if not separator:
            raise MethodError(f"--set {cut(setting)}: expected key=value or LABEL.key=value")
        prefix, dot, rest = key.rpartition(".")
        if prefix == f"{label}.{START}":
            of_start.append(f"{rest}={value}")
            continue
        if dot and prefix != label:
            continue
        name = rest if dot else key
        if (
            name == START
            and START not in known
            and (_declares(target, kind, "uses_prior") or target.startswith(SUBPROCESS))
        ):
            chosen[START] = value
            continue
        if name not in known:
            have = ", ".join(known) or "none"
            raise MethodError(f"{noun} '{label}' has no parameter '{name}'{hint(name, known)}; it has: {have}")
        try:
            plain = parse_yaml_setting(value)
        except YamlFault as bad:
            raise MethodError(f"--set {quoted(setting)}: {bad}") from None
        chosen[name] = _validated(f"{noun} '{label}'", known[name], plain, value)
    if "seed" in known:
        chosen.setdefault("seed", seed)
    for name, parameter in known.items():
        if name not in chosen and parameter.required:
            raise MethodError(f"{noun} '{label}' needs its parameter '{name}': --set {label}.{name}=VALUE")
        chosen.setdefault(name, parameter.default)
    own = {name: chosen[name] for name in known}
    if START not in known:
        own |= _start_parameters(label, chosen.get(START), of_start, seed)
    return MethodSpec(label, target, own, kind)


def _start_parameters(label: str, target: str | None, settings: Sequence[str], seed: int) -> dict[str, Any]:
    """``start`` and ``start.KEY`` of a method that starts from another one; nothing where it does not."""
    if target is None:
        if settings:
            given = f"{label}.{START}.{cut(settings[0])}"
            raise MethodError(f"--set {given}: no --set {label}.{START}=METHOD names a start")
        return {}
    start = parse_method(f"{START}={target}", settings, seed)
    return {START: target, **{f"{START}.{name}": value for name, value in start.parameters.items()}}


def parse_methods(
    texts: Sequence[str],
    settings: Sequence[str] = (),
    seed: int = 0,
    kind: MethodKind = TRACKERS,
    parse: Callable[[str, Sequence[str], int, MethodKind], MethodSpec] = parse_method,
) -> list[MethodSpec]:
    """Parse several methods with one list of settings.

    Args:
        parse: parses one of them.

    Raises:
        MethodError: as :func:`parse_method`; also a label that two methods share, or a setting for a label that no
            method has.
    """
    specs = [parse(text, settings, seed, kind) for text in texts]
    labels = [spec.label for spec in specs]
    for label in labels:
        if labels.count(label) > 1:
            raise MethodError(f"two {kind.noun}s are called '{label}'; give one a label of its own: LABEL={label}")
    try:
        check_distinct(labels, f"{kind.noun} labels")
    except ValueError as bad:
        raise MethodError(str(bad)) from None
    for setting in settings:
        wanted = setting_label(setting)
        if wanted is not None and wanted.removesuffix(f".{START}") not in labels:
            raise MethodError(f"--set {cut(setting)}: no {kind.noun} '{wanted}' in this run{available(wanted, labels)}")
    return specs


def setting_label(setting: str) -> str | None:
    """The ``LABEL`` of ``LABEL.key=value``; None if the setting has none."""
    label, dot, _ = setting.partition("=")[0].rpartition(".")
    return label if dot else None


def split_label(text: str, kind: MethodKind = TRACKERS) -> tuple[str, str]:
    """The label and the target of ``[LABEL=]TARGET``. Raises MethodError."""
    label, separator, target = text.partition("=")
    if separator and ":" not in label and " " not in label and "/" not in label:
        if not target:
            raise MethodError(f"'{text}' names no method; expected LABEL=METHOD")
    else:
        target = text
        command = text.removeprefix(SUBPROCESS)
        if text.startswith(SUBPROCESS):
            words = command.split()
            if not words:
                raise MethodError(f"{quoted(text)} names no program; expected subprocess:COMMAND")
            label = Path(words[0]).stem
        else:
            label = text.rpartition(":")[2] if ":" in text else text
    try:
        check_label(label, f"{kind.noun} label")
    except ValueError as bad:
        raise MethodError(f"{bad}; give one: LABEL={target}") from None
    return label, target


def target_of(text: str) -> str:
    """The ``TARGET`` of ``[LABEL=]TARGET``. Raises MethodError."""
    return split_label(text, TRACKERS)[1]


def _validated(named: str, parameter: Parameter, value: Any, text: str) -> Any:
    from pydantic import TypeAdapter, ValidationError

    adapter: TypeAdapter[Any] = TypeAdapter(parameter.annotation)
    try:
        return adapter.validate_python(value)
    except ValidationError as bad:
        try:
            return adapter.validate_python(text)  # YAML reads 1e-3 and 007 as strings, but the type may accept them
        except ValidationError:
            message, _ = first_fault(bad)
            raise MethodError(f"{named}: parameter {quoted(f'{parameter.name}={text}')}: {message}") from None


def _names(target: str, kind: MethodKind) -> set[str]:
    return {parameter.name for parameter in parameters_of(target, kind)}


def _declares(target: str, kind: MethodKind, name: str) -> bool:
    """Whether the class or factory of a method has a true attribute."""
    factory = method_class(target, kind)
    return bool(call_third_party(f"'{target}' cannot be read", lambda: getattr(factory, name, False)))

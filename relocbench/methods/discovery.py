"""Finding and configuring methods: installed ones, any class, any program.

A method is named by

- an entry point (``orb-pnp``) of the group ``relocbench.methods`` for trackers, or ``relocbench.retrievers`` for
  retrievers,
- a dotted path to a class (``mypackage.trackers:MyTracker``),
- for trackers, a command line that speaks the line protocol (``subprocess:./my_tracker --fast``),

each optionally preceded by the label that its results are kept under (``dso-fast=dso``).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from relocbench.errors import MethodError, available, cut, hint, one_line, quoted
from relocbench.files import YamlFault, check_distinct, check_label, first_fault, parse_yaml_setting, sha256_file
from relocbench.methods.lookup import OUR_METHODS, call_third_party, entry_points_of, load_dotted
from relocbench.methods.parameters import Parameter, parameters_of_factory

SUBPROCESS = "subprocess:"
START = "start"
"""the setting that names the tracker whose pose another one starts from"""
MOST_ASSUMED = 60
"""characters of what a method says that it assumes"""


@dataclass(frozen=True)
class MethodKind:
    """A kind of method, tracker or retriever; both are found and configured alike."""

    noun: str
    """what messages call it"""
    made: str
    """what it is, with an article"""
    group: str
    """entry-point group"""
    call: str
    """the function that it must have"""
    task: str
    """what it is used for, as ``relocbench methods --json`` calls it"""
    command: str
    """that evaluates it"""
    programs: bool
    """whether it can be a program"""


TRACKERS = MethodKind("method", "a tracker", "relocbench.methods", "track", "tracking", "evaluate", programs=True)
RETRIEVERS = MethodKind(
    "retriever", "a retriever", "relocbench.retrievers", "describe", "retrieval", "evaluate-retrieval", programs=False
)
KINDS = (TRACKERS, RETRIEVERS)


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


def installed_methods(kind: MethodKind = TRACKERS) -> dict[str, metadata.EntryPoint]:
    """The entry points of all installed methods of a kind, sorted by name; nothing is imported."""
    return entry_points_of(kind.group, kind.noun)


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


def _names(target: str, kind: MethodKind) -> set[str]:
    return {parameter.name for parameter in parameters_of(target, kind)}


def _declares(target: str, kind: MethodKind, name: str) -> bool:
    """Whether the class or factory of a method has a true attribute."""
    factory = method_class(target, kind)
    return bool(call_third_party(f"'{target}' cannot be read", lambda: getattr(factory, name, False)))


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


def method_class(target: str, kind: MethodKind = TRACKERS) -> Any:
    """The class or factory that is called with the parameters to construct a method. Raises MethodError."""
    if target.startswith(SUBPROCESS):
        if not kind.programs:
            raise MethodError(f"'{target}': a program cannot be {kind.made}; score what it wrote with --predictions")
        from relocbench.methods.subprocess_tracker import subprocess_tracker

        return subprocess_tracker(target.removeprefix(SUBPROCESS))
    if ":" in target:
        return _load_class(target, kind)
    points = installed_methods(kind)
    if target not in points:
        for other in KINDS:
            if other != kind and target in installed_methods(other):
                raise MethodError(
                    f"'{target}' is {other.made}, not {kind.made}; evaluate it with `relocbench {other.command}`"
                )
        program = ", or a program as subprocess:COMMAND" if kind.programs else ""
        raise MethodError(
            f"no {kind.noun} '{target}'{hint(target, points)}; installed: {', '.join(points) or 'none'} "
            f"(or name a class as package.module:Class{program})"
        )
    return _load_class(points[target].value, kind)


def target_of(text: str) -> str:
    """The ``TARGET`` of ``[LABEL=]TARGET``. Raises MethodError."""
    return split_label(text, TRACKERS)[1]


def kind_of(target: str) -> MethodKind:
    """Whether a target is a tracker or a retriever; a tracker if it is both, a program, or a class that is neither.

    Raises:
        MethodError: nothing of that name is installed, or a class cannot be imported.
    """
    if ":" in target and not target.startswith(SUBPROCESS):
        loaded = load_dotted(target, "method")
        fitting = [kind for kind in KINDS if callable(getattr(loaded, kind.call, None))]
    else:
        fitting = [kind for kind in KINDS if target in installed_methods(kind)]
        if not fitting and not target.startswith(SUBPROCESS):
            raise _nothing_called(target)
    return fitting[0] if fitting else TRACKERS


def _nothing_called(name: str) -> MethodError:
    """The error for a name that is neither an installed tracker nor an installed retriever."""
    from relocbench.methods.trainers import installed_trainers

    trainers = installed_trainers()
    if name in trainers:
        return MethodError(f"'{name}' is a trainer; its options are shown by `relocbench train {name} --show-options`")
    installed = {kind.made.split()[-1]: installed_methods(kind) for kind in KINDS} | {"trainer": trainers}
    alike = hint(name, [known for points in installed.values() for known in points])
    available = "; ".join(f"{noun}s: {', '.join(points) or 'none'}" for noun, points in installed.items())
    return MethodError(
        f"no method '{name}'{alike}; installed {available} (or name a class as package.module:Class, or a tracker's "
        "program as subprocess:COMMAND)"
    )


def parameters_of(target: str, kind: MethodKind = TRACKERS) -> list[Parameter]:
    """The parameters of a method, in the order of its constructor. Raises MethodError."""
    return parameters_of_factory(method_class(target, kind))


def distribution_version(target: str, kind: MethodKind = TRACKERS) -> str:
    """``name version`` of the package that provides the method, or ``unknown``."""
    point = installed_methods(kind).get(target)
    if point is not None and point.dist is not None:
        return f"{point.dist.name} {point.dist.version}"
    top = target.removeprefix(SUBPROCESS).split(":")[0].split(".")[0]
    owners = [] if target.startswith(SUBPROCESS) else _distributions().get(top, [])
    return f"{owners[0]} {metadata.version(owners[0])}" if owners else "unknown"


@cache
def _distributions() -> Mapping[str, list[str]]:
    """The packages that provide each module; reading what is installed takes a good part of a second."""
    return metadata.packages_distributions()


def is_ours(target: str, kind: MethodKind = TRACKERS) -> bool:
    """Whether importing a target runs no code but relocbench's own, nor does a program or a name that is unknown."""
    if target.startswith(SUBPROCESS):
        return True
    point = installed_methods(kind).get(target)
    path = target if ":" in target or point is None else point.value
    return ":" not in path or path.partition(":")[0].partition(".")[0] in (OUR_METHODS, "relocbench")


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


def _load_class(target: str, kind: MethodKind) -> Any:
    loaded = load_dotted(target, kind.noun)
    attribute = target.partition(":")[2]
    if not callable(getattr(loaded, kind.call, None)) and inspect.isclass(loaded):
        others = [k for k in KINDS if callable(getattr(loaded, k.call, None))]
        other = (
            f", but {others[0].call}(): it is {others[0].made} for `relocbench {others[0].command}`"
            if others
            else " method"
        )
        raise MethodError(f"{kind.noun} '{target}': class '{attribute}' has no {kind.call}(){other}")
    if not callable(loaded):
        raise MethodError(f"{kind.noun} '{target}': '{attribute}' is not a class or function that makes {kind.made}")
    return loaded


def _validated(named: str, parameter: Parameter, value: Any, text: str) -> Any:
    adapter: TypeAdapter[Any] = TypeAdapter(parameter.annotation)
    try:
        return adapter.validate_python(value)
    except ValidationError as bad:
        try:
            return adapter.validate_python(text)  # YAML reads 1e-3 and 007 as strings, but the type may accept them
        except ValidationError:
            message, _ = first_fault(bad)
            raise MethodError(f"{named}: parameter {quoted(f'{parameter.name}={text}')}: {message}") from None

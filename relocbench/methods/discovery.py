"""Finding methods: installed ones, any class, any program.

A method is named by

- an entry point (``orb-pnp``) of the group ``relocbench.methods`` for trackers, or ``relocbench.retrievers`` for
  retrievers,
- a dotted path to a class (``mypackage.trackers:MyTracker``),
- for trackers, a command line that speaks the line protocol (``subprocess:./my_tracker --fast``).
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from typing import Any

from relocbench.errors import MethodError, hint
from relocbench.methods.lookup import OUR_METHODS, entry_points_of, load_dotted
from relocbench.methods.parameters import Parameter, parameters_of_factory

SUBPROCESS = "subprocess:"


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


def installed_methods(kind: MethodKind = TRACKERS) -> dict[str, metadata.EntryPoint]:
    """The entry points of all installed methods of a kind, sorted by name; nothing is imported."""
    return entry_points_of(kind.group, kind.noun)


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

"""``relocbench methods``: what is installed."""

from __future__ import annotations

import shutil
import textwrap
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli.options import Json
from relocbench.errors import printable

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from importlib.metadata import EntryPoint

    from relocbench.methods import MethodKind
    from relocbench.methods.parameters import Parameter


def methods(
    name: Annotated[str | None, typer.Argument(metavar="METHOD", help="Show one method with its parameters.")] = None,
    json: Json = False,
) -> None:
    """List the installed trackers and retrievers with where their weights are, or one with its parameters.

    Example: relocbench methods dso
    """
    from relocbench.cli.console import print_json
    from relocbench.methods import KINDS, installed_methods, kind_of, parameters_of

    if name is None:
        found = {kind: installed_methods(kind) for kind in KINDS}
        if json:
            listed = {kind.task: {n: p.value for n, p in points.items()} for kind, points in found.items()}
            weights = {n: _weights(n, kind) for kind, points in found.items() for n in points}
            print_json({**listed, "weights": weights}, {task: len(names) for task, names in listed.items()})
        else:
            _print_list(found)
        return
    kind = kind_of(name)
    parameters = parameters_of(name, kind)
    if json:
        values = {
            p.name: {"type": p.type_name, "default": None if p.required else p.default, "words": p.words}
            for p in parameters
        }
        shown = {"method": name, "task": kind.task, "weights": _weights(name, kind), "parameters": values}
        print_json(shown, {"parameters": len(values)})
        return
    _print_method(name, kind, parameters)


def _print_list(found: Mapping[MethodKind, Mapping[str, EntryPoint]]) -> None:
    from relocbench.cli.console import print_table
    from relocbench.evaluation.tracking.trivial import CLOCK
    from relocbench.methods import TRACKERS
    from relocbench.methods.fetching import Weights

    rows = [
        [n, kind.task, _weights(n, kind), p.value, _package(p)]
        for kind, points in found.items()
        for n, p in points.items()
    ]
    rows.append([CLOCK, TRACKERS.task, Weights.NONE, "the timestamp-only baseline", "relocbench"])
    print_table("", ["method", "task", "weights", "class", "package"], rows)
    if any(row[2] == Weights.MISSING for row in rows):
        print(f"weights {Weights.MISSING}: relocbench fetch-weights METHOD")
    if any(row[2] == Weights.TRAINED for row in rows):
        print(f"weights {Weights.TRAINED}: relocbench train, then --set METHOD.weights=FILE")


def _print_method(name: str, kind: MethodKind, parameters: Sequence[Parameter]) -> None:
    """A method's parameters, each with its default, its type and what it is."""
    from relocbench.methods.fetching import Weights

    weights = _weights(name, kind)
    fetch = f"; to get them: relocbench fetch-weights {name}" if weights == Weights.MISSING else ""
    print(f"{name} ({kind.task}); weights: {weights}{fetch}")
    print("Parameters, set with --set key=value:" if parameters else "It has no parameters.")
    width = shutil.get_terminal_size().columns
    for p in parameters:
        default = "must be given" if p.required else f"default {p.default}"
        print(f"  {p.name}: {p.type_name}, {default}")
        words = " ".join(p.words.replace("``", "").split())
        if words:
            print(textwrap.fill(printable(words), width - 1, initial_indent="      ", subsequent_indent="      "))


def _weights(name: str, kind: MethodKind) -> str:
    """Where a method's weights are, in words; what keeps it from being imported where it cannot be."""
    from relocbench.errors import MethodError
    from relocbench.methods import MethodSpec, parameters_of
    from relocbench.methods.fetching import weights_of

    try:
        defaults = {p.name: None if p.required else p.default for p in parameters_of(name, kind)}
        return weights_of(MethodSpec(name, name, defaults, kind)).value
    except MethodError as why:
        return str(why)


def _package(point: object) -> str:
    dist = getattr(point, "dist", None)
    return f"{dist.name} {dist.version}" if dist is not None else ""

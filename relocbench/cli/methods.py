"""``relocbench methods``: what is installed."""

from __future__ import annotations

from typing import Annotated

import typer

from relocbench.cli.options import Json


def methods(
    name: Annotated[str | None, typer.Argument(metavar="METHOD", help="Show one method with its parameters.")] = None,
    json: Json = False,
) -> None:
    """List the installed trackers and retrievers, or one with its parameters.

    Example: relocbench methods dso
    """
    from relocbench.cli.console import print_json, print_table
    from relocbench.evaluation.tracking.clock import CLOCK
    from relocbench.methods import KINDS, TRACKERS, installed_methods, kind_of, parameters_of

    if name is None:
        found = {kind: installed_methods(kind) for kind in KINDS}
        if json:
            listed = {kind.task: {n: p.value for n, p in points.items()} for kind, points in found.items()}
            print_json(listed, {task: len(names) for task, names in listed.items()})
        else:
            rows = [[n, kind.task, p.value, _package(p)] for kind, points in found.items() for n, p in points.items()]
            rows.append([CLOCK, TRACKERS.task, "baseline: poses from timestamps alone", "relocbench"])
            print_table("", ["method", "task", "class", "package"], rows)
        return
    kind = kind_of(name)
    parameters = parameters_of(name, kind)
    if json:
        told = {p.name: {"type": p.type_name, "default": None if p.required else p.default} for p in parameters}
        print_json({"method": name, "task": kind.task, "parameters": told}, {"parameters": len(told)})
        return
    rows = [[p.name, p.type_name, "(must be given)" if p.required else str(p.default)] for p in parameters]
    print_table(f"{name} ({kind.task}): set with --set key=value", ["parameter", "type", "default"], rows)


def _package(point: object) -> str:
    dist = getattr(point, "dist", None)
    return f"{dist.name} {dist.version}" if dist is not None else ""

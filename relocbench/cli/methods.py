"""``relocbench methods``: what is installed."""

from __future__ import annotations

from typing import Annotated

import typer

from relocbench.cli.options import Json


def methods(
    name: Annotated[str | None, typer.Argument(help="Show one method with its parameters.")] = None,
    json: Json = False,
) -> None:
    """List the installed methods, or one with its parameters.

    Example: relocbench methods dso
    """
    from relocbench.cli.console import print_json, print_table
    from relocbench.methods import installed_methods, parameters_of

    if name is None:
        found = installed_methods()
        if json:
            print_json({n: p.value for n, p in found.items()})
        else:
            print_table("", ["method", "class", "package"], [[n, p.value, _package(p)] for n, p in found.items()])
        return
    parameters = parameters_of(name)
    if json:
        print_json({p.name: {"type": p.type_name, "default": None if p.required else p.default} for p in parameters})
        return
    rows = [[p.name, p.type_name, "(must be given)" if p.required else str(p.default)] for p in parameters]
    print_table(f"{name}: set with --set key=value", ["parameter", "type", "default"], rows)


def _package(point: object) -> str:
    dist = getattr(point, "dist", None)
    return f"{dist.name} {dist.version}" if dist is not None else ""

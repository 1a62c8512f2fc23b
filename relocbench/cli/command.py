"""Commands whose help shows a flag as a flag and an argument by its name: Typer would add ``<bool>`` and ``<str>``.

A command's name may be of two words, the first of which is a command too: ``leaderboard add`` beside ``leaderboard``.
"""

from __future__ import annotations

from typing import Any

from typer.core import TyperArgument, TyperCommand, TyperGroup

from relocbench.cli.spellings import OTHER_NAMES, as_shown


class Command(TyperCommand):
    """A command without types behind flags and arguments, whose options are understood under other names too."""

    def get_params(self, ctx: Any) -> Any:
        return _without_types(super().get_params(ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        known = {name for param in self.get_params(ctx) for name in (*param.opts, *param.secondary_opts)}
        return super().parse_args(ctx, as_shown(args, known, OTHER_NAMES.get(ctx.info_name, {})))


class Group(TyperGroup):
    """A group of commands without types behind its own flags, some of whose names are of two words."""

    def get_params(self, ctx: Any) -> Any:
        return _without_types(super().get_params(ctx))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        words = " ".join(args[:2])
        command = self.commands.get(words) if len(args) > 1 else None
        return super().resolve_command(ctx, args) if command is None else (words, command, args[2:])


def _without_types(params: Any) -> Any:
    for param in params:
        if isinstance(param, TyperArgument):
            vars(param)["display_type_rich"] = _no_type
        elif param.is_flag:
            param.metavar = ""
    return params


def _no_type(ctx: Any) -> str:
    return ""

"""A command line that cannot be read, in one line."""

from __future__ import annotations

from typing import Any

from typer.exceptions import TyperException


def usage_fault(bad: TyperException) -> str:
    """What is wrong, which other command has an unknown option, and where the usage is explained."""
    message = " ".join(bad.format_message().split()).rstrip(".")
    context = getattr(bad, "ctx", None)
    if context is None:
        return message
    option = getattr(bad, "option_name", None)
    others = [] if option is None else _commands_with(option, context)
    if others:
        message = f"No such option: {option}; it is an option of {' and '.join(others)}"
    return f"{message} (see `{context.command_path} --help`)"


def _commands_with(option: str, context: Any) -> list[str]:
    """The commands of the same family, such as ``evaluate-retrieval`` of ``evaluate``, that have the option."""
    root = context.find_root()
    family = str(context.info_name).partition("-")[0]
    return [
        f"{root.command_path} {name}"
        for name, command in getattr(root.command, "commands", {}).items()
        if name.partition("-")[0] == family and any(option in parameter.opts for parameter in command.params)
    ]

"""A command line that cannot be read, in one line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from typer.exceptions import TyperException

from relocbench.cli.spellings import REMOVED
from relocbench.errors import hint


def usage_fault(bad: TyperException) -> str:
    """What is wrong, which other commands have an unknown option, and where the usage is explained."""
    message = " ".join(bad.format_message().split()).rstrip(".").replace(": Value error, ", ": ")
    wrong = re.search("'([^']*)' is not one of (.*)", message)
    if wrong is not None:
        message += hint(wrong[1], re.findall("'([^']*)'", wrong[2]))
    context = getattr(bad, "ctx", None)
    if context is None:
        return message
    option = getattr(bad, "option_name", None)
    others = "" if option is None else _commands_with(option, context)
    if instead := REMOVED.get((str(context.info_name), str(option))):
        message = f"No such option: {option}; {instead}"
    elif others:
        message = f"No such option: {option}; it is an option of {others}"
    return f"{message} (see `{context.command_path} --help`)"


def listed(names: Sequence[str]) -> str:
    """``a, b and c``."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def _commands_with(option: str, context: Any) -> str:
    """The related commands that have the option, for a message.

    These are the commands of the same family, such as ``evaluate-retrieval`` of ``evaluate``, and the other kinds of
    ``build-dataset``.
    """
    group = context.parent
    if group is None:
        return ""
    family = str(context.info_name).partition("-")[0] if group.parent is None else ""
    found = []
    for name in group.command.list_commands(group):
        if not family or name.partition("-")[0] == family:
            command = group.command.get_command(group, name)
            if any(option in parameter.opts for parameter in command.params):
                found.append(f"{group.command_path} {name}" if family else name)
    if not found:
        return ""
    return listed(found) if family else f"{group.command_path} {listed(found)}"

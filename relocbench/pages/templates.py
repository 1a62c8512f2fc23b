"""Filling templates: the same values give the same bytes, and a value that is not given is an error."""

from __future__ import annotations

import sys
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from relocbench.pages.markdown import code, escaped, fenced, table_text

if TYPE_CHECKING:
    from jinja2 import Environment
    from jinja2.nodes import EvalContext


def render(module: str, template: str, /, **values: object) -> str:
    """The text of a template that lies beside a module.

    A Markdown template shows foreign text through the filters ``escaped``, ``code`` and ``fenced``
    (:mod:`relocbench.pages.markdown`) and has the function ``table``; in HTML everything is escaped. Templates of other
    folders are included as ``PACKAGE/FILE``, for example ``relocbench.leaderboard.common/commands.md.j2``.

    Args:
        module: ``__name__`` of the module, which may be a script.
        template: name of the file, whose end says what it is: ``.md.j2`` or ``.html.j2``.
        values: what the template names.
    """
    folder = module.rpartition(".")[0] or module
    return _environment().get_template(f"{folder}/{template}").render(values)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined, pass_eval_context  # only where a page is written
    from markupsafe import Markup

    @pass_eval_context
    def shown(context: EvalContext, value: object) -> object:
        """Text in HTML with its quotes as :func:`html.escape` writes them; markup stays as it is."""
        return Markup(escape(str(value))) if context.autoescape and not hasattr(value, "__html__") else value

    found = Environment(
        loader=FunctionLoader(_source),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=lambda name: name is not None and name.endswith(".html.j2"),
        finalize=shown,
    )
    found.filters |= {"escaped": escaped, "code": code, "fenced": fenced}
    found.globals |= {"table": table_text}
    return found


def _source(name: str) -> tuple[str, str, None]:
    """The text of a template and its path, for tracebacks; packages are read wherever they are installed."""
    folder, _, file = name.partition("/")
    known = sys.modules.get(folder)
    if known is None or hasattr(known, "__path__"):
        path = files(folder) / file
        return path.read_text(encoding="utf-8"), str(path), None
    beside = Path(str(known.__file__)).with_name(file)  # of a script
    return beside.read_text(encoding="utf-8"), str(beside), None

"""Numbers and Markdown as people read them."""

from __future__ import annotations

import math
from collections.abc import Sequence

_DIGITS = {"m": 3, "deg": 3, "s": 3}


def number(value: float | None, unit: str) -> str:
    """A value in its unit without the unit's name; shares in percent, empty where there is none."""
    if value is None:
        return ""
    if math.isinf(value):
        return "inf"
    return f"{100 * value:.1f}" if unit == "share" else f"{value:.{_DIGITS[unit]}f}"


def escaped(text: str) -> str:
    """Text that Markdown shows as it is, in a table too."""
    for special in "\\`*_|<>[]":
        text = text.replace(special, f"\\{special}")
    return " ".join(text.split())


def code(text: str) -> str:
    """Text between backticks, in a table too."""
    plain = " ".join(text.split()).replace("|", "\\|")
    return f"``{plain}``" if "`" in plain else f"`{plain}`"


def bullet(head: str, lines: Sequence[str]) -> str:
    """A sentence and a list; empty without lines."""
    return "\n".join([head, "", *(f"- {line}" for line in lines)]) if lines else ""


def table_text(columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: int) -> str:
    """A Markdown table whose first ``left`` columns are aligned left, the others right."""
    rule = [":--" if i < left else "--:" for i in range(len(columns))]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [columns, rule, *rows])

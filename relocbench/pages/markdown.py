"""Foreign text in Markdown: names, messages and parameters come from whoever made the results.

All of them pass through :func:`escaped`, :func:`code` or :func:`fenced`, so that they are shown as text and cannot act
as markup.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

_STARTS_BLOCK = re.compile(r"(#{1,6}|[+-])(?= |$)|(- ?){2,}$|=+$|~~~|[0-9]{1,9}[.)](?= |$)")
"""the beginning of a line that Markdown would take for a heading, a list, a rule or code"""
_ENTITY = re.compile(r"&(?=#?\w{1,40};)")
"""what Markdown would take for another character"""


def escaped(text: str) -> str:
    """Text that Markdown shows literally, also in a table and at the beginning of a line."""
    plain = _one_line(text)
    for special in "\\`*_|<>[]~$":
        plain = plain.replace(special, f"\\{special}")
    plain = _ENTITY.sub(r"\\&", plain)
    start = _STARTS_BLOCK.match(plain)
    if start is None:
        return plain
    at = start.end() - 1 if plain[0].isdigit() else 0
    return f"{plain[:at]}\\{plain[at:]}"


def code(text: str) -> str:
    """Text as inline code in Markdown, also in a table; it is delimited by more backticks than it contains."""
    plain = _one_line(text)
    if "\\|" in plain or not plain:
        # Markdown dialects differ on which of the two a backslash before a table's bar escapes.
        return f"<code>{''.join(c if c.isalnum() or c == ' ' else f'&#{ord(c)};' for c in plain)}</code>"
    plain = plain.replace("|", "\\|")
    ticks = "`" * (_longest_run(plain) + 1)
    gap = " " if plain.startswith("`") or plain.endswith("`") else ""
    return f"{ticks}{gap}{plain}{gap}{ticks}"


def fenced(lines: Sequence[str]) -> str:
    """Lines of a shell as fenced code, control characters as escapes; the fence is longer than all backticks within."""
    shown = ["".join(c if c.isprintable() else ascii(c)[1:-1] for c in line) for line in lines]
    fence = "`" * max(3, *(_longest_run(line) + 1 for line in shown), 3)
    return "\n".join([f"{fence}sh", *shown, fence])


def table_text(columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: int) -> str:
    """A Markdown table with its first ``left`` columns aligned left and the others right."""
    rule = [":--" if i < left else "--:" for i in range(len(columns))]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [columns, rule, *rows])


def _one_line(text: str) -> str:
    """Text with white space as single spaces, and with control characters replaced by U+FFFD."""
    return "".join(c if c.isprintable() else "\ufffd" for c in " ".join(text.split()))


def _longest_run(text: str) -> int:
    return max((len(run) for run in re.findall("`+", text)), default=0)

r"""Tables for papers in LaTeX, ready for ``\input``; they need the packages that the comment at their head names.

All text passes through :func:`escaped`: names and conditions come from whoever made the results, and a backslash of
theirs must not act.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Generic, TypeVar

from relocbench.leaderboard.common.columns import Column
from relocbench.leaderboard.common.text import number

L = TypeVar("L")

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "°": r"\textdegree{}",
    "†": r"\textdagger{}",
    "→": r"\textrightarrow{}",
    "×": r"\texttimes{}",
    "±": r"\textpm{}",
    "−": "-",
    "–": r"\textendash{}",
    # At the beginning of a cell a bracket or a star would belong to the line break before it, and quotation marks in a
    # row would be joined.
    "[": "{[}",
    "]": "{]}",
    "*": "{*}",
    "'": "{'}",
    "`": "{`}",
}


@dataclass(frozen=True, eq=False)
class LatexTable(Generic[L]):
    """A table of methods and metrics."""

    of: str
    """the set, which begins the caption and the label"""
    place: str
    """which of its tables"""
    names: Sequence[Column[L]]
    """the columns on the left, of text, before the rank"""
    rank: Column[L]
    columns: Sequence[Column[L]]
    """of numbers"""
    lines: Sequence[L]
    competes: Callable[[L], bool]
    """whether values of a line may be the best: those of trivial baselines and of methods that know more may not"""
    metric: str
    """the one that ranks, whose intervals are shown"""
    note: str = ""
    """a sentence for the caption"""


def escaped(text: str) -> str:
    """Text that LaTeX shows literally; characters that the usual fonts lack become question marks."""
    shown = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    plain = "".join(_SPECIAL.get(c, c if c.isascii() or _is_in_fonts(c) else "?") for c in shown)
    return re.sub("([-,])(?=\\1)", r"\1{}", plain)  # in a row they would be joined, to a dash or a quotation mark


def _is_in_fonts(letter: str) -> bool:
    """Whether the encoding T1 has a letter that is not ASCII."""
    return letter.isalpha() and ord(letter) < 0x180 and letter not in "ĦħĸĿŀŉŦŧſ"


def document(tables: Iterable[LatexTable[Any]]) -> str:
    """All tables, below a comment that says what they need.

    A label that is another's once it has letters and hyphens alone gets a number.
    """
    texts = ["% Needs \\usepackage{booktabs,graphicx,textcomp} and \\usepackage[T1]{fontenc}.\n"]
    seen: Counter[str] = Counter()
    for table in tables:
        label = re.sub("[^A-Za-z0-9:]", "-", f"tab:{table.of}:{table.place}")
        seen[label] += 1
        texts.append(_table_text(table, label if seen[label] == 1 else f"{label}:{seen[label]}"))
    return "\n".join(texts)


def _table_text(table: LatexTable[L], label: str) -> str:
    """One table, with its caption; the best value of each column that has one is bold."""
    best = [_best(table, column) for column in table.columns]
    head = [escaped(column.heading) for column in (*table.names, table.rank)]
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_caption(table)}}}",
        rf"\label{{{label}}}",
        r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
        rf"\begin{{tabular}}{{{'l' * len(table.names)}r{'r' * len(table.columns)}}}",
        r"\toprule",
        " & ".join([*head, *map(_heading, table.columns)]) + r" \\",
        r"\midrule",
        *(_line(table, line, best) for line in table.lines),
        r"\bottomrule",
        r"\end{tabular}}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _line(table: LatexTable[L], line: L, best: Sequence[str]) -> str:
    competes = table.competes(line)
    names = [escaped(column.text(line)) for column in table.names]
    cells = [*(name if competes else rf"\textit{{{name}}}" for name in names), escaped(table.rank.text(line))]
    for column, best_text in zip(table.columns, best, strict=True):
        text = shown = _number(_value(column, line), column.unit)
        if competes and text and text == best_text:
            shown = rf"\textbf{{{text}}}"
        interval = column.bounds(line) if column.bounds is not None and column.key == table.metric else None
        if text and interval is not None:
            low, high = (_number(bound, column.unit) for bound in (interval.low, interval.high))
            shown += rf" {{\scriptsize {{[}}{low}, {high}{{]}}}}"
        cells.append(shown)
    return " & ".join(cells) + r" \\"


def _value(column: Column[L], line: L) -> float | None:
    value = column.value(line)
    assert value is None or isinstance(value, int | float)
    return value


def _best(table: LatexTable[L], column: Column[L]) -> str:
    """The best value of a column as it is shown, so that what looks equal is bold alike; empty where there is none."""
    values = [_value(column, line) for line in table.lines if table.competes(line)]
    known = [value for value in values if value is not None and isfinite(value)]
    if column.higher_is_better is None or not known:
        return ""
    return _number(max(known) if column.higher_is_better else min(known), column.unit)


def _number(value: float | None, unit: str) -> str:
    text = number(value, unit)
    return r"$\infty$" if text == "inf" else text.replace("-", r"$-$")


def _heading(column: Column[L]) -> str:
    """The heading, with an arrow that says which end is better."""
    arrow = {None: "", True: r" $\uparrow$", False: r" $\downarrow$"}[column.higher_is_better]
    return escaped(column.heading) + arrow


def _caption(table: LatexTable[L]) -> str:
    definitions = [f"{escaped(c.heading)}: {escaped(c.definition)}" for c in table.columns if c.definition]
    bounds = [c.bounds for c in table.columns if c.key == table.metric and c.bounds is not None]
    ranged = any(of(line) is not None for of in bounds for line in table.lines)
    parts = [
        f"{escaped(f'{table.of}, {table.place}')}.",
        escaped(table.note),
        "; ".join(definitions) + "." if definitions else "",
        "Shares are in percent." if any(c.unit == "share" for c in table.columns) else "",
        "In small print, 95\\,\\% intervals." if ranged else "",
        "Best in bold.",
        "" if all(map(table.competes, table.lines)) else "In italics, what is not ranked.",
    ]
    return " ".join(filter(None, parts))

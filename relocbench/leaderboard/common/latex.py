r"""Tables for papers in LaTeX, ready for ``\input``; they need the packages that the comment at their head names.

All text passes through :func:`escaped`: names and conditions come from whoever made the results, and a backslash of
theirs must not act.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite

from relocbench.leaderboard.common.ranks import rank_text
from relocbench.leaderboard.common.text import number
from relocbench.metrics import Interval

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
    # At the beginning of a cell a bracket or a star would belong to the line break before it, and quotation marks in a
    # row would be joined.
    "[": "{[}",
    "]": "{]}",
    "*": "{*}",
    "'": "{'}",
    "`": "{`}",
}


@dataclass(frozen=True)
class Column:
    """A column of numbers."""

    heading: str
    unit: str
    """share, m, deg, s, or empty for counts"""
    higher_is_better: bool | None
    """None where no value is the best"""
    definition: str = ""
    """what the number is, for the caption"""


@dataclass(frozen=True)
class Line:
    """The line of a method."""

    names: tuple[str, ...]
    rank: int | None
    values: tuple[float | None, ...]
    """one for each column"""
    intervals: tuple[Interval | None, ...]
    competes: bool = True
    """whether its values may be the best: those of trivial baselines and of methods that know more may not"""


@dataclass(frozen=True)
class LatexTable:
    """A table of methods and metrics."""

    title: str
    label: str
    heads: tuple[str, ...]
    """headings of the names"""
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]
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


def document(tables: Sequence[LatexTable]) -> str:
    """All tables, below a comment that says what they need."""
    head = "% Needs \\usepackage{booktabs,graphicx,textcomp} and \\usepackage[T1]{fontenc}.\n"
    return "\n".join([head, *map(table_text, _with_labels_of_their_own(tables))])


def _with_labels_of_their_own(tables: Sequence[LatexTable]) -> Iterator[LatexTable]:
    """The tables; a label that is another's once it has letters and hyphens alone gets a number."""
    seen: Counter[str] = Counter()
    for table in tables:
        plain = _label(table.label)
        seen[plain] += 1
        yield table if seen[plain] == 1 else replace(table, label=f"{plain}:{seen[plain]}")


def table_text(table: LatexTable) -> str:
    """One table, with its caption; the best value of each column that has one is bold."""
    best = [_best(table, index) for index in range(len(table.columns))]
    names = len(table.heads)
    head = [*map(escaped, table.heads), "rank", *(_heading(column) for column in table.columns)]
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{_caption(table)}}}",
        rf"\label{{{_label(table.label)}}}",
        r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
        rf"\begin{{tabular}}{{{'l' * names}r{'r' * len(table.columns)}}}",
        r"\toprule",
        " & ".join(head) + r" \\",
        r"\midrule",
        *(_line(table, line, best) for line in table.lines),
        r"\bottomrule",
        r"\end{tabular}}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _line(table: LatexTable, line: Line, best: Sequence[str | None]) -> str:
    names = [escaped(name) if line.competes else rf"\textit{{{escaped(name)}}}" for name in line.names]
    cells = [*names, rank_text(line, table.lines).replace("–", "--")]
    for index, column in enumerate(table.columns):
        text = _number(line.values[index], column)
        bold = line.competes and text != "" and text == best[index]
        shown = rf"\textbf{{{text}}}" if bold else text
        interval = line.intervals[index]
        if text and interval is not None:
            low, high = (_number(bound, column) for bound in (interval.low, interval.high))
            shown += rf" {{\scriptsize {{[}}{low}, {high}{{]}}}}"
        cells.append(shown)
    return " & ".join(cells) + r" \\"


def _best(table: LatexTable, index: int) -> str | None:
    """The best value of a column as it is shown, so that what looks equal is bold alike; None where there is none."""
    column = table.columns[index]
    values = [value for line in table.lines if line.competes and (value := line.values[index]) is not None]
    values = [value for value in values if isfinite(value)]
    if column.higher_is_better is None or not values:
        return None
    value = max(values) if column.higher_is_better else min(values)
    return _number(value, column)


def _number(value: float | None, column: Column) -> str:
    if value is None:
        return ""
    if not column.unit:
        return str(int(value))
    text = number(value, column.unit)
    return r"$\infty$" if text == "inf" else text.replace("-", r"$-$")


def _heading(column: Column) -> str:
    """The heading, with an arrow that says which end is better."""
    arrow = {None: "", True: r" $\uparrow$", False: r" $\downarrow$"}[column.higher_is_better]
    return escaped(column.heading) + arrow


def _caption(table: LatexTable) -> str:
    definitions = [f"{escaped(c.heading)}: {escaped(c.definition)}" for c in table.columns if c.definition]
    shares = "Shares are in percent." if any(c.unit == "share" for c in table.columns) else ""
    ranged = any(interval is not None for line in table.lines for interval in line.intervals)
    intervals = "In small print, 95\\,\\% intervals." if ranged else ""
    unranked = "" if all(line.competes for line in table.lines) else "In italics, what is not ranked."
    parts = [f"{escaped(table.title)}.", escaped(table.note), "; ".join(definitions) + "." if definitions else ""]
    return " ".join(part for part in [*parts, shares, intervals, "Best in bold.", unranked] if part)


def _label(text: str) -> str:
    """A label of letters, digits, colons and hyphens."""
    return "".join(c if c.isascii() and (c.isalnum() or c == ":") else "-" for c in text)


def intervals_of(names: Sequence[str], intervals: Mapping[str, Interval | None]) -> tuple[Interval | None, ...]:
    """The intervals of these metrics, None where there is none."""
    return tuple(intervals.get(name) for name in names)

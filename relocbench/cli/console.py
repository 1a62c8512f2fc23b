"""What the command line prints: tables and JSON on standard output, progress and notes on standard error."""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from relocbench.errors import printable
from relocbench.progress import Advance, Reporter, Silent

_PLAIN_INTERVAL_S = 10.0


class ConsoleReporter:
    """Bars with an estimate on a terminal; plain lines, a few a minute, elsewhere."""

    def __init__(self) -> None:
        self.console = Console(stderr=True, highlight=False)

    @contextmanager
    def stage(self, description: str, total: int) -> Iterator[Advance]:
        if total <= 0:
            yield lambda count: None
        elif self.console.is_terminal:
            with self._bars() as bars:
                task = bars.add_task(description, total=total)
                yield lambda count: bars.advance(task, count)
        else:
            plain = _PlainStage(description, total)
            yield plain.advance
            plain.finish()

    def note(self, message: str) -> None:
        self.console.print(f"note: {printable(message)}", style="dim", markup=False, soft_wrap=True)

    def _bars(self) -> Progress:
        return Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=self.console,
        )


class Pace:
    """How long the rest of some work takes, by its recent pace.

    The first units come with imports and compilation, once in each worker, and are left out: the pace is that of the
    later half of the time since the first unit was done, of ten seconds at least, and of one unit at least.
    """

    def __init__(self, total: int) -> None:
        self.total, self.done = total, 0
        self._history: list[tuple[float, int]] = []
        """when a unit was done, and how many were done then"""

    def advance(self, count: int, now: float) -> None:
        """Take note of ``count`` more units that were done at a time in seconds."""
        self.done += count
        self._history.append((now, self.done))

    def left(self, now: float) -> float | None:
        """Seconds that are left; None while only first units are done."""
        if len(self._history) < 2:
            return None
        first = self._history[0][0]
        since = now - max(_PLAIN_INTERVAL_S, (now - first) / 2)
        earlier = self._history[:-1]
        start, before = next((entry for entry in reversed(earlier) if entry[0] <= since), earlier[0])
        return (now - start) / (self.done - before) * (self.total - self.done)


class _PlainStage:
    """Progress for logs: a line when something was waited for, and one at the end."""

    def __init__(self, description: str, total: int) -> None:
        self.description, self.pace = description, Pace(total)
        self.start = self.last = time.monotonic()

    def advance(self, count: int) -> None:
        now = time.monotonic()
        self.pace.advance(count, now)
        if now - self.last >= _PLAIN_INTERVAL_S and self.pace.done < self.pace.total:
            self.last = now
            left = self.pace.left(now)
            self._print(f"{self._count}, {'begun' if left is None else f'about {left:.0f} s left'}")

    def finish(self) -> None:
        self._print(f"{self._count} in {time.monotonic() - self.start:.1f} s")

    @property
    def _count(self) -> str:
        return f"{self.pace.done}/{self.pace.total}"

    def _print(self, text: str) -> None:
        print(f"{self.description}: {text}", file=sys.stderr, flush=True)


def reporter(quiet: bool) -> Reporter:
    """What long-running work reports to."""
    return Silent() if quiet else ConsoleReporter()


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table on standard output; columns after the first are aligned right, and those of long texts left.

    Where it is wider than the terminal, its headings are broken into lines between their words, then long texts are
    wrapped, and then columns are left out, the last ones first; their names stand below the table.
    """
    table = [[printable(cell) for cell in row] for row in rows]
    texts = {i for i in range(len(columns)) if any(len(row[i]) > _SHORT and " " in row[i] for row in table)}
    names, shown = list(columns), list(range(len(columns)))
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        # Piped into a file or a pager a table keeps its width instead of being squeezed into 80 columns.
        width = max(console.width, len(title), _width(names, table, shown))
        console = Console(highlight=False, markup=False, width=width)
    if title:
        console.print(printable(title), style="table.title")
    if console.is_terminal and _width(names, table, shown) > console.width:
        names = [in_lines(name) for name in columns]
        while len(shown) > 1 and _width(names, table, shown, texts) > console.width:
            shown.pop()
    grid = Table(header_style="bold")
    for i in shown:
        justify: Literal["left", "right"] = "left" if i == 0 or i in texts else "right"
        grid.add_column(names[i], justify=justify, overflow="fold", no_wrap=i not in texts)
    for row in table:
        grid.add_row(*(row[i] for i in shown))
    console.print(grid)
    if left_out := [name for i, name in enumerate(columns) if i not in shown]:
        words = ", ".join(" ".join(name.split()) for name in left_out)
        console.print(f"too wide for this terminal, see --json: {words}", style="dim")


_SHORT = 28
"""characters of the longest number or name; longer cells of several words are texts, which may be wrapped"""
_LEAST_TEXT = 20
"""characters of a column of texts that is wrapped, at least"""


def _width(
    names: Sequence[str], rows: Sequence[Sequence[str]], shown: Sequence[int], wrapped: Collection[int] = ()
) -> int:
    """The least width of some columns of a table with its frame, where some of them may be wrapped."""
    total = 1
    for i in shown:
        widest = max((len(row[i]) for row in rows), default=0)
        heading = max(map(len, names[i].split("\n")))
        total += 3 + max(heading, min(widest, _LEAST_TEXT) if i in wrapped else widest)
    return total


def in_lines(heading: str, most: int = 12) -> str:
    """A heading in lines of at most ``most`` characters, where its words allow: ``median_`` above ``seconds``."""
    lines = [""]
    for word in re.split(r"(?<=[_@ ,])(?=[^ ,])", heading):
        if lines[-1] and len((lines[-1] + word).rstrip()) > most:
            lines.append("")
        lines[-1] += word
    return "\n".join(line.rstrip() for line in lines)


def print_json(values: Mapping[str, Any], counts: Mapping[str, int]) -> None:
    """One strict JSON object with its counts: a number that is not finite becomes null."""
    from relocbench.files import strict_json

    print(json.dumps(strict_json({**values, "counts": counts}), ensure_ascii=False, default=str))

"""In which formats a leaderboard is written. One more is one more line of :data:`FORMATS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from relocbench.errors import ConfigError, available, quoted
from relocbench.files import write_text
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.html.manifest import earlier_files
from relocbench.leaderboard.html.site import write_site
from relocbench.leaderboard.tracking import latex as tracking_latex
from relocbench.leaderboard.tracking.write import write_pages, write_tables
from relocbench.progress import Reporter


@dataclass(frozen=True)
class How:
    """What decides how boards are written, besides themselves."""

    pairs: int
    """number of pairs with images, as :func:`write_site` takes it"""
    reporter: Reporter


Writer = Callable[[Boards, Path, How], list[Path]]
"""writes boards into a folder and returns the files; of a site its first page comes first"""


def _csv(boards: Boards, out: Path, how: How) -> list[Path]:
    files = [] if boards.tracking is None else write_tables(boards.tracking, out)
    return files + [path for display, board in boards.by_query for path in display.write_table(board, out)]


def _markdown(boards: Boards, out: Path, how: How) -> list[Path]:
    files = [] if boards.tracking is None else write_pages(boards.tracking, out)
    return files + [path for display, board in boards.by_query for path in display.write_page(board, out)]


def _latex(boards: Boards, out: Path, how: How) -> list[Path]:
    texts = {} if boards.tracking is None else {out / "leaderboard.tex": tracking_latex.latex_page(boards.tracking)}
    texts |= {out / f"{display.name}.tex": display.latex(board) for display, board in boards.by_query}
    for path, text in texts.items():
        write_text(path, text)
    return list(texts)


def _html(boards: Boards, out: Path, how: How) -> list[Path]:
    first = write_site(boards, out / "html", pairs=how.pairs, reporter=how.reporter)
    return [first, *sorted(earlier_files(out / "html") - {first})]


FORMATS: Mapping[str, Writer] = MappingProxyType({"csv": _csv, "markdown": _markdown, "latex": _latex, "html": _html})
"""name of a format -> what writes it"""
USUAL = ("csv", "markdown")
"""the formats that are written unless others are asked for"""


def check_formats(names: Sequence[str], html: bool = False) -> tuple[str, ...]:
    """The formats without repetition, or the usual ones where none is named; ``html`` besides, if asked for.

    Raises:
        ConfigError: an unknown format.
    """
    for name in names:
        if name not in FORMATS:
            raise ConfigError(f"no --format {quoted(name)}{available(name, FORMATS)}")
    chosen = [*(names or USUAL), *(["html"] if html else [])]
    return tuple(dict.fromkeys(chosen))


def write_formats(boards: Boards, out: Path, formats: Sequence[str], how: How) -> list[Path]:
    """Write boards in these formats; returns the files. Each appears whole or not at all, and none holds a date."""
    return [path for name in formats for path in FORMATS[name](boards, out, how)]

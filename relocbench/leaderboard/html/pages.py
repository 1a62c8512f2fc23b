"""Writing a page of the site from a template."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from relocbench import version
from relocbench.files import write_text
from relocbench.metrics import CORRECT
from relocbench.pages import render


def write_page(path: Path, template: str, **values: object) -> None:
    """Fill a template of the folder ``templates``, and write it.

    Args:
        template: such as ``set.html.j2``.
        values: of the template, besides the version of relocbench.
    """
    write_text(path, render(__name__, f"templates/{template}", version=version.__version__, **values))


def write_board_page(
    path: Path, page: str, key: str, title: str, name: str, facts: Mapping[str, object], charts: Sequence[str]
) -> None:
    """Write the page of a set of queries.

    Args:
        page: ``retrieval`` or ``relocalization``.
        key: of its payload.
        name: of the set, its heading.
        facts: what stands below it.
        charts: the scripts of its charts.
    """
    values = {"key": key, "title": title, "name": name, "facts": facts.items(), "charts": charts, "correct": CORRECT}
    write_page(path, "query_board.html.j2", page=page, **values)


def write_query_page(path: Path, page: str, sets: str) -> None:
    """Write the page of a query: ``query`` of retrievers, ``located`` of pipelines, with payloads below ``sets``."""
    write_page(path, "query.html.j2", page=page, sets=sets)

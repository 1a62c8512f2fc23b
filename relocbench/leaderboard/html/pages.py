"""Writing a page of the site from a template."""

from __future__ import annotations

from pathlib import Path

from relocbench import version
from relocbench.files import write_text
from relocbench.pages import render


def write_page(path: Path, template: str, **values: object) -> None:
    """Fill a template of the folder ``templates``, and write it.

    Args:
        template: such as ``set.html.j2``.
        values: of the template, besides the version of relocbench.
    """
    write_text(path, render(__name__, f"templates/{template}", version=version.__version__, **values))

"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bars, no notes.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]
Workers = Annotated[
    int | None, typer.Option("--workers", "-j", min=1, help="Local worker processes [default: one a core].")
]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler that work is sent to instead (extra 'cluster').")
]
DatasetPath = Annotated[Path, typer.Option("--dataset", "-d", help="Folder of the dataset.")]
Methods = Annotated[
    list[str],
    typer.Option(
        "--method",
        "-m",
        help="Installed name, package.module:Class, or 'subprocess:COMMAND'; with LABEL= in front to keep it under "
        "that label. Repeat for several.",
    ),
]
Settings = Annotated[
    list[str],
    typer.Option("--set", help="key=value for every method, or LABEL.key=value for one. Repeat for several."),
]


def split_commas(values: list[str]) -> list[str]:
    """``["a,b", "c"]`` -> ``["a", "b", "c"]``."""
    return [part.strip() for value in values for part in value.split(",") if part.strip()]

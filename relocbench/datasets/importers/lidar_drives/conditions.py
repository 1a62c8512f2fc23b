"""Conditions of drives by the dates in their folders' names, and those of simulated drives by their table."""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core.schema import Condition
from relocbench.errors import DatasetError
from relocbench.files import read_csv

_SEASONS = ("winter", "spring", "summer", "autumn")


def season_of(month: int) -> str:
    """Season of a month, 1 to 12, on the northern hemisphere; unknown for other numbers."""
    return _SEASONS[month % 12 // 3] if 1 <= month <= 12 else "unknown"


def dated(month: int | None, folder: Path) -> Condition:
    """The condition of a drive that states nothing but its date, whose season follows from the month.

    The date of a simulated drive means nothing; its condition becomes a tag.
    """
    simulated = simulated_condition(folder)
    if simulated is not None:
        return Condition(tags=(simulated,) if simulated else ())
    return Condition(season="unknown" if month is None else season_of(month))


def simulated_condition(folder: Path) -> str | None:
    """The condition of a simulated drive by ``drives.csv`` in one of the two folders above; None for real drives."""
    path = folder.resolve()
    table = next((p / "drives.csv" for p in (path.parent, path.parent.parent) if (p / "drives.csv").is_file()), None)
    if table is None:
        return None
    rows = read_csv(table, "which drive is which", DatasetError)
    header = next(rows, (1, []))[1]
    drives = [dict(zip(header, row, strict=False)) for _, row in rows]
    return next((drive.get("condition", "") for drive in drives if drive.get("name") == path.name), "")

"""The radii of a probe, as ``relocbench probe`` writes them: ``from made_radii import write_radii``."""

from __future__ import annotations

from pathlib import Path

from relocbench.evaluation.probe.records import RADII
from relocbench.files import write_table

_GIVEN = ("method", "what", "conditions", "radius")


def write_radii(path: Path, *rows: tuple[str, str, str, object]) -> None:
    """Write ``radii.csv``: method, what, conditions and radius of each row."""
    columns = dict.fromkeys(RADII.columns, "") | {"pairs": "3", "from_truth": "0.9"}
    write_table(path, RADII.columns, ((columns | dict(zip(_GIVEN, row, strict=True))).values() for row in rows))

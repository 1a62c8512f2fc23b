"""The two contact sheets in the repository of University-1652's authors: 500 buildings, by drone and by satellite.

Cell (r, c) shows the same building in ``sample_drone.jpg`` and in ``sample_satellite.jpg``. Cells are 134 pixels wide
at a pitch of 158 pixels and have a black border of 3; the inner 128 x 128 pixels are the image.
"""

from __future__ import annotations

from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from relocbench.arrays import Image
from relocbench.datasets.cross_view import content
from relocbench.datasets.cross_view.cross_view_set import CrossViewSet, Shot, read_rgb
from relocbench.errors import DatasetError
from relocbench.retrieval import ImageView

SHEETS = {"drone": "sample_drone.jpg", "satellite": "sample_satellite.jpg"}
ROWS, COLUMNS = 25, 20
PITCH, BORDER, SIDE = 158, 3, 128
"""pixels"""


def is_sample(path: Path) -> bool:
    """Whether a folder holds both sheets."""
    return all((path / sheet).is_file() for sheet in SHEETS.values())


def open_sample(path: Path) -> CrossViewSet:
    """The 500 pairs as a test set in both directions. Raises DatasetError if a sheet is too small."""
    cells = {view: _shots(path / sheet, view) for view, sheet in SHEETS.items()}
    return CrossViewSet(
        path,
        "university1652-sample",
        {},
        cells,
        cells,
        lambda: content.fingerprint_of(content.rows_of(path, SHEETS.values())),
    )


def _shots(path: Path, view: str) -> tuple[Shot, ...]:
    height, width = _sheet(path).shape[:2]
    if height < (ROWS - 1) * PITCH + 2 * BORDER + SIDE or width < (COLUMNS - 1) * PITCH + 2 * BORDER + SIDE:
        raise DatasetError(f"is {width}x{height}; expected {COLUMNS} x {ROWS} cells {PITCH} pixels apart", path)
    return tuple(
        Shot(ImageView(f"{path.name}#{r:02d}-{c:02d}", view, partial(read_cell, path, r, c)), f"{r:02d}-{c:02d}")
        for r in range(ROWS)
        for c in range(COLUMNS)
    )


def read_cell(path: Path, row: int, column: int) -> Image:
    """The image (128, 128, 3) in one cell."""
    top, left = row * PITCH + BORDER, column * PITCH + BORDER
    return np.ascontiguousarray(_sheet(path)[top : top + SIDE, left : left + SIDE])


@lru_cache(maxsize=2)
def _sheet(path: Path) -> Image:
    """A decoded sheet; both are kept, because single cells cannot be decoded."""
    return read_rgb(path)

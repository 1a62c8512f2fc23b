"""Points as text: ``.xyz``, ``.txt``, ``.asc``, ``.pts`` and ``.csv``, a point a line, x y z first."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.errors import DatasetError, quoted
from relocbench.files import lines_of, read_text


def read_text_points(path: Path, most_bytes: int) -> Array:
    """The first three numbers of each line, (N, 3).

    Commas, semicolons, tabs or spaces part the numbers, and ``#`` or ``//`` begin a comment. A first line of words, or
    of a single number of points, is left out.

    Raises:
        DatasetError: with file and line: a line does not begin with three numbers.
    """
    text = read_text(path, "points as text (x y z a line)", DatasetError, most_bytes)
    rows: list[tuple[float, float, float]] = []
    for number, line in enumerate(lines_of(text), start=1):
        words = line.split("#", 1)[0].split("//", 1)[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            x, y, z = (float(word) for word in words[:3])
        except ValueError:
            if not rows and (len(words) == 1 or not _is_number(words[0])):
                continue
            raise DatasetError(f"expected x y z, found {quoted(line.strip(), 60)}", path, number) from None
        rows.append((x, y, z))
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True

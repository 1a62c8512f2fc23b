#!/usr/bin/env python3
"""Pass on what the demo prints, and fail where it is not what README shows.

    relocbench demo --out FOLDER | tools/compare_demo.py

Each share may differ by two queries from that in docs/images/demo.txt, since processors differ in the last digits.
"""

from __future__ import annotations

import sys
from pathlib import Path

_SHOWN = Path(__file__).resolve().parents[1] / "docs" / "images" / "demo.txt"
_QUERIES = 48  # of each condition
_MOST = 2  # by so many may two processors differ


def main() -> None:
    printed = sys.stdin.read()
    print(printed, end="")
    shown, got = _shares(_SHOWN.read_text(encoding="utf-8")), _shares(printed)
    if not got:
        sys.exit("the demo printed no shares")
    for method, shares in got.items():
        if any(abs(_found(a) - _found(b)) > _MOST for a, b in zip(shares, shown[method], strict=True)):
            sys.exit(f"{method}: {_SHOWN.name} shows {shown[method]}; make it and demo.png again by running the demo")


def _found(share: float) -> int:
    """The queries that are meant by a share printed with one decimal: 45.8 and 50.0 are 22 and 24."""
    return round(share * _QUERIES / 100)


def _shares(text: str) -> dict[str, list[float]]:
    """The last four cells of each row of the table, in percent, by method."""
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in text.splitlines() if line[:1] == "│"]
    return {cells[0]: [float(share) for share in cells[-4:]] for cells in rows}


if __name__ == "__main__":
    main()

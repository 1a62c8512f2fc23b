"""The headings of numbers: one name for a number wherever it is printed.

The name is that of the column in CSV, which says the unit (``median_translation_error_m``). In CSV shares are 0 to 1;
on pages and on the terminal they are in percent, and their heading says so: ``coverage, %``. Two numbers in one cell
have both names: ``median_seconds / p95_seconds``. Pages call the columns ``failed`` and ``broke`` of CSV by what they
count: ``declined / crashed``.
"""

from __future__ import annotations

METHOD, RANK = "method", "rank"
SECONDS = "median_seconds"
SECONDS_AND_P95 = "median_seconds / p95_seconds"
COUNTS = "declined / crashed"
RESCORED = "rescored"
RETRIEVER, TRACKER, TOP = "retriever", "tracker", "top"
BASIN = "basin_m / basin_deg"
ELSEWHERE = ("elsewhere", "elsewhere_answered", "elsewhere_confident", "elsewhere_confident_high")
"""the columns about pairs of different places"""


def heading(name: str, unit: str = "share") -> str:
    """The heading of a column of CSV where shares are shown in percent."""
    return f"{name}, %" if unit == "share" else name

"""The common parts of all figures: colours, and writing them with the same bytes on every machine."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from matplotlib.figure import Figure

from relocbench.files import write_bytes
from relocbench.pages.figures import png_of

# Okabe and Ito, "Color Universal Design" (2008).
REFERENCE, QUERY, ACCEPTED = "#0072B2", "#D55E00", "#009E73"
REASONS = ("#CC3311", "#AA3377", "#E69F00", "#666666", "#882255", "#999933", "#000000")
AXES = ("#0072B2", "#009E73", "#CC79A7")
"""along, across, height"""


def reason_colours(kinds: Iterable[str]) -> dict[str, str]:
    """kind of rejection -> colour, in the order of the kinds."""
    return {kind: REASONS[k % len(REASONS)] for k, kind in enumerate(kinds)}


def write_figure(path: Path, size: tuple[float, float], draw: Callable[[Figure], None]) -> None:
    """Write a PNG of ``size`` inches."""
    write_bytes(path, png_of(size, draw, dpi=120, spines=False))


def shortened(text: str, length: int = 90) -> str:
    """The text cut to ``length`` characters, for a title or a legend."""
    return text if len(text) <= length else text[: length - 1].rstrip() + "…"

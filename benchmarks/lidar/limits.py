"""Limits of the figures that a proof prints: each one outside is named, and the proof ends with exit code 1."""

from __future__ import annotations

import sys
from math import inf


class Limits:
    """What was expected of figures and does not hold."""

    def __init__(self) -> None:
        self.broken: list[str] = []

    def expect(self, name: str, value: float, least: float = -inf, most: float = inf) -> None:
        """Remember the figure if it is outside of its limits, or not a number."""
        if not least <= value <= most:
            self.broken.append(f"{name}: {value:.4g}, expected {least:g} to {most:g}")

    def end(self) -> None:
        """Print what does not hold to standard error, and exit with code 1 if there is any."""
        for line in self.broken:
            print(line, file=sys.stderr)
        sys.exit(bool(self.broken))

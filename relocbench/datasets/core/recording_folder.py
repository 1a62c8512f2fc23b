"""A folder of recordings: what a command that records drives leaves behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class RecordedDrive:
    """One drive."""

    name: str
    """of the traversal or sequence, in the layout's words"""
    folder: str
    """its images and scans, from the folder of recordings on"""
    split: str
    condition: str
    route: str
    traversal: int
    """among the drives of the same split, condition and route"""
    images: int
    scans: int
    length_m: float
    """driven while recording"""


@dataclass(frozen=True)
class RecordingFolder:
    """Drives in one layout."""

    root: Path
    layout: str
    drives: Sequence[RecordedDrive]

    def to_dict(self) -> dict[str, Any]:
        return {
            "recording": str(self.root),
            "layout": self.layout,
            "drives": [asdict(drive) for drive in self.drives],
        }

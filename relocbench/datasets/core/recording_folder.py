"""A folder of simulated recordings, as ``build-dataset synthetic --recording`` makes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class RecordedDrive:
    """One recorded drive; its fields are the columns of ``drives.csv``."""

    name: str
    """name of the traversal (RobotCar) or sequence (KITTI)"""
    folder: str
    """folder of its images and scans, relative to the folder of recordings"""
    split: str
    condition: str
    route: str
    traversal: int
    """number among the drives of the same split, condition and route"""
    images: int
    scans: int
    length_m: float
    """length driven while recording"""


@dataclass(frozen=True)
class RecordingFolder:
    """Recorded drives, all in one layout."""

    root: Path
    layout: str
    drives: Sequence[RecordedDrive]

    def to_dict(self) -> dict[str, Any]:
        return {"recording": str(self.root), "layout": self.layout, "drives": [asdict(drive) for drive in self.drives]}

"""How bags are read: what the options of the command say, the same for all drives."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from relocbench.datasets.importers.rosbag.extrinsics import Extrinsics
from relocbench.datasets.importers.rosbag.packets import PacketReading
from relocbench.datasets.importers.rosbag.point_times import PointTimes
from relocbench.datasets.importers.rosbag.roles import Wanted
from relocbench.datasets.importers.rosbag.stamps import Stamps

Pattern = Literal["auto", "spinning", "push-broom"]
ScanMotion = Literal["auto", "compensated", "distorted"]


@dataclass(frozen=True)
class BagSettings:
    """How bags are read."""

    wanted: Wanted = field(default_factory=Wanted)
    base_frame: str = ""
    """empty: it is guessed"""
    extrinsics: Extrinsics = field(default_factory=Extrinsics)
    extrinsics_file: Path | None = None
    packets: PacketReading = field(default_factory=PacketReading)
    point_times: PointTimes | None = None
    """None: they are told from the values"""
    motion: ScanMotion = "auto"
    pattern: Pattern = "auto"
    min_range_m: float = 0.5
    max_range_m: float = 100.0
    sigma_m: float = 0.03
    stamps: Stamps = "header"
    max_gap_ns: int = 1_000_000_000

"""Two sequences along the fenced street in the layout of KITTI odometry, recorded once for all tests."""

from __future__ import annotations

from pathlib import Path

from built_once import built_once
from fenced_street import record_fenced

FRAMES = 26


@built_once(Path)
def record_kitti_street(out: Path) -> None:
    """Record sequences 00 and 01 below ``out``."""
    for number in range(2):
        record_fenced(out, "kitti", frames=FRAMES, scale=0.15, rings=16, azimuths=360, number=number)

"""Two sequences along the fenced street in the layout of KITTI odometry, recorded once for all tests."""

from __future__ import annotations

from pathlib import Path

from built_once import built_once
from fenced_street import fenced_street_mesh
from small_street import SolidTexture, StraightRoad, Street

from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs.recording import record

FRAMES = 26


@built_once(Path)
def record_kitti_street(out: Path) -> None:
    """Record sequences 00 and 01 below ``out``."""
    for number in range(2):
        record(
            Street(), StraightRoad(), Factors(), out, "kitti", frames=FRAMES, scale=0.15, rings=16, azimuths=360,
            number=number, renderer_factory=SolidTexture, compose=fenced_street_mesh,
        )  # fmt: skip

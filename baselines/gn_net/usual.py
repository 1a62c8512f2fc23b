"""The defaults of each method of GN-Net: how it searches, and what it is trained for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from baselines.gn_net.start import StartSettings


@dataclass(frozen=True)
class Usual:
    """The parameters that have other defaults in other methods; :class:`~baselines.gn_net.tracker.GnNet` tells what
    each does."""

    matched_start: bool = True
    min_agreement: float = 0.025
    damping: Literal["dso", "lm-reloc"] = "dso"
    landmarks: int = StartSettings.points
    hypotheses: int = 2
    coarse_points: int | None = 200
    iterations: tuple[int, ...] = (10, 20, 20, 10, 8)
    first_levels: int = 3
    along: tuple[float, ...] = (-10.0, -6.0, -2.0, 2.0, 6.0, 10.0)
    turns_deg: tuple[float, ...] = (-30.0, -15.0, 0.0, 15.0, 30.0)
    kept: tuple[int, ...] = (3, 3, 3, 5, 8)


ONE_START = Usual(
    hypotheses=1,
    coarse_points=None,
    iterations=(10, 20, 50, 50, 50),
    first_levels=1,
    along=(),
    turns_deg=(0.0,),
    kept=(),
)
"""alignment from the keyframe's pose itself, on all levels, as GN-Net describes it; beside the matched start"""

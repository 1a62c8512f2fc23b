"""The small street with walls aslant to the road, so that lidar tells the way along it as well as the way across.

Drives along it are recorded in the layout that a test needs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from small_street import SolidTexture, StraightRoad, Street, quads, street_mesh

from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs.recording import LayoutName, Recorded, record
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, merge


def fenced_street_mesh(street: Street, factors: Factors) -> Mesh:
    """Walls 2 to 3 m high between the road and the houses, turned by 30 to 60 degrees one way or the other."""
    rng = np.random.default_rng([street.seed, 1])
    corners = []
    for side in (-1.0, 1.0):
        x = -60.0
        while x < 220.0:
            x += rng.uniform(2.5, 4.5)
            angle = np.radians(rng.uniform(30, 60)) * rng.choice([-1.0, 1.0])
            half = rng.uniform(0.9, 1.2) * np.array([np.cos(angle), np.sin(angle)])
            a, b = np.array([x, side * 4.9]) - half, np.array([x, side * 4.9]) + half
            top = rng.uniform(2.0, 3.0)
            corners.append([(*a, 0.0), (*b, 0.0), (*b, top), (*a, top)])
    fences = quads(np.array(corners, dtype=np.float64), Material.PLASTER, 5000)
    return merge([street_mesh(street, factors), fences])


def record_fenced(
    out: Path, layout: LayoutName, factors: Factors | None = None, path: StraightRoad | None = None, **options: Any
) -> Recorded:
    """:func:`record` a drive along the street; drives of different numbers differ in all that is random."""
    return record(
        Street(), path or StraightRoad(), factors or Factors(), out, layout,
        renderer_factory=SolidTexture, compose=fenced_street_mesh, **options,
    )  # fmt: skip

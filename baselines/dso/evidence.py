"""Evidence for an answer of direct alignment: how alike keyframe and query look around each point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.alignment import Level, LevelPoints
from baselines.correlation import GreyImage, correlations
from relocbench.arrays import Array

ALIKE = 0.7
"""correlation from which a point counts as seen again"""


@dataclass(frozen=True)
class CorrelationEvidence:
    """What speaks for a pose; points out of view count as points that look different."""

    correlation: float
    """mean over all points of the correlation around them, -1 to 1"""
    seen_again: float
    """share of all points whose correlation is at least :data:`ALIKE`"""


def evidence_for(T_query_ref: Array, points: LevelPoints, reference: Level, query: Level) -> CorrelationEvidence:
    """The evidence for a pose from the points of one level of the keyframe."""
    depth = 1.0 / points.points[2].astype(np.float64)
    found = correlations(T_query_ref, points.uv.astype(np.float64), depth, _grey(reference), _grey(query))
    return CorrelationEvidence(float(np.mean(found)), float(np.mean(found >= ALIKE)))


def _grey(level: Level) -> GreyImage:
    return GreyImage(level.map[..., 0], level.camera)

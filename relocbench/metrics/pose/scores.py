"""What the metrics of a pair set are computed from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relocbench.arrays import Array, Indices, Mask
from relocbench.metrics.pose.errors import PoseErrors
from relocbench.metrics.pose.sequences import Drive
from relocbench.metrics.pose.tiers import MEASURES, looks, tiers

CORRECT: tuple[float, float] = (0.25, 2)
"""(metres, degrees) within which an answer counts as correct where confidence, stretches and runs are judged"""
FLOATS = (
    *("seconds", "confidence", "vcre", "travelled_m", "peak_memory_bytes"),
    *("overlap", "overlap_query", "scale_change", "angle_deg", "depth_error", "similarity"),
)
"""of floats, by their names in :class:`PairScores`"""


@dataclass(frozen=True, eq=False)
class PairScores:
    """The errors, times and confidences of all N pairs of one set, in the order of reference time."""

    errors: PoseErrors
    seconds: Array | None = None
    """(N,) wall-clock seconds of a pair, NaN where the method was not run; None if not measured at all"""
    confidence: Array | None = None
    """(N,) higher is more certain, NaN where not given; None if the method gives none"""
    vcre: Array | None = None
    """(N,) virtual correspondence reprojection errors as shares of the image's diagonal, inf without an answer; NaN
    or None where the camera is not known"""
    travelled_m: Array | None = None
    """(N,) metres that the queries' drive had travelled by then; NaN or None where that is not known"""
    overlap: Array | None = None
    """(N,) shares of the keyframes' pixels with depth that the queries see; NaN or None where not known"""
    scale_change: Array | None = None
    """(N,) median changes of scale of what they see, 1 or more; NaN or None where not known"""
    overlap_query: Array | None = None
    """(N,) shares of the queries' pixels with depth that the keyframes see; NaN or None where not known"""
    angle_deg: Array | None = None
    """(N,) angles between the cameras"""
    depth_error: Array | None = None
    """(N,) errors that the map states of the keyframes' depths, relative to them; NaN or None where it states none"""
    similarity: Array | None = None
    """(N,) correlations of patches of the two images, -1 to 1; NaN or None where not known"""
    peak_memory_bytes: Array | None = None
    """(N,) the most resident memory of the method's process until a pair was answered; NaN or None where not known"""
    query_ns: Indices | None = None
    """(N,) times of the queries; None where they are not those of a drive"""
    sets: tuple[int, ...] = ()
    """the number of pairs of each set, of which one follows the other; empty for a single one"""

    def __post_init__(self) -> None:
        for name in (*FLOATS, "query_ns"):
            given = getattr(self, name)
            if given is not None and np.shape(given) != (len(self.errors),):
                raise ValueError(f"{name} must be ({len(self.errors)},), got {np.shape(given)}")

    @classmethod
    def joined(cls, parts: Sequence[PairScores]) -> PairScores:
        """The pairs of several sets, one set after the other; a column that one of them lacks is NaN there."""
        times = [part.query_ns for part in parts if part.query_ns is not None]
        return cls(
            PoseErrors.joined([part.errors for part in parts]),
            **{name: np.concatenate([part.column(name) for part in parts]) for name in FLOATS},
            query_ns=np.concatenate(times) if len(times) == len(parts) else None,
            sets=tuple(len(part.errors) for part in parts),
        )

    @cached_property
    def correct(self) -> Mask:
        """(N,) whether both errors are within :data:`CORRECT`."""
        return within(self.errors, *CORRECT)

    @cached_property
    def drives(self) -> list[Drive] | None:
        """Where along each set's drive answers are right; None without times."""
        if self.query_ns is None:
            return None
        right, travelled = self.correct, self.column("travelled_m")
        ends = np.cumsum(self.sets or (len(self.errors),))
        return [
            Drive.of(right[end - count : end], self.query_ns[end - count : end], travelled[end - count : end])
            for end, count in zip(ends.tolist(), self.sets or (len(self.errors),), strict=True)
        ]

    @cached_property
    def tiers(self) -> Indices:
        """(N,) how hard each pair is, an index into :data:`TIERS`; -1 where that is not known."""
        return tiers(*map(self.column, MEASURES))

    @cached_property
    def looks(self) -> Indices:
        """(N,) how alike the images of each pair look, an index into :data:`LOOKS`; -1 where that is not known."""
        return looks(self.column("similarity"))

    def column(self, name: str) -> Array:
        """(N,) a column of floats by its name; NaN where it is not given."""
        known: Array | None = getattr(self, name)
        return np.full(len(self.errors), np.nan) if known is None else known


def within(errors: PoseErrors, metres: float, degrees: float) -> Mask:
    """(N,) whether both errors are at most their thresholds."""
    return (errors.translation_error_m <= metres) & (errors.rotation_error_deg <= degrees)

"""Whether the images of a drive and its poses share a clock, by all methods that must agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Literal

import numpy as np

from relocbench.datasets.clock.evidence import Evidence, Work, gather
from relocbench.datasets.clock.offset import (
    CameraMotion,
    Estimate,
    Residual,
    estimate_by_rotation,
    estimate_by_tracks,
    image_motions,
    residual_at,
)
from relocbench.datasets.core.schema import ClockEntry
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.sensors.recording import Trajectory

Verdict = Literal["one clock", "offset", "contradiction", "cannot tell"]

_MOST_SIGMA_S = 0.01
"""of an estimate that tells something"""
_AGREEMENT = 3.5
"""standard deviations by which two methods may differ, beside a millisecond"""
_ALLOWANCE_S = 0.001
_LEAST_S = 0.002
"""an offset of less is none: exposures take as long"""
_SURE = 0.9995
"""probability of Student's distribution up to an offset that counts"""
_LEAST_READOUT_S = 0.005
"""a readout of less is none"""
_LONGEST = 200
"""characters of a line in a traversal's description"""
ROUNDED_S = 0.001
"""offsets are applied in whole milliseconds, so that every processor gives the same poses"""


@dataclass(frozen=True)
class ClockCheck:
    """What the images of a camera say of the clock of the poses: an image at t has the pose at t + offset."""

    camera: str
    verdict: Verdict
    offset_s: float
    """NaN where nothing can be told"""
    sigma_s: float
    readout_s: float
    """time from the first row of an image to the last; 0 where none was found"""
    readout_sigma_s: float
    estimates: tuple[Estimate, ...]
    residual: Residual | None
    """between the motion of the images, as a pinhole camera sees it, and that of the poses, as they stand"""
    residual_at_offset: Residual | None
    """with the offset, and freed of the readout: no clock explains it"""
    pinhole_offset_s: float = np.nan
    """what rotations would say if all rows were read at once; NaN where they tell nothing"""
    why: str = field(default="", compare=False)
    """why nothing can be told, or what contradicts"""

    @property
    def words(self) -> str:
        """The finding in one line."""
        if self.verdict == "cannot tell":
            return f"whether images of {self.camera} and poses share a clock cannot be told: {self.why}"
        methods = _methods(self.estimates)
        if self.verdict == "contradiction":
            return f"images of {self.camera} and poses contradict each other whatever their clocks ({methods})"
        found = f"{_ms(self.offset_s)} ± {_ms(self.sigma_s, False)} ms ({methods})"
        text = (
            f"images of {self.camera} and poses share a clock: offset {found}"
            if self.verdict == "one clock"
            else f"an image of {self.camera} at t has the pose at t + offset, {found}"
        )
        return text + (f"; rows are read over {1000 * self.readout_s:.1f} ms" if self.readout_s else "")

    @property
    def left(self) -> str:
        """By how much images and poses differ whatever the clock, in words; empty where nothing was measured."""
        if self.residual is None or self.residual_at_offset is None:
            return ""
        return (
            f"motion between images differs from that of the poses by {_size(self.residual_at_offset)} in the median"
            + (f" with the offset, by {_size(self.residual)} without" if self.verdict == "offset" else "")
        )

    @property
    def correction_s(self) -> float:
        """The offset to apply: none unless one was found, else that in whole milliseconds."""
        return round(self.offset_s / ROUNDED_S) * ROUNDED_S if self.verdict == "offset" else 0.0

    def entry(self, applied_s: float) -> ClockEntry:
        """The record of the finding, and of what was applied."""
        known = self.verdict in ("one clock", "offset")
        return ClockEntry(
            applied_s=applied_s,
            verdict=self.verdict,
            offset_s=round(self.offset_s, 4) if known else None,
            sigma_s=round(self.sigma_s, 4) if known else None,
            readout_s=round(self.readout_s, 3) if known and self.readout_s else None,
            how=(self.why or _methods(self.estimates))[:_LONGEST],
        )


def check_clock(traversal: Traversal, camera: str, trajectory: Trajectory, work: Work) -> ClockCheck:
    """Estimate the offset between the images of a camera and the poses of a trajectory of the rig.

    Args:
        traversal: of a dataset, with its images and depth; its own poses are not used.

    Raises:
        DatasetError: an image or a depth image is damaged.
    """
    evidence = gather(traversal, camera, trajectory, work)
    return _unknown(camera, evidence) if isinstance(evidence, str) else judge(evidence, trajectory)


def judge(evidence: Evidence, trajectory: Trajectory) -> ClockCheck:
    """The verdict of all methods on the clock of a trajectory of the rig."""
    from scipy.stats import t

    camera, tracks, fx, parts = evidence.camera, evidence.tracks, evidence.fx, evidence.parts
    motion = CameraMotion.of(trajectory, evidence.T_rig_cam, evidence.times_ns)
    by_tracks = [estimate_by_tracks(method, tracks, motion, fx, parts) for method in ("lines", "points")]
    told = [one for one in by_tracks if one is not None]
    if not told:
        return _unknown(camera, f"{len(tracks)} pairs of images have enough in common, or an offset is beyond 100 ms")
    best = min(told, key=lambda one: one.sigma_s)
    tried = best.readout_s if abs(best.readout_s) >= _LEAST_READOUT_S else _LEAST_READOUT_S
    plain = image_motions(tracks, motion, fx, 0.0, 0.0)
    freed = image_motions(tracks, motion, fx, best.offset_s, tried)
    ends = [estimate_by_rotation(motions, motion, fx, parts) for motions in (plain, freed)]
    every = tuple(told)
    if ends[0] is not None and ends[1] is not None:
        every = (*told, _freed_of_readout(ends[0], ends[1], tried, best))
    readout = best.readout_s if tried == best.readout_s and abs(tried) > 3 * best.readout_sigma_s else 0.0
    estimates = tuple(one for one in every if one.sigma_s <= _MOST_SIGMA_S)
    before = residual_at(plain, motion, 0.0)
    if len(estimates) < 2:
        return _unknown(camera, f"the motion tells the offset too vaguely ({_methods(every)})", before, every)
    offset, sigma = combined(estimates)
    if sigma > _MOST_SIGMA_S:
        return _unknown(camera, f"the motion tells the offset too vaguely ({_methods(estimates)})", before, estimates)
    clash = [(a, b) for a, b in combinations(estimates, 2) if not _agree(a, b)]
    verdict: Verdict = "contradiction" if clash else "one clock"
    limit = float(t.ppf(_SURE, best.freedom)) * sigma
    if not clash and abs(offset) > limit and abs(offset) >= _LEAST_S:
        verdict = "offset"
    after = residual_at(freed if readout else plain, motion, offset if verdict == "offset" else 0.0)
    spread, pinhole = best.readout_sigma_s if readout else 0.0, np.nan if ends[0] is None else ends[0].offset_s
    return ClockCheck(camera, verdict, offset, sigma, readout, spread, estimates, before, after, pinhole)


def _freed_of_readout(plain: Estimate, freed: Estimate, tried_s: float, best: Estimate) -> Estimate:
    """The offset by rotations at the readout that another method found, in proportion to what a readout changes."""
    slope = (freed.offset_s - plain.offset_s) / tried_s
    sigma = math.hypot(max(plain.sigma_s, freed.sigma_s), slope * best.readout_sigma_s)
    return replace(freed, offset_s=plain.offset_s + slope * best.readout_s, sigma_s=sigma)


def combined(estimates: Sequence[Estimate]) -> tuple[float, float]:
    """The mean of estimates by their variances, and its standard deviation.

    That is the best one's own, since all methods share the images, and larger where they differ by more than theirs.
    """
    values, sigmas = (np.array([getattr(e, name) for e in estimates]) for name in ("offset_s", "sigma_s"))
    weights = 1.0 / sigmas**2
    mean = float(np.sum(weights * values) / np.sum(weights))
    chi2 = float(np.sum(weights * (values - mean) ** 2)) / max(len(values) - 1, 1)
    return mean, float(np.min(sigmas)) * max(1.0, float(np.sqrt(chi2)))


def _agree(a: Estimate, b: Estimate) -> bool:
    return abs(a.offset_s - b.offset_s) <= _AGREEMENT * math.hypot(a.sigma_s, b.sigma_s) + _ALLOWANCE_S


def _unknown(
    camera: str, why: str, residual: Residual | None = None, estimates: tuple[Estimate, ...] = ()
) -> ClockCheck:
    return ClockCheck(camera, "cannot tell", np.nan, np.nan, 0.0, 0.0, estimates, residual, residual, why=why)


def _methods(estimates: Sequence[Estimate]) -> str:
    """What each method says, in words."""
    return ", ".join(f"{e.method} {_ms(e.offset_s)} ± {_ms(e.sigma_s, False)} ms" for e in estimates)


def _ms(seconds: float, signed: bool = True) -> str:
    return f"{seconds * 1000:+.1f}" if signed else f"{abs(seconds) * 1000:.1f}"


def _size(residual: Residual) -> str:
    return f"{residual.deg:.2f} deg" + (f" and {residual.mm:.1f} mm" if np.isfinite(residual.mm) else "")

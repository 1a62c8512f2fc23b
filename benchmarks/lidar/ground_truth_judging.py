"""Evaluation of pairs against the exact truth for ``ground_truth.py``: errors, calibration and tables."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from ground_truth_drives import T_RIG_CAM, Taken

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.files import atomic_write
from relocbench.geometry import invert, rotation_angle, se3_log

WRONG_M, WRONG_DEG = 0.3, 1.0
_NEAR_LIMIT_M, _NEAR_LIMIT_DEG = 0.05, 0.5
"""pairs this close to a limit count neither as overlapping nor as elsewhere"""


@dataclass(frozen=True)
class Judged:
    """One pair."""

    query: str
    """title of the query's drive"""
    ref_ns: int
    query_ns: int
    distance_m: float
    """true distance to the nearest keyframe that looks in about the same direction; inf if none does"""
    kind: str
    """overlapping, elsewhere, or borderline"""
    accepted: bool
    reason: str
    error_m: float
    """distance of the true and the stated position of the query camera; nan if none is stated"""
    error_deg: float
    along_m: float
    """the same along the axes of the query rig"""
    across_m: float
    height_m: float
    sigma_along_m: float
    normalised: float
    """e^T C^-1 e / 6"""
    way_m: float
    """distance along the query's drive"""
    to_end_m: float
    """distance to the nearer end of the drive"""
    turn_deg: float
    """angle by which the road turns over 10 m to both sides"""

    @property
    def wrong(self) -> bool:
        return self.error_m > WRONG_M or self.error_deg > WRONG_DEG


class Exact:
    """The truth about the images of two drives."""

    def __init__(self, reference: Taken, query: Taken, max_distance_m: float, max_angle_deg: float) -> None:
        self.reference, self.query = reference, query
        self._limits = max_distance_m, max_angle_deg
        self._T_world_refcam = reference.truth.at(np.array(reference.image_ns)) @ T_RIG_CAM
        times = query.truth.times_ns
        steps = np.linalg.norm(np.diff(query.truth.T_world_rig[:, :3, 3], axis=0), axis=1)
        self._seconds, self._way = (times - times[0]) / 1e9, np.concatenate([[0.0], np.cumsum(steps)])
        forward = query.truth.T_world_rig[:, :2, 0]
        self._heading = np.degrees(np.unwrap(np.arctan2(forward[:, 1], forward[:, 0])))

    def T_query_ref(self, ref_ns: int, query_ns: int) -> Array:
        """(4, 4) camera to camera."""
        T_world_ref = self.reference.truth.at(np.array([ref_ns]))[0] @ T_RIG_CAM
        T_world_query = self.query.truth.at(np.array([query_ns]))[0] @ T_RIG_CAM
        return np.asarray(invert(T_world_query) @ T_world_ref)

    def overlap(self, query_ns: int) -> tuple[float, str, int]:
        """Distance and time of the nearest keyframe that looks in about the same direction, and the kind of pair."""
        most_m, most_deg = self._limits
        T = self.query.truth.at(np.array([query_ns]))[0] @ T_RIG_CAM
        apart = np.linalg.norm(self._T_world_refcam[:, :3, 3] - T[:3, 3], axis=1)
        turned = np.degrees(rotation_angle(np.swapaxes(self._T_world_refcam[:, :3, :3], -1, -2) @ T[:3, :3]))

        def nearest(slack_m: float, slack_deg: float) -> bool:
            return bool(((apart <= most_m + slack_m) & (turned <= most_deg + slack_deg)).any())

        fit = np.where(turned <= most_deg, apart, np.inf)
        surely = nearest(-_NEAR_LIMIT_M, -_NEAR_LIMIT_DEG)
        perhaps = nearest(_NEAR_LIMIT_M, _NEAR_LIMIT_DEG)
        kind = "overlapping" if surely else "borderline" if perhaps else "elsewhere"
        return float(fit.min()), kind, self.reference.image_ns[int(np.argmin(fit))]

    def judge(self, outcome: PairOutcome) -> Judged:
        """Evaluate one answer of the builder."""
        ref_ns, query_ns = outcome.ref_timestamp_ns, outcome.query_timestamp_ns
        distance, kind, _ = self.overlap(query_ns)
        metres = degrees = normalised = float("nan")
        axes = np.full(3, np.nan)
        if outcome.T_query_ref is not None:
            metres, degrees, axes, xi = errors(outcome.T_query_ref, self.T_query_ref(ref_ns, query_ns))
            if outcome.covariance is not None:
                normalised = float(xi @ np.linalg.solve(outcome.covariance, xi) / 6)
        way = self._way_at(query_ns)
        return Judged(
            self.query.leg.title, ref_ns, query_ns, distance, kind, outcome.accepted, outcome.reason,
            metres, degrees, *axes.tolist(),
            outcome.sigma_along_m if outcome.sigma_along_m is not None else float("nan"), normalised,
            way, min(way, float(self._way[-1]) - way), self._turn(way),
        )  # fmt: skip

    def _way_at(self, time_ns: int) -> float:
        return float(np.interp((time_ns - self.query.truth.times_ns[0]) / 1e9, self._seconds, self._way))

    def _turn(self, way_m: float) -> float:
        before, after = np.interp([way_m - 10, way_m + 10], self._way, self._heading)
        return float(abs(after - before))


def errors(T_query_ref: Array, true: Array) -> tuple[float, float, Array, Array]:
    """The error in metres and degrees, that of the query camera along the query rig's axes, and as a twist xi."""
    E = T_query_ref @ invert(true)  # from the true to the stated query camera
    xi = se3_log(E)  # the truth is T_ref_query_said @ se3_exp(xi)
    degrees = float(np.degrees(rotation_angle(E[:3, :3])))
    off = T_RIG_CAM[:3, :3] @ invert(E)[:3, 3]
    return float(np.linalg.norm(off)), degrees, off, np.asarray(xi)


def figures(rows: Sequence[Judged]) -> dict[str, float]:
    """The statistics of a set of pairs; shares are in percent, and nan if there are no pairs."""
    overlapping = [r for r in rows if r.kind == "overlapping"]
    elsewhere = [r for r in rows if r.kind == "elsewhere"]
    accepted = [r for r in rows if r.accepted]
    m = np.array([r.error_m for r in accepted] or [np.nan])
    deg = np.array([r.error_deg for r in accepted] or [np.nan])
    known = [r.normalised for r in accepted if np.isfinite(r.normalised)]
    return {
        "pairs": len(rows),
        "overlapping": len(overlapping),
        "accepted": len(accepted),
        "accepted_of_overlapping": _percent(sum(r.accepted for r in overlapping), len(overlapping)),
        "elsewhere": len(elsewhere),
        "rejected_of_elsewhere": _percent(sum(not r.accepted for r in elsewhere), len(elsewhere)),
        "median_m": float(np.median(m)),
        "median_deg": float(np.median(deg)),
        "p95_m": float(np.percentile(m, 95)),
        "p95_deg": float(np.percentile(deg, 95)),
        "max_m": float(m.max()),
        "max_deg": float(deg.max()),
        "wrong": sum(r.wrong for r in accepted),
        "normalised": float(np.mean(known)) if known else float("nan"),
    }


def _percent(part: int, whole: int) -> float:
    return 100 * part / whole if whole else float("nan")


_HEAD = (
    "pairs", "overlapping", "accepted of these", "elsewhere", "rejected of these", "median", "95 %", "largest",
    "wrong", "normalised error squared",
)  # fmt: skip


def table(first: str, groups: Iterable[tuple[str, dict[str, float]]]) -> str:
    """The statistics as a Markdown table."""
    lines = [f"| {first} | " + " | ".join(_HEAD) + " |", "|---" * (len(_HEAD) + 1) + "|"]
    for name, f in groups:
        cells = [
            name, f"{f['pairs']:.0f}", f"{f['overlapping']:.0f}", _told(f["accepted_of_overlapping"], "{:.1f} %"),
            f"{f['elsewhere']:.0f}", _told(f["rejected_of_elsewhere"], "{:.1f} %"),
            *(
                _told(f[f"{which}_m"], "{:.3f} m") + ", " + _told(f[f"{which}_deg"], "{:.3f} deg")
                for which in ("median", "p95", "max")
            ),
            f"{f['wrong']:.0f}", _told(f["normalised"], "{:.2f}"),
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _told(value: float, form: str) -> str:
    return form.format(value) if np.isfinite(value) else "-"


def reasons(rows: Sequence[Judged]) -> str:
    """The reasons for rejections as a Markdown table, without the numbers in them."""
    lines = ["| rejected because | overlapping | elsewhere | borderline |", "|---|---|---|---|"]
    kinds = ("overlapping", "elsewhere", "borderline")
    counted = {kind: Counter(_plain(r.reason) for r in rows if not r.accepted and r.kind == kind) for kind in kinds}
    total: Counter[str] = sum(counted.values(), Counter())
    for reason, _ in total.most_common():
        lines.append(f"| {reason} | " + " | ".join(str(counted[kind][reason]) for kind in kinds) + " |")
    return "\n".join(lines)


def _plain(reason: str) -> str:
    return re.sub(r"\d+(\.\d+)?", "#", reason)


def worst(rows: Sequence[Judged], count: int = 12) -> str:
    """The accepted pairs with the largest errors as a Markdown table, at most one in 10 m of road."""
    lines = [
        "| drive | at | to nearer end | road turns | error | along | across | height | sigma along | rotation | nes |",
        "|---" * 11 + "|",
    ]
    told: list[Judged] = []
    for r in sorted((r for r in rows if r.accepted), key=lambda r: -r.error_m):
        if len(told) == count or any(r.query == t.query and abs(r.way_m - t.way_m) < 10 for t in told):
            continue
        told.append(r)
        lines.append(
            f"| {r.query} | {r.way_m:.0f} m | {r.to_end_m:.0f} m | {r.turn_deg:.0f} deg | {r.error_m:.3f} m | "
            f"{r.along_m:+.3f} | {r.across_m:+.3f} | {r.height_m:+.3f} | {r.sigma_along_m:.3f} | "
            f"{r.error_deg:.3f} deg | {r.normalised:.1f} |"
        )
    return "\n".join(lines)


def write_rows(path: Path, rows: Sequence[Judged]) -> None:
    """All pairs as a table."""
    with atomic_write(path) as stream:
        out = csv.DictWriter(stream, [f.name for f in fields(Judged)], lineterminator="\n")
        out.writeheader()
        out.writerows(asdict(row) for row in rows)

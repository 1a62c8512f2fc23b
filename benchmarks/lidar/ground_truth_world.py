"""The drives of ``ground_truth.py`` and their blocks, which its parts share."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ground_truth_drives import Spoken, Taken
from ground_truth_judging import Exact, Judged
from ground_truth_work import CutUnit, DecideUnit, RegisterUnit, Spent, cut, unverified

from relocbench.arrays import Array
from relocbench.datasets.core import build
from relocbench.datasets.groundtruth.alignment.two_drives import RegistrationUnit
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.execution import Run
from relocbench.geometry import invert, rotation_angle

DrivePair = tuple[int, int]
"""indices of the reference's and the query's drive"""

OPTIONS = FieldOptions()
"""the builder's defaults"""


class World:
    """The drives of one split, whose blocks and registrations are made when they are needed."""

    def __init__(self, taken: dict[int, Taken], work: Path, workers: int, spoken: Spoken) -> None:
        self.taken, self.work, self.workers, self.spoken = taken, work, workers, spoken
        units = [CutUnit(t.recording, work / "blocks" / t.recording.name, OPTIONS.alignment) for t in taken.values()]
        made: list[tuple[Drive, Spent]] = self.all_of(cut, units, "drives to cut")
        self.drives = {number: drive for number, (drive, _) in zip(taken, made, strict=True)}
        self.cut_spent = {number: spent for number, (_, spent) in zip(taken, made, strict=True)}

    def all_of(self, function: Any, units: Sequence[Any], title: str) -> list[Any]:
        """Results in the order of the units."""
        return build.work(title, function, units, Run(self.workers), self.spoken)

    def exact(self, ref: int, query: int) -> Exact:
        return Exact(self.taken[ref], self.taken[query], OPTIONS.max_distance, OPTIONS.max_angle)

    def register_unit(self, ref: int, query: int, verified: bool = True) -> RegisterUnit:
        options = OPTIONS.alignment if verified else unverified(OPTIONS.alignment)
        folder = self.work / ("registrations" if verified else "registrations-unverified")
        a, b = self.drives[ref], self.drives[query]
        return RegisterUnit(RegistrationUnit(a, b, options), folder / f"{a.name}__{b.name}.csv")

    def decide_unit(self, ref: int, query: int, registrations: tuple[Registration, ...]) -> DecideUnit:
        times = self.taken[ref].image_ns, self.taken[query].image_ns
        return DecideUnit(
            self.drives[ref], self.drives[query], registrations, *times,
            OPTIONS.alignment, OPTIONS.limits_at(1.0), OPTIONS.max_angle,
        )  # fmt: skip

    def true_pose(self, ref: int, query: int, ref_ns: int, query_ns: int) -> Array:
        """(4, 4) ``T_ref_query``, rig to rig."""
        T = [self.taken[n].truth.at(np.array([t]))[0] for n, t in ((ref, ref_ns), (query, query_ns))]
        return np.asarray(invert(T[0]) @ T[1])

    def node_pairs(self, ref: int, query: int, count: int) -> list[tuple[int, int]]:
        """Overlapping (reference node, query node), evenly along the query's drive; the reference is the nearest."""
        exact, nodes = self.exact(ref, query), self.drives[query].nodes
        there = self.taken[ref].truth.at(self.drives[ref].nodes.times_ns)[:, :3, 3]
        good = [q for q, t in enumerate(nodes.times_ns.tolist()) if exact.overlap(t)[1] == "overlapping"]
        chosen = [good[i] for i in np.linspace(0, len(good) - 1, min(count + 2, len(good))).astype(int)[1:-1]]
        here = self.taken[query].truth.at(nodes.times_ns[chosen])[:, :3, 3]
        return [(int(np.argmin(np.linalg.norm(there - p, axis=1))), q) for p, q in zip(here, chosen, strict=True)]


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def judge(world: World, pair: DrivePair, outcomes: Sequence[PairOutcome]) -> list[Judged]:
    exact = world.exact(*pair)
    return [exact.judge(outcome) for outcome in outcomes]


def apart(T: Array, true: Array) -> tuple[float, float]:
    """Translation error in metres and rotation error in degrees."""
    E = invert(true) @ T
    return float(np.linalg.norm(E[:3, 3])), float(np.degrees(rotation_angle(E[:3, :3])))


def rounded(values: dict[str, float]) -> dict[str, float | None]:
    return {k: round(v, 4) if np.isfinite(v) else None for k, v in values.items()}

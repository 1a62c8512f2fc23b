"""Distribution of the images and scans of drives to workers, with an estimate of the time."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs import estimates
from relocbench.datasets.synthetic.jobs.estimates import Spent
from relocbench.datasets.synthetic.jobs.recording_work import (
    Composer,
    DriveContext,
    RecordableDistrict,
    RendererFactory,
    Unit,
    shared,
    town_compose,
    town_renderer,
    write_images,
    write_scans,
)
from relocbench.execution import Run, chunks
from relocbench.progress import Reporter

_IMAGES_A_UNIT = 8
_SCANS_A_UNIT = 64
_WORTH_AN_ESTIMATE = 400
"""images; fewer take too little time for an estimate"""

Files = Sequence[tuple[str, int]]
"""(sensor, index) of each"""


@dataclass(frozen=True, eq=False)
class DriveJob:
    """The missing images and scans of a drive."""

    district: RecordableDistrict
    drive: DriveContext
    truth: Path
    scans: Files
    pictures: Files


def carry_out(
    jobs: Sequence[DriveJob],
    reporter: Reporter,
    run: Run,
    renderer_factory: RendererFactory = town_renderer,
    compose: Composer = town_compose,
) -> None:
    """Scan and render what is missing, drive by drive; a long job is first timed on a few files.

    Args:
        renderer_factory, compose: replacements for the town's own; they must be importable by workers.
    """
    jobs = [job for job in jobs if job.scans or job.pictures]
    with ExitStack() as stack:
        pickled: dict[int, Path] = {}
        for job in jobs:
            if id(job.district) not in pickled:
                pickled[id(job.district)] = stack.enter_context(shared(job.district, job.truth))
        drives = [
            replace(job.drive, district=pickled[id(job.district)], make_renderer=renderer_factory, compose=compose)
            for job in jobs
        ]
        both = list(zip(drives, jobs, strict=True))
        scans = [Unit(drive, part) for drive, job in both for part in chunks(job.scans, _SCANS_A_UNIT)]
        pictures = [Unit(drive, part) for drive, job in both for part in chunks(job.pictures, _IMAGES_A_UNIT)]
        if _count(pictures) >= _WORTH_AN_ESTIMATE:
            scans, pictures = _measured(scans, pictures, reporter, run)
        for what, work, units in (("scanning", write_scans, scans), ("rendering", write_images, pictures)):
            if units:
                with reporter.stage(what, _count(units)) as advance:
                    estimates.carried_out(work, units, advance, run)


def _count(units: Sequence[Unit]) -> int:
    return sum(len(unit.work) for unit in units)


def _measured(
    scans: Sequence[Unit], pictures: Sequence[Unit], reporter: Reporter, run: Run
) -> tuple[list[Unit], list[Unit]]:
    """Run the first unit of each kind and condition, report an estimate for the others, and return these."""
    lines, left = [], []
    pilots = {what: estimates.split_pilots(units, _scene) for what, units in (("scans", scans), ("images", pictures))}
    with reporter.stage("measuring", sum(_count(first) for first, _ in pilots.values())) as advance:
        for what, work in (("scans", write_scans), ("images", write_images)):
            first, rest = pilots[what]
            lines.append(estimate(what, estimates.carried_out(work, first, advance, run), rest, run.workers))
            left.append(rest)
    reporter.note("still to record: " + "; ".join(lines))
    return left[0], left[1]


def estimate(what: str, spent: Sequence[Spent], rest: Sequence[Unit], workers: int) -> str:
    """Time and disk space for the rest, extrapolated from the first files."""
    left = _count(rest)
    if not left or not sum(s.files - 1 for s in spent):
        return f"{left} {what}"
    expected = estimates.remaining(spent, left, len({_scene(unit) for unit in rest}), workers)
    time = f"about {estimates.duration(expected.seconds)} with {estimates.workers_text(workers)}"
    return f"{left} {what}, {time}, {expected.gigabytes:.1f} GB"


def _scene(unit: Unit) -> tuple[Path, Factors]:
    return unit.drive.district, unit.drive.factors

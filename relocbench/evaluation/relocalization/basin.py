"""The basin of a tracker: the keyframes from which it can be expected to find the pose, so that retrieval succeeded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from relocbench.datasets.core.schema import Strict
from relocbench.errors import PredictionError

Source = Literal["pairs", "given", "probe"]
SAID: dict[Source, str] = {
    "pairs": "as far as the pairs of the set reach",
    "given": "as given by --radius and --heading",
    "probe": "the tracker's own, as measured by relocbench probe",
}


class Basin(Strict):
    """The basin of a tracker on a task: the largest distance and angle between the cameras of query and keyframe."""

    metres: float
    degrees: float
    source: Source

    @property
    def limits(self) -> tuple[float, float]:
        return self.metres, self.degrees


def basin(limits: tuple[float, float], source: Source) -> Basin:
    """The basin of these metres and degrees."""
    return Basin(metres=limits[0], degrees=limits[1], source=source)


@dataclass(frozen=True)
class Basins:
    """The basins that the user gave or measured; with neither, the reach of the pairs is used."""

    given: tuple[float, float] | None = None
    """metres and degrees, for all trackers"""
    measured: dict[tuple[str, str, str], float] | None = None
    """(method, ``translation`` or ``rotation``, conditions) -> radius"""

    def of(self, tracker: str, condition_ref: str, condition_query: str, reach: tuple[float, float]) -> Basin:
        """The basin of a tracker on a task; the pairs' reach if it was not measured, such as one that uses no prior."""
        if self.given is not None:
            return basin(self.given, "given")
        if self.measured is None:
            return basin(reach, "pairs")
        from relocbench.evaluation.probe.table import ACROSS, SAME  # imported late: it loads the plotting code

        whole = SAME if condition_ref == condition_query else ACROSS
        for conditions in (f"{condition_ref} → {condition_query}", whole):
            metres = self.measured.get((tracker, "translation", conditions))
            degrees = self.measured.get((tracker, "rotation", conditions))
            if metres is not None and degrees is not None:
                return basin((metres, degrees), "probe")
        return basin(reach, "pairs")

    def knows(self, tracker: str) -> bool:
        """Whether the tracker's basin was measured."""
        return {what for name, what, _ in self.measured or {} if name == tracker} == {"translation", "rotation"}


def given_basin(radius_m: float | None, heading_deg: float | None) -> tuple[float, float] | None:
    """The basin of ``--radius`` and ``--heading``; None if neither was given. One that was not given has no limit."""
    if radius_m is None and heading_deg is None:
        return None
    return math.inf if radius_m is None else radius_m, 180.0 if heading_deg is None else heading_deg


def read_basins(folder: Path) -> dict[tuple[str, str, str], float]:
    """Read the radii of whole poses from ``radii.csv`` of ``relocbench probe``.

    A radius of 0, where fewer than half succeed even from the truth, does not tell the width of a basin and is left
    out.

    Args:
        folder: the folder of the probe, or the file itself.

    Raises:
        PredictionError: no such table, wrong columns, a radius that is no number, or no radius of whole poses.
    """
    from relocbench.evaluation.probe.records import RADII  # imported late: its package loads the plotting code

    path = folder / "radii.csv" if folder.is_dir() else folder
    if not path.exists():
        raise PredictionError("missing; expected radii of `relocbench probe`", path)
    out = {
        (row.method, row.what, row.conditions): row.radius
        for row in RADII.read(path)
        if row.what in ("translation", "rotation") and row.radius is not None and row.radius > 0
    }
    if not out:
        raise PredictionError("holds no basin of whole poses; probe a tracker that starts from a prior", path)
    return out

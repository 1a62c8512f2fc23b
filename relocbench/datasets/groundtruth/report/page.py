"""``index.html``: the pictures of the ground truth with their numbers, on one page without scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.groundtruth.calibration.files import CalibrationFile, LidarErrors
from relocbench.datasets.groundtruth.pairs.reasons import by_kind, common, reduced_words
from relocbench.datasets.groundtruth.report.inspected import InspectedSet, Spot, reason_of
from relocbench.datasets.groundtruth.report.residual_picture import Residuals
from relocbench.files import write_text
from relocbench.pages import render


@dataclass(frozen=True, eq=False)
class DrawnSpot:
    """One pair and the paths of its pictures, relative to the page."""

    spot: Spot
    number: int
    overlay: str
    keyframe: str | None
    agreement: str | None
    """whether the images agree at the ground truth, in words"""


@dataclass(frozen=True, eq=False)
class DrawnSet:
    """One pair set and the paths of its pictures, relative to the page."""

    found: InspectedSet
    residuals: Residuals
    map: str
    spots: tuple[DrawnSpot, ...]


def write_page(
    path: Path, dataset: Dataset, drawn: Sequence[DrawnSet], residuals: str, calibration: CalibrationFile
) -> None:
    """Write the page of all pair sets, and of the lidars' calibration if it was estimated."""
    page = render(
        __name__,
        "page.html.j2",
        dataset=dataset,
        residuals=residuals,
        calibration=calibration,
        lidars=[_lidar(name, errors) for name, errors in calibration.lidars.items()],
        sets=[_pair_set(one) for one in drawn],
        enlarged=drawn[0].found.enlarged if drawn else 1.0,
        pictured=any(spot.keyframe is not None for one in drawn for spot in one.spots),
        address=quote,
        stem=lambda file: Path(file).stem,
    )
    write_text(path, page)


def _pair_set(one: DrawnSet) -> dict[str, object]:
    pairs = one.found.pair_set.all_pairs
    accepted = [p for p in pairs if p.accepted]
    verdicts = list(one.found.query.verdicts.values())
    return {
        "found": one.found,
        "map": one.map,
        "spots": one.spots,
        "accepted": len(accepted),
        "rejected": len(pairs) - len(accepted),
        "calibrated": all(p.has_calibrated_sigmas for p in pairs),
        "sigmas_cm": [_median([p.axis_sigmas[k] for p in accepted], 100.0, 2) for k in range(3)],
        "sigma_deg": _median([p.sigma_rotation_deg for p in accepted], 1.0, 3),
        "residuals_cm": [_number(100 * sigma / one.found.enlarged, 2) for sigma in one.residuals.sigmas_m],
        "kept": sum(not v for v in verdicts),
        "registrations": len(verdicts),
        "pair_reasons": _reasons([reason_of(p) for p in pairs if not p.accepted]),
        "graph_reasons": _reasons([reduced_words(v, one.found.enlarged) for v in verdicts if v]),
    }


def _reasons(reasons: list[str]) -> list[tuple[str, int]]:
    """The kinds of reasons, and how many there are of each."""
    return [(common(same), len(same)) for same in by_kind(reasons).values()]


def _median(values: Sequence[float | None], factor: float, digits: int) -> str:
    known = [factor * v for v in values if v is not None]
    return _number(float(np.median(known)) if known else float("nan"), digits)


def _number(value: float, digits: int) -> str:
    return "–" if np.isnan(value) else f"{value:.{digits}f}"


_DISTINCT = 2.0
"""an error is marked that is more standard deviations away from nothing"""


class Cell(NamedTuple):
    """A number with its standard deviation."""

    text: str
    distinct: bool
    """whether it differs from nothing by more than chance"""


def _lidar(name: str, errors: LidarErrors) -> dict[str, object]:
    """A row of the table: the lidar's clock, what is to be added to its position, and by what it is to be turned."""
    return {
        "name": name,
        "late_ms": _cell(errors.late_ms, errors.late_sigma_ms, 1.0, 1),
        "position_cm": [_cell(*v, 100.0, 1) for v in zip(errors.position_m, errors.position_sigma_m, strict=True)],
        "rotation_deg": [_cell(*v, 1.0, 2) for v in zip(errors.rotation_deg, errors.rotation_sigma_deg, strict=True)],
        "open": ", ".join(errors.open),
    }


def _cell(value: float, sigma: float, factor: float, digits: int) -> Cell:
    text = f"{round(factor * value, digits) + 0.0:.{digits}f} ± {factor * sigma:.{digits}f}"
    return Cell(text, value != 0 and abs(value) > _DISTINCT * sigma)

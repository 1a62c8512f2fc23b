"""The table of what is known of the lidars' calibration, with its standard deviations, for the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from relocbench.datasets.groundtruth.calibration.files import CalibrationFile, LidarErrors

_DISTINCT = 2.0
"""an error is marked that is more standard deviations away from nothing"""


@dataclass(frozen=True)
class Cell:
    """A number with its standard deviation."""

    text: str
    distinct: bool
    """whether it differs from nothing by more than chance"""


@dataclass(frozen=True)
class Row:
    """One lidar of a drive: its clock, what is to be added to its position, and by what it is to be turned."""

    name: str
    late_ms: Cell
    position_cm: tuple[Cell, ...]
    rotation_deg: tuple[Cell, ...]
    open: str
    """what these drives do not show"""


def calibration_rows(file: CalibrationFile) -> list[Row]:
    """The rows of the table, by drive and lidar."""
    return [_row(name, errors) for name, errors in file.lidars.items()]


def _row(name: str, errors: LidarErrors) -> Row:
    return Row(
        name,
        _cell(errors.late_ms, errors.late_sigma_ms, 1.0, 1),
        _cells(errors.position_m, errors.position_sigma_m, 100.0, 1),
        _cells(errors.rotation_deg, errors.rotation_sigma_deg, 1.0, 2),
        ", ".join(errors.open),
    )


def _cells(values: Sequence[float], sigmas: Sequence[float], factor: float, digits: int) -> tuple[Cell, ...]:
    return tuple(_cell(v, s, factor, digits) for v, s in zip(values, sigmas, strict=True))


def _cell(value: float, sigma: float, factor: float, digits: int) -> Cell:
    text = f"{round(factor * value, digits) + 0.0:.{digits}f} ± {factor * sigma:.{digits}f}"
    return Cell(text, value != 0 and abs(value) > _DISTINCT * sigma)

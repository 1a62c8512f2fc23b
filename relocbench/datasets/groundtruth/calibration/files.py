"""Calibration on disk: the evidence of each pair of drives, and ``calibration.yaml``, which says what was found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from relocbench.datasets.core.npy import parse_npz
from relocbench.datasets.core.schema import Strict
from relocbench.datasets.groundtruth.calibration.adjustment import Reduced
from relocbench.datasets.groundtruth.calibration.estimation import CalibrationEvidence
from relocbench.datasets.groundtruth.calibration.faults import Calibration
from relocbench.datasets.groundtruth.calibration.unknowns import SIZE
from relocbench.errors import DatasetError
from relocbench.files import atomic_write, dump_yaml, load_yaml, read_bytes, write_text

FILE = "calibration.yaml"
_MOST_BYTES = 2**30
_ARRAYS = ("A", "h", "by_calibration", "count")


class LidarErrors(Strict):
    """Errors of one lidar in total, against the calibration as it is given, and their standard deviations."""

    late_ms: float
    late_sigma_ms: float
    position_m: tuple[float, float, float]
    """of the lidar in the rig: x forward, y left, z up; to be added to the given one"""
    position_sigma_m: tuple[float, float, float]
    rotation_deg: tuple[float, float, float]
    """rotation vector, in the rig's axes, by which the given extrinsics have to be turned"""
    rotation_sigma_deg: tuple[float, float, float]
    open: tuple[str, ...] = ()
    """what these drives say too little of, so that the given value is used: ``time``, ``position``, ``rotation``"""


class CalibrationFile(Strict):
    """The content of ``calibration.yaml``."""

    causes: tuple[str, ...] = ()
    """what is in error, the most important first"""
    rounds: int = 0
    """how often recordings were corrected"""
    lidars: dict[str, LidarErrors] = Field(default_factory=dict)
    """by ``DRIVE/LIDAR``"""
    blocks: dict[str, str] = Field(default_factory=dict)
    """drive -> folder of its blocks, relative to this file"""
    registrations: dict[str, str] = Field(default_factory=dict)
    """query drive -> folder of its registrations, relative to this file"""


def write_evidence(path: Path, evidence: CalibrationEvidence) -> None:
    """Write the evidence of two drives. The same evidence gives the same bytes."""
    arrays: dict[str, Any] = {
        "A": evidence.reduced.A,
        "h": evidence.reduced.h,
        "by_calibration": evidence.by_calibration,
        "count": np.array(evidence.count, dtype=np.int64),
    }
    with atomic_write(path, "wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def read_evidence(path: Path, unknowns: int, nodes: int) -> CalibrationEvidence:
    """Evidence of K unknowns and N nodes. Raises DatasetError with the file if it is damaged or of other drives."""
    data = read_bytes(path, "evidence of calibration", DatasetError, _MOST_BYTES)
    arrays = parse_npz(data, _ARRAYS, path)
    shapes = {"A": (unknowns, unknowns), "h": (unknowns,), "by_calibration": (nodes, 6, unknowns), "count": ()}
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise DatasetError(f"'{name}' has the shape {arrays[name].shape}, not {shape}; remove it", path)
    return CalibrationEvidence(Reduced(arrays["A"], arrays["h"]), arrays["by_calibration"], int(arrays["count"]))


@dataclass(frozen=True)
class RoundFolders:
    """Where the files of the last round are."""

    blocks: dict[str, Path]
    registrations: dict[str, Path]


def write_calibration(
    folder: Path,
    calibration: Calibration,
    total: Any,
    open_kinds: dict[str, tuple[str, ...]],
    rounds: int,
    places: RoundFolders,
) -> CalibrationFile:
    """Write ``calibration.yaml``.

    Args:
        total: (K,) errors against the calibration as it is given.
        open_kinds: by ``DRIVE/LIDAR``, what cannot be estimated.
        rounds: how often recordings were corrected.
    """
    lidars = {}
    for k, (drive, lidar) in enumerate(calibration.sensors.names):
        own, sigma = total[SIZE * k : SIZE * (k + 1)], calibration.sigmas[k]
        lidars[f"{drive}/{lidar}"] = LidarErrors(
            late_ms=_rounded(1e3 * own[6], 3),
            late_sigma_ms=_rounded(1e3 * sigma[6], 3),
            position_m=_three(own[:3], 5),
            position_sigma_m=_three(sigma[:3], 5),
            rotation_deg=_three(np.degrees(own[3:6]), 4),
            rotation_sigma_deg=_three(np.degrees(sigma[3:6]), 4),
            open=open_kinds.get(f"{drive}/{lidar}", ()),
        )
    file = CalibrationFile(
        causes=tuple(map(str, calibration.causes)),
        rounds=rounds,
        lidars=lidars,
        blocks={name: path.relative_to(folder).as_posix() for name, path in places.blocks.items()},
        registrations={name: path.relative_to(folder).as_posix() for name, path in places.registrations.items()},
    )
    write_text(folder / FILE, dump_yaml(file.model_dump(mode="json")))
    return file


def read_calibration(folder: Path) -> CalibrationFile:
    """``calibration.yaml`` of a folder; without it, nothing was estimated. Raises DatasetError with the file."""
    path = folder / FILE
    return (
        load_yaml(path, CalibrationFile, "what is known of the calibration", DatasetError)
        if path.exists()
        else CalibrationFile()
    )


def _three(values: Any, digits: int) -> tuple[float, float, float]:
    x, y, z = (_rounded(v, digits) for v in values)
    return x, y, z


def _rounded(value: float, digits: int) -> float:
    return round(float(value), digits) + 0.0

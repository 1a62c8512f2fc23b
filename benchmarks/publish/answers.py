"""The answers of trackers to pairs of the validation districts, as the experiments of this folder keep them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from calibration import CAMERA, same_place

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.metrics import pose_errors
from relocbench.tracking import Query, Reference

POSITION_M, ANGLE_DEG, LARGEST_DEG = 0.25, 2.0, 0.5


@dataclass(frozen=True)
class Answer:
    """The errors of one row of a table on a pair; None where there is no pose."""

    row: str
    same_drive: bool
    distance_m: float
    """between the cameras"""
    conditions: tuple[str, str]
    translation_m: float | None
    rotation_deg: float | None

    @property
    def right(self) -> float:
        """1 if the answer is within the thresholds."""
        if self.translation_m is None or self.rotation_deg is None:
            return 0.0
        return float(self.translation_m <= POSITION_M and self.rotation_deg <= ANGLE_DEG)

    @property
    def area(self) -> float:
        """The share of r_auc that the pair contributes."""
        return 0.0 if self.rotation_deg is None else max(0.0, 1.0 - self.rotation_deg / LARGEST_DEG)


@dataclass(frozen=True, eq=False)
class Question:
    """A pair with what is known of it."""

    reference: Reference
    query: Query
    truth: Array
    """(4, 4) T_query_ref"""
    same_drive: bool
    metres: float
    """between the cameras"""
    degrees: float
    """by which the query's camera is turned"""
    conditions: tuple[str, str]

    def answer(self, row: str, pose: Array | None) -> Answer:
        """What a row says, judged by the truth."""
        errors: tuple[float | None, float | None] = (None, None)
        if pose is not None:
            errors = _errors(pose, self.truth)
        return Answer(row, self.same_drive, self.metres, self.conditions, *errors)


def questions(dataset: Dataset, count: int, seed: int) -> Iterator[Question]:
    """Pairs of one place (:func:`calibration.same_place`) with their images."""
    for pair in same_place(dataset, count, seed):
        assert pair.truth is not None
        drives = [dataset.traversal(frame[0]) for frame in (pair.reference, pair.query)]
        yield Question(
            drives[0].reference(CAMERA, pair.reference[1]),
            drives[1].query(CAMERA, pair.query[1]),
            pair.truth,
            pair.reference[0] == pair.query[0],
            *_errors(np.eye(4), pair.truth),
            (str(drives[0].condition), str(drives[1].condition)),
        )


def kept(path: Path, make: Callable[[], Iterable[Answer]]) -> list[Answer]:
    """Answers that a file of JSON lines keeps; they are made if it does not exist."""
    if not path.exists():
        lines = [json.dumps(asdict(answer)) + "\n" for answer in make()]
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text("".join(lines))
        part.rename(path)
    read = map(json.loads, path.read_text().splitlines())
    return [Answer(**{**line, "conditions": tuple(line["conditions"])}) for line in read]


def _errors(pose: Array, truth: Array) -> tuple[float, float]:
    found = pose_errors(pose[None], truth[None])
    return float(found.translation_error_m[0]), float(found.rotation_error_deg[0])

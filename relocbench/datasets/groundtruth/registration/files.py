"""Registrations on disk: a table for people to read, and for a resumed build to continue from.

``REF__QUERY.csv`` has one row for each query node that was tried. Numbers are written so that they are read back bit
for bit; unknown ones are left empty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration
from relocbench.errors import DatasetError
from relocbench.files import read_csv, write_table

_UPPER = np.triu_indices(6)
_EVIDENCE = tuple(f.name for f in fields(Evidence) if f.name != "weakest_direction")
_DIRECTION = ("weakest_x", "weakest_y", "weakest_z")
_POSE = tuple(f"T_ref_query_{row}{column}" for row in range(3) for column in range(4))
_INFORMATION = tuple(f"information_{i}{j}" for i, j in zip(*_UPPER, strict=True))
COLUMNS = (
    "ref_node",
    "query_node",
    "ref_timestamp_ns",
    "query_timestamp_ns",
    "trusted",
    "reason",
    *_EVIDENCE,
    *_DIRECTION,
    *_POSE,
    *_INFORMATION,
)


def write_registrations(path: Path, registrations: Sequence[Registration], reference: Nodes, query: Nodes) -> None:
    """Write the table of one query drive."""
    rows = []
    for r in registrations:
        evidence = [getattr(r.evidence, name) for name in _EVIDENCE]
        numbers = [*evidence, *r.evidence.weakest_direction, *r.T_ref_query[:3].ravel(), *r.information[_UPPER]]
        ref_time = int(reference.times_ns[r.ref]) if r.ref >= 0 else ""
        place = (r.ref, r.query, ref_time, int(query.times_ns[r.query]), int(r.trusted), r.reason)
        rows.append([*place, *("" if np.isnan(v) else float(v) for v in numbers)])
    write_table(path, COLUMNS, rows)


def read_registrations(path: Path) -> list[Registration]:
    """Read what :func:`write_registrations` wrote.

    Raises:
        DatasetError: the file is not such a table; names the line.
    """
    rows = read_csv(path, "registrations", DatasetError)
    if next(rows, (1, []))[1] != list(COLUMNS):
        raise DatasetError("expected a table of registrations; remove the file and build again", path, 1)
    out = []
    for number, row in rows:
        try:
            out.append(_read(dict(zip(COLUMNS, row, strict=True))))
        except ValueError as bad:
            raise DatasetError(
                f"is not a registration ({bad}); remove the file and build again", path, number
            ) from None
    return out


def _read(row: dict[str, str]) -> Registration:
    def numbers(names: Sequence[str]) -> Array:
        return np.array([float(row[name]) if row[name] else np.nan for name in names])

    x, y, z = numbers(_DIRECTION).tolist()
    values = dict(zip(_EVIDENCE, numbers(_EVIDENCE).tolist(), strict=True))
    information = np.zeros((6, 6))
    information[_UPPER] = numbers(_INFORMATION)
    information = np.triu(information) + np.triu(information, 1).T
    T_ref_query = np.vstack([numbers(_POSE).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
    if np.isnan(T_ref_query).any():
        T_ref_query = np.full((4, 4), np.nan)
    evidence = Evidence(weakest_direction=(x, y, z), **values)
    return Registration(int(row["ref_node"]), int(row["query_node"]), T_ref_query, information, evidence, row["reason"])

"""Columns and data type of the .bin scans of a generic folder are told from their values, or the setting is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import Notes, refused

from relocbench.datasets.importers.generic.scans import USUAL_COLUMNS, read_lidars
from relocbench.errors import DatasetError


def scan(columns: int, points: int = 2000) -> np.ndarray:
    """Walls and road as a lidar of 16 rings sees them, in the order of its beams."""
    rng = np.random.default_rng(0)
    azimuth = np.repeat(np.linspace(-np.pi, np.pi, points // 16, endpoint=False), 16)
    ring = np.tile(np.arange(16), points // 16)
    level = 8 + 3 * np.cos(3 * azimuth) + 0.01 * rng.normal(size=len(azimuth))
    xyz = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), 0.05 * (ring - 8) * level])
    others = np.column_stack([rng.random(len(azimuth)), ring, 0.1 * (azimuth + np.pi) / (2 * np.pi)])
    return np.hstack([xyz, others])[:, :columns]


def folder(root: Path, values: np.ndarray, dtype: str, settings: str = "") -> Path:
    scans = root / "lidar" / "top"
    scans.mkdir(parents=True)
    for k in range(3):
        (scans / f"{k}.bin").write_bytes(values.astype(dtype).tobytes())
    (root / "lidar.yaml").write_text(f"lidars: {{top: {{pattern: spinning{settings}}}}}\n")
    return root


@pytest.mark.parametrize("dtype", ["<f4", "<f8"])
@pytest.mark.parametrize("columns", [3, 4, 5, 6])
def test_columns_and_type_are_found_and_told(tmp_path: Path, columns: int, dtype: str) -> None:
    values, notes = scan(columns), Notes()
    lidar = read_lidars(folder(tmp_path / "drive", values, dtype), np.eye(4), notes)[0]
    assert np.allclose(lidar.read(1).points, values[:, :3], atol=1e-5)
    kind = {"<f4": "float32", "<f8": "float64"}[dtype]
    named = " ".join(USUAL_COLUMNS[columns])
    assert notes.notes == [f"drive: scans of top are read as {kind} {named}, told from 1.bin"]


def test_what_is_named_is_not_told_from_values(tmp_path: Path) -> None:
    values, notes = scan(4), Notes()
    given = ", columns: [y, x, z, ring], dtype: float64"
    lidar = read_lidars(folder(tmp_path, values, "<f8", given), np.eye(4), notes)[0]
    assert np.allclose(lidar.read(0).points, values[:, [1, 0, 2]])
    assert notes.notes == []


@pytest.mark.parametrize("data", [b"", b"12345", bytes(range(256)) * 9, np.full(12, 1.5, "<f4").tobytes()])
def test_what_cannot_be_told_names_the_setting(tmp_path: Path, data: bytes) -> None:
    root = folder(tmp_path, scan(4), "<f4")
    for path in (root / "lidar" / "top").iterdir():
        path.write_bytes(data)
    with refused(DatasetError, "", None, "lidar.yaml") as caught:
        read_lidars(root, np.eye(4))
    assert caught.value.path is not None
    assert "\n" not in str(caught.value)

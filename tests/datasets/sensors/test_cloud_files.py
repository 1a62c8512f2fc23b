"""Point clouds of every format, read as metres near an origin."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pye57
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from relocbench.datasets.sensors.binary_layout import BinaryLayout, detect_layout
from relocbench.datasets.sensors.cloud_files import CloudFormat, read_cloud
from relocbench.datasets.sensors.cloud_poses import read_cloud_poses
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import apply, invert, make_transform, so3_exp, transform_to_tq


def wavy(count: int = 400, seed: int = 0) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Points on a ring around the sensor, in the order in which a lidar measures them."""
    angle = np.linspace(0, 8 * np.pi, count)
    far = 8 + 2 * np.sin(5 * angle)
    rng = np.random.default_rng(seed)
    return np.column_stack([far * np.cos(angle), far * np.sin(angle), rng.uniform(-1.7, 1.0, count)])


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npy", "bin", "xyz", "csv"])
def test_every_format_gives_the_same_points(tmp_path: Path, suffix: str) -> None:
    points, path = wavy(), tmp_path / f"a cloud.{suffix}"
    if suffix == "npy":
        np.save(path, points)
    elif suffix == "bin":
        points.astype("<f8").tofile(path)
    elif suffix in ("xyz", "csv"):
        between = " " if suffix == "xyz" else ";"
        lines = [between.join(map(repr, row)) + f"{between}7\n" for row in points.tolist()]
        path.write_text("x y z intensity\n" * (suffix == "csv") + "".join(lines))
    elif suffix == "ply":
        head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
        head += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
        path.write_text(head + "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()))
    else:
        head = "VERSION .7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\n"
        head += f"WIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\nDATA ascii\n"
        path.write_text(head + "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()))
    read = read_cloud(path)
    np.testing.assert_array_equal(read.points, points)
    assert not read.origin.any()


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_coordinates_of_a_map_lose_nothing(tmp_path: Path, suffix: str) -> None:
    there = np.array([691_234.0, 5_334_987.0, 512.0])
    points = np.round(wavy() + there, 4)
    las = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
    las.header.offsets, las.header.scales = np.floor(there), np.full(3, 1e-4)
    las.x, las.y, las.z = points.T
    las.write(str(tmp_path / f"map.{suffix}"))
    read = read_cloud(tmp_path / f"map.{suffix}")
    np.testing.assert_allclose(read.points + read.origin, points, atol=1e-8)
    assert np.abs(read.points).max() < 1000
    assert any("is subtracted" in note for note in read.notes)


def write_e57(path: Path, T: list[np.ndarray[Any, Any]], points: np.ndarray[Any, Any]) -> None:
    with pye57.E57(str(path), mode="w") as file:
        for T_file_setup in T:
            local = apply(invert(T_file_setup), points)
            translation, (x, y, z, w) = transform_to_tq(T_file_setup)
            data = {f"cartesian{axis}": local[:, k] for k, axis in enumerate("XYZ")}
            file.write_scan_raw(data, rotation=np.array([w, x, y, z]), translation=translation)


def test_setups_of_an_e57_file_are_merged_by_their_poses_or_selected(tmp_path: Path) -> None:
    points = wavy()
    T = [make_transform(so3_exp([0, 0, k + 0.3]), [k, 2.0, 0.1]) for k in range(2)]
    write_e57(tmp_path / "setups.e57", T, points)
    merged = read_cloud(tmp_path / "setups.e57")
    np.testing.assert_allclose(merged.points, np.concatenate([points, points]), atol=1e-6)  # float32
    assert merged.sensors is not None
    np.testing.assert_allclose(merged.sensors[[0, -1]], [[0.0, 2.0, 0.1], [1.0, 2.0, 0.1]], atol=1e-9)
    one = read_cloud(tmp_path / "setups.e57", CloudFormat(setups=(1,)))
    assert len(one.points) == len(points)
    with refused(DatasetError, "", None, "5", "2"):
        read_cloud(tmp_path / "setups.e57", CloudFormat(setups=(5,)))


@pytest.mark.parametrize(("name", "package"), [("a.las", "laspy"), ("a.e57", "pye57")])
def test_a_missing_package_is_named_with_its_extra(
    tmp_path: Path, name: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / name).write_bytes(b"LASF")
    real = builtins.__import__

    def without(module: str, *args: Any, **kwargs: Any) -> Any:
        if module == package:
            raise ImportError(module)
        return real(module, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with refused(ConfigError, "", None, package, "relocbench[clouds]"):
        read_cloud(tmp_path / name)


@pytest.mark.parametrize("name", ["a.las", "a.laz", "a.e57", "a.ply", "a.pcd", "a.npy", "a.bin", "a.xyz"])
@pytest.mark.parametrize("content", [b"", b"rubbish\nthat is no cloud", b"\xff" * 1000])
def test_a_damaged_file_is_one_line_that_names_it(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with refused(DatasetError, name) as raised:
        read_cloud(tmp_path / name)
    assert "\n" not in str(raised.value)


@given(
    columns=st.integers(3, 6),
    kind=st.sampled_from(["float32", "float64"]),
    seed=st.integers(0, 50),
    shuffled=st.booleans(),
    count=st.integers(300, 1200),
)
@settings(max_examples=60, deadline=None)
def test_the_layout_of_a_bin_file_is_found(columns: int, kind: str, seed: int, shuffled: bool, count: int) -> None:
    rng = np.random.default_rng(seed)
    more = np.column_stack([rng.uniform(size=count), rng.integers(0, 64, count), np.linspace(0, 0.1, count)])
    values = np.hstack([wavy(count, seed), more])[:, :columns]
    values = values[rng.permutation(count)] if shuffled else values
    found = detect_layout(values.astype(f"<{np.dtype(kind).str[1:]}").tobytes(), Path("scan.bin"))
    assert found == BinaryLayout(kind, columns)  # type: ignore[arg-type]


def test_a_layout_given_by_hand_is_not_second_guessed_but_must_fit() -> None:
    data = wavy().astype("<f4").tobytes()
    assert detect_layout(data, Path("a.bin"), "float32", 4) == BinaryLayout("float32", 4)
    with refused(DatasetError, "a.bin"):
        detect_layout(bytes(4800), Path("a.bin"))
    with refused(DatasetError, "a.bin", None, "4788", "float64"):
        detect_layout(data[:-12], Path("a.bin"), "float64", 5)


def test_poses_are_read_in_every_format(tmp_path: Path) -> None:
    T = np.array([make_transform(so3_exp([0, 0, 0.1 * k]), [k, 0.5, 0.0]) for k in range(3)])
    rows = []
    for pose in T:
        translation, quaternion = transform_to_tq(pose)
        rows.append(" ".join(map(repr, [*translation.tolist(), *quaternion.tolist()])))
    texts = {
        "tum": "".join(f"{k}.5 {row}\n" for k, row in enumerate(rows)),
        "graph": "".join(f"v{k} {rows[k]}\n" for k in (2, 0, 1)),
        "g2o": "".join(f"VERTEX_SE3:QUAT {k} {row}\n" for k, row in enumerate(rows)) + "EDGE_SE3:QUAT 0 1 0\n",
        "kitti": "".join(" ".join(map(repr, pose[:3].ravel().tolist())) + "\n" for pose in T),
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        found = np.array(read_cloud_poses(tmp_path / name, 3), dtype=np.float64)
        np.testing.assert_allclose(found, T, atol=1e-9, err_msg=name)
    with refused(DatasetError, "", None, "3", "4"):
        read_cloud_poses(tmp_path / "tum", 4)
    lines = texts["tum"].splitlines()
    (tmp_path / "lost").write_text("\n".join([lines[0], "", lines[2]]))
    assert [pose is None for pose in read_cloud_poses(tmp_path / "lost", 3)] == [False, True, False]
    (tmp_path / "back").write_text("\n".join([lines[0], lines[2], lines[1]]))
    with refused(DatasetError, "back", 3, "line 2"):
        read_cloud_poses(tmp_path / "back", 3)
    (tmp_path / "bad").write_text("1 2 3\n")
    with refused(DatasetError, "bad", 1, "1 2 3"):
        read_cloud_poses(tmp_path / "bad", 1)


def test_a_small_scene_with_values_next_to_zero_has_a_layout() -> None:
    points = wavy() / 4
    points[::3, 1] = 1e-17
    assert detect_layout(points.astype("<f4").tobytes(), Path("room.bin")) == BinaryLayout("float32", 3)


@pytest.mark.parametrize("start", [1.7e9, 1.7e18], ids=["seconds", "nanoseconds"])
def test_absolute_times_beside_the_coordinates_are_no_obstacle(start: float) -> None:
    count = 400
    ring = np.arange(count) % 16
    times = start * (1 + 1e-10 * np.linspace(0, 1, count))
    values = np.column_stack([wavy(count), np.full(count, 0.3), ring, times])
    assert detect_layout(values.tobytes(), Path("scan.bin")) == BinaryLayout("float64", 6)

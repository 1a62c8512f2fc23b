"""Sparse models where COLMAP and kapture leave them, and in the text that kapture writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from odd_inputs import REAL
from refusals import refused

from relocbench.datasets.importers.colmap.model import read_model
from relocbench.datasets.importers.colmap.project import model_folder
from relocbench.datasets.importers.kapture.folder import read_folder
from relocbench.errors import ConfigError, DatasetError

CAMERAS = "1 PINHOLE 64 48 50 50 32 24\n"
IMAGES = "1 1 0 0 0 0.5 0 0 1 a b.png\n3 4 7 5 6 -1\n2 1 0 0 0 0 0 0 1 c.png\n\n"
POINTS = "7 1 2 3 9 9 9 0.5 1 0\n"


def write_model(folder: Path, separator: str = " ", images: str = IMAGES) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in (("cameras", CAMERAS), ("images", images), ("points3D", POINTS)):
        text = text.replace("a b", "a_b").replace(" ", separator) if separator != " " else text
        (folder / f"{name}.txt").write_text(f"# {name}\n{text}")
    return folder


@pytest.mark.parametrize("separator", [", ", ",", ",\t", "\t"])
def test_a_text_model_may_have_commas(tmp_path: Path, separator: str) -> None:
    plain, other = read_model(write_model(tmp_path / "0")), read_model(write_model(tmp_path / "1", separator))
    assert other.cameras == plain.cameras
    assert [image.name for image in plain.images.values()] == ["a b.png", "c.png"]
    assert [image.name for image in other.images.values()] == ["a_b.png", "c.png"]
    for number, image in plain.images.items():
        np.testing.assert_array_equal(other.images[number].T_cam_world, image.T_cam_world)
        np.testing.assert_array_equal(other.images[number].points, image.points)
    np.testing.assert_array_equal(other.xyz, plain.xyz)
    np.testing.assert_array_equal(plain.xyz, [[1.0, 2.0, 3.0]])


def test_a_decimal_comma_is_no_separator(tmp_path: Path) -> None:
    with refused(DatasetError, "images.txt", 2, "0,5"):
        read_model(write_model(tmp_path / "0", images=IMAGES.replace("0.5", "0,5")))


def test_the_models_of_a_project_are_found_where_colmap_puts_them(tmp_path: Path) -> None:
    for place in ("sparse", "sparse/0", "dense/sparse", "dense/0/sparse", "0", "reconstruction"):
        project = tmp_path / place.replace("/", "_")
        write_model(project / place)
        assert model_folder(project) == project / place
        assert model_folder(project / place) == project / place
    project = tmp_path / "two"
    write_model(project / "sparse" / "0")
    write_model(project / "sparse" / "1", images=IMAGES.split("2 1 0")[0])
    with refused(ConfigError, "", None, "sparse/0", "2 images", "sparse/1", "1 images", "--sparse-model"):
        model_folder(project)
    assert model_folder(project, "sparse/1") == project / "sparse" / "1"
    with refused(ConfigError, "", None, "--sparse-model", "sparse/2", "sparse/0"):
        model_folder(project, "sparse/2")
    (tmp_path / "empty").mkdir()
    with refused(DatasetError, "empty", None, "cameras.bin", "sparse/0"):
        model_folder(tmp_path / "empty")


def test_a_model_whose_binary_files_are_not_all_there_is_read_as_text(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "0")
    (folder / "cameras.bin").write_bytes(b"old")
    assert len(read_model(folder).images) == 2
    (folder / "points3D.txt").unlink()
    with refused(DatasetError, "cameras.bin"):
        read_model(folder)


def test_the_model_that_kapture_wrote_has_the_poses_of_its_folder() -> None:
    root = REAL / "kapture_t265"
    if not root.is_dir():
        pytest.skip(f"{root} is not here")
    model, folder = read_model(root / "colmap"), read_folder(root / "kapture")
    assert len(model.images) == len(folder.images) == 6
    records = {record.name: record for record in folder.images}
    for image in model.images.values():
        record = records[image.name]
        pose = folder.T_device_world(record.device, record.timestamp)
        assert pose is not None
        np.testing.assert_allclose(image.T_cam_world, pose, atol=1e-9)
        ours, theirs = model.cameras[image.camera], folder.camera(record.device)
        assert (ours.model, ours.size, ours.fx) == (theirs.model, theirs.size, theirs.fx)

"""``build-dataset photographs`` of cube maps: found by the names of their faces, kept together by place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from refusals import refused

from relocbench.datasets.checks.validation import validate_dataset
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.single_photographs import dataset as importer
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.progress import Silent

SIDES = "posx", "negz", "negx", "posz"


def write_cube(folder: Path, place: str, faces: Sequence[str] = SIDES, seed: int = 0) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, face in enumerate(faces):
        noise = np.random.default_rng([seed, number, len(place)]).uniform(0, 255, size=(128, 128, 3))
        image = np.clip(128 + 6 * (cv2.GaussianBlur(noise, (0, 0), 3.0) - 127.5), 1, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"{place}_{face}.png"), image)
    return folder


def write_yaw(folder: Path, place: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for yaw in (0, 30, 60):
        image = np.random.default_rng([yaw, len(place)]).integers(1, 255, size=(90, 120, 3)).astype(np.uint8)
        cv2.imwrite(str(folder / f"{place}_yaw{yaw:03d}.png"), image)
    return folder


def built(sources: list[Path], out: Path, workers: int = 0, **options: object) -> Dataset:
    chosen = importer.Options.model_validate({"size": "80x60", "correspondences": 60, "changes": ("none",), **options})
    return importer.build(sources, chosen, out, Silent(), Run(workers=workers))


def test_a_cube_map_is_one_photograph_whose_queries_turn_and_zoom_exactly(tmp_path: Path) -> None:
    source = write_cube(write_cube(tmp_path / "cubes", "square"), "alley", (*SIDES, "posy", "negy"), 1)
    dataset = built([source], tmp_path / "set", keyframes=3, viewpoint="strong", translation=0, validation=0)
    assert not validate_dataset(dataset.root, Silent()).faults
    assert sorted(set(dataset.traversal("train").names.values())) == [
        f"{name}@{k}" for name in ("alley", "square") for k in (1, 2, 3)
    ]
    (pair_set,) = dataset.pair_sets("train")
    focal = set()
    for pair in pair_set.pairs:
        assert pair.T_query_ref is not None
        assert np.allclose(pair.T_query_ref[:3, 3], 0)
        ref, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
        focal.add(round(query.camera.fx / ref.camera.fx, 3))
    assert len(focal) > 3


@pytest.mark.thorough
def test_the_views_of_a_place_are_in_one_split_in_whichever_folder_they_are(tmp_path: Path) -> None:
    cubes, streets = tmp_path / "cubes", tmp_path / "streets"
    for number, place in enumerate(("abbey", "minster", "quay")):
        write_cube(cubes, place, seed=number)
    for place in ("bridge", "lane", "minster"):
        write_yaw(streets, place)
    dataset = built([cubes, streets], tmp_path / "set", size="64x48", validation=0.1)
    names = {split: set(dataset.traversal(split).names.values()) for split in ("train", "validation")}
    assert names == {
        "train": {
            "cubes/abbey",
            *(f"streets/{place}_yaw0{yaw}.png" for place in ("bridge", "lane") for yaw in ("00", "30", "60")),
        },
        "validation": {
            "cubes/minster",
            "cubes/quay",
            *(f"streets/minster_yaw0{yaw}.png" for yaw in ("00", "30", "60")),
        },
    }


@pytest.mark.thorough
def test_views_of_cube_maps_depend_on_the_seed_and_on_nothing_else(tmp_path: Path) -> None:
    source = write_cube(tmp_path / "cubes", "square")
    options: dict[str, Any] = {"keyframes": 9, "viewpoint": "strong", "validation": 0}
    alone, shared = built([source], tmp_path / "1", **options), built([source], tmp_path / "2", workers=2, **options)
    files = sorted(path.relative_to(alone.root) for path in alone.root.rglob("*") if path.is_file())
    assert len(files) > 20
    assert all((alone.root / file).read_bytes() == (shared.root / file).read_bytes() for file in files)
    other = built([source], tmp_path / "3", seed=1, **options)
    poses = "traversals/train-unchanged/poses.csv"
    assert (other.root / poses).read_bytes() != (alone.root / poses).read_bytes()


def resized(folder: Path, width: int, height: int) -> None:
    cv2.imwrite(str(folder / "square_negx.png"), np.full((height, width, 3), 90, np.uint8))


@pytest.mark.parametrize(
    ("spoil", "place", "names"),
    [
        (lambda folder: (folder / "square_negx.png").unlink(), "square_posx.png", ("square_negx",)),
        (lambda folder: resized(folder, 128, 120), "square_negx.png", ("128x120", "square")),
        (lambda folder: resized(folder, 192, 192), "square_negx.png", ("192x192", "128x128", "square_posx.png")),
        (lambda folder: resized(folder, 90, 90), "square_negx.png", ("90x90", "96")),
        (
            lambda folder: (folder / "square_posz.jpg").write_bytes((folder / "square_posz.png").read_bytes()),
            "square_posz.png",
            ("posz", "square_posz.jpg"),
        ),
    ],
)
def test_what_is_no_whole_cube_map_is_refused(
    spoil: Callable[[Path], object], place: str, names: tuple[str, ...], tmp_path: Path
) -> None:
    source = write_cube(tmp_path / "cubes", "square")
    spoil(source)
    with refused(DatasetError, place, None, *names):
        built([source], tmp_path / "set")
    assert not (tmp_path / "set").exists()

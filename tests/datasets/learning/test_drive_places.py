"""Places along drives: which images show one, and what is left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from small_dataset import ACROSS, CAMERA, WITHIN, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.learning.drive_places import drive_places
from relocbench.datasets.learning.training_places import training_places
from relocbench.errors import ConfigError, DatasetError
from relocbench.progress import Silent
from relocbench.retrieval import PlaceImage

FRAMES = 12
LEARNT = {"train": [ACROSS, WITHIN]}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=FRAMES, splits=LEARNT)


def centre(dataset: Dataset, image: PlaceImage) -> np.ndarray:
    _, traversal, _, camera, name = image.image.key.split("/")
    return np.asarray(dataset.traversal(traversal).T_world_cam(camera, int(Path(name).stem))[:3, 3])


@pytest.mark.thorough
def test_images_of_one_place_are_near_and_those_of_others_far(dataset: Dataset) -> None:
    data = drive_places(dataset.root, radius_m=0.25, apart_m=0.8)
    assert data.places > 1
    assert {image.place for image in data.images} == set(range(data.places))
    assert {image.condition for image in data.images} == {"sunny, summer, day", "snow, winter, day"}
    places = np.array([image.place for image in data.images])
    at = np.stack([centre(dataset, image) for image in data.images])
    distance = np.linalg.norm(at[:, None] - at, axis=-1)
    same = places[:, None] == places
    assert distance[same].max() <= 2 * 0.25
    assert distance[~same].min() >= 0.8 - 2 * 0.25
    assert len(data.images) < 2 * FRAMES, "what lies between two places belongs to neither"
    assert data.images[0].image.image.shape == (72, 96, 3)
    assert data.views == ("street",)


@pytest.mark.thorough
def test_one_place_for_all_that_stand_together(dataset: Dataset) -> None:
    data = drive_places(dataset.root, radius_m=25.0, apart_m=50.0)
    assert (data.places, len(data.images)) == (1, 2 * FRAMES)
    assert data.described == ((dataset.name, dataset.fingerprint),)


@pytest.mark.thorough
def test_a_place_that_one_drive_shows_is_left_out(dataset: Dataset) -> None:
    """The other drive is turned by 2 degrees and stands elsewhere by some centimetres."""
    with refused(DatasetError, "", None, "train", "1e-06"):
        drive_places(dataset.root, radius_m=1e-6, apart_m=1e-5)


def test_drives_of_the_test_split_are_refused(tmp_path: Path) -> None:
    dataset = make_small_dataset(tmp_path / "small", splits={"train": [ACROSS], "test": [WITHIN]})
    with refused(ConfigError, dataset.root, None, "train", "summer"):
        drive_places(dataset.root)


def test_drives_in_different_worlds_are_refused(tmp_path: Path) -> None:
    """Poses that begin at the same place in worlds of their own would make one place of two."""
    off = np.eye(4)
    off[0, 3] = 40.0
    other = make_small_dataset(tmp_path / "off", splits=LEARNT, pose_fault=off)
    with refused(DatasetError, other.layout.pair_file(ACROSS), None, "summer", "winter", "40.0 m"):
        drive_places(other.root)


def test_a_build_that_was_not_finished_is_called_so(tmp_path: Path) -> None:
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "build.yaml").write_text("kind: synthetic\n")
    with refused(DatasetError, tmp_path / "half", None, "not finished"):
        training_places([tmp_path / "half"], Silent())


def test_sets_of_both_kinds_are_learnt_from_together(dataset: Dataset, tmp_path: Path) -> None:
    other = make_small_dataset(tmp_path / "other", frames=3, splits=LEARNT)
    both = training_places([dataset.root, other.root], Silent())
    assert (both.places, len(both.images)) == (2, 2 * FRAMES + 6)
    assert CAMERA in both.images[-1].image.key

"""Reading cross-view sets: University-1652's folders as they come, and its sample sheets."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from refusals import ErrorData, Notes, refused

from relocbench.datasets.core.images import write_image
from relocbench.datasets.cross_view import CrossViewSet, is_cross_view, open_cross_view
from relocbench.errors import DatasetError
from relocbench.metrics import NEVER, rank_descriptors, score_retrieval


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (8, 8, 3), dtype=np.uint8)


def put(root: Path, *keys: str) -> None:
    for k, key in enumerate(keys):
        path = root / key
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".png":
            write_image(path, picture(k))
        else:
            path.write_bytes(cv2.imencode(path.suffix, picture(k))[1].tobytes())


@pytest.fixture
def official(tmp_path: Path) -> Path:
    """A small set in the official layout: two classes to learn, two asked for, one distractor, one empty folder."""
    put(
        tmp_path,
        "train/drone/0839/image-01.jpeg",
        "train/drone/0842/image-01.jpeg",
        "train/satellite/0839/0839.jpg",
        "train/satellite/0842/0842.jpg",
        "train/street/0839/1.jpg",
        "train/google/0842/web.JPG",
        "test/query_drone/0003/image-01.jpeg",
        "test/query_drone/0003/image-02.jpeg",
        "test/query_drone/0001/image-01.jpeg",
        "test/query_satellite/0001/0001.jpg",
        "test/query_satellite/0003/0003.jpg",
        "test/query_street/0001/1.jpg",
        "test/gallery_satellite/0001/0001.jpg",
        "test/gallery_satellite/0002/0002.jpg",
        "test/gallery_satellite/0003/0003.jpg",
        "test/gallery_drone/0001/image-01.jpeg",
        "test/gallery_drone/0002/image-01.jpeg",
        "test/gallery_drone/0003/image-01.jpeg",
        "test/gallery_street/0001/1.jpg",
        "test/4K_drone/0003/frame.png",
    )
    (tmp_path / "test" / "query_street" / "0003").mkdir()
    (tmp_path / "test" / "gallery_street" / "0003").mkdir()
    (tmp_path / "test" / "query_drone" / "readme.txt").write_text("not a class")
    return tmp_path


def test_every_direction_that_the_folders_give_is_a_task(official: Path) -> None:
    tasks = {task.name: task for task in open_cross_view(official).tasks()}
    assert sorted(tasks) == [
        "4K_drone-satellite",
        "4K_drone-street",
        "drone-satellite",
        "drone-street",
        "satellite-drone",
        "satellite-street",
        "street-drone",
        "street-satellite",
    ]
    assert {view.view for view in tasks["4K_drone-satellite"].queries} == {"drone"}


def test_positives_are_the_images_of_the_querys_class_and_the_rest_are_distractors(official: Path) -> None:
    task = next(t for t in open_cross_view(official).tasks() if t.name == "drone-satellite")
    assert [view.key for view in task.queries] == [
        "test/query_drone/0001/image-01.jpeg",
        "test/query_drone/0003/image-01.jpeg",
        "test/query_drone/0003/image-02.jpeg",
    ]
    assert task.groups == ("0001", "0003", "0003")
    right = [[task.gallery[i].key for i in task.relevance.of(q)] for q in range(3)]
    wanted = "test/gallery_satellite/{0}/{0}.jpg"
    assert right == [[wanted.format("0001")], [wanted.format("0003")], [wanted.format("0003")]]
    assert len(task.gallery) == 3
    assert not task.relevance.junk.any()


def test_a_query_whose_class_is_in_no_gallery_has_no_positive(official: Path) -> None:
    task = next(t for t in open_cross_view(official).tasks() if t.name == "satellite-street")
    assert task.relevance.positives.tolist() == [1, 0]


def test_empty_class_folders_are_told_in_one_line(official: Path) -> None:
    listener = Notes()
    opened = open_cross_view(official, listener)
    assert opened.notes == ("2 of 21 class folders hold no image: test/query_street/0003, test/gallery_street/0003",)
    assert listener.notes == [f"{official}: {opened.notes[0]}"]


def test_places_to_learn_from_have_one_number_in_all_views(official: Path) -> None:
    data = open_cross_view(official).training()
    assert data.places == 2
    assert data.views == ("drone", "satellite", "street")
    of_key = {one.image.key: one.place for one in data.images}
    assert of_key["train/drone/0842/image-01.jpeg"] == of_key["train/satellite/0842/0842.jpg"] == 1
    assert "train/google/0842/web.JPG" not in of_key
    joined = open_cross_view(official).training(google=True)
    assert {one.image.view for one in joined.images if one.image.key.endswith("web.JPG")} == {"street"}


def test_classes_of_train_that_are_tested_on_are_told(official: Path) -> None:
    put(official, "train/drone/0003/image-01.jpeg")
    opened = open_cross_view(official)
    assert opened.overlap == ("0003",)
    assert "1 classes are in both train and test: 0003" in opened.notes


def test_the_fingerprint_covers_labels_and_pixels(official: Path) -> None:
    first = open_cross_view(official).fingerprint
    assert open_cross_view(official).fingerprint == first
    path = official / "test/gallery_drone/0002/image-01.jpeg"
    moved = official / "test/gallery_drone/0009/image-01.jpeg"
    moved.parent.mkdir()
    path.rename(moved)
    relabelled = open_cross_view(official).fingerprint
    cv2.imwrite(str(moved), picture(99))
    assert len({first, relabelled, open_cross_view(official).fingerprint}) == 3


def test_images_are_rgb_whatever_they_were(official: Path) -> None:
    cv2.imwrite(str(official / "test/query_drone/0001/image-01.jpeg"), np.full((8, 8), 90, np.uint8))
    task = next(t for t in open_cross_view(official).tasks() if t.name == "drone-satellite")
    assert task.queries[0].image.shape == (8, 8, 3)
    restored = pickle.loads(pickle.dumps(task.queries[1]))
    assert np.array_equal(restored.image, task.queries[1].image)


def test_an_image_that_cannot_be_read_is_named(official: Path) -> None:
    path = official / "test/query_drone/0003/image-02.jpeg"
    path.write_bytes(b"not an image at all")
    task = next(t for t in open_cross_view(official).tasks() if t.name == "drone-satellite")
    with refused(DatasetError, "image-02.jpeg"):
        _ = task.queries[2].image


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ("other/file.txt", ("", None, "University-1652's")),
        ("drone/0001/a.jpg", ("", None, "University-1652's")),
        ("test/query_drone/a.jpg", ("test/query_drone", None, "a.jpg")),
        ("test/query_drone/00 01/a.jpg", ("test/query_drone/00 01", None, "white space")),
        pytest.param("test/query_drone/0001/\udcff.jpg", ("", None, "UTF-8"), id="image of other bytes"),
        pytest.param("test/query_drone/00\udcff/a.jpg", ("", None, "UTF-8"), id="class of other bytes"),
    ],
)
def test_a_folder_without_the_layout_is_refused(tmp_path: Path, made: str, words: ErrorData) -> None:
    put(tmp_path, made if made.endswith("jpg") else "x/y.jpg")
    with refused(DatasetError, *words):
        open_cross_view(tmp_path)


def test_what_is_wrong_with_a_folder_is_said(official: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    with refused(DatasetError, official / "absent", None, "no such folder"):
        open_cross_view(official / "absent")
    with refused(DatasetError, official / "test", None, official):
        open_cross_view(official / "test")
    assert is_cross_view(official)
    assert not is_cross_view(official / "test")
    empty = tmp_path_factory.mktemp("empty")
    (empty / "train" / "drone" / "0001").mkdir(parents=True)
    with refused(DatasetError, empty, None, "1 class"):
        open_cross_view(empty)


def test_a_set_to_train_on_alone_has_nothing_to_ask_and_the_other_way_about(tmp_path: Path) -> None:
    put(tmp_path, "train/drone/0001/a.jpg", "train/satellite/0001/a.jpg")
    with refused(DatasetError, tmp_path, None, "no task", "training"):
        open_cross_view(tmp_path).tasks()
    other = tmp_path / "other"
    put(other, "test/query_drone/0001/a.jpg", "test/gallery_satellite/0001/a.jpg")
    with refused(DatasetError, other, None, "learn", "--split train"):
        open_cross_view(other).training()


@pytest.fixture(scope="module")
def sample(real_data: Callable[[str], Path]) -> CrossViewSet:
    return open_cross_view(real_data("university1652_sample"))


def test_the_sample_sheets_are_500_pairs_in_both_directions(sample: CrossViewSet) -> None:
    there, back = sample.tasks()
    assert (there.name, back.name) == ("drone-satellite", "satellite-drone")
    for task in (there, back):
        assert (len(task.queries), len(task.gallery)) == (500, 500)
        assert [task.relevance.of(q).tolist() for q in (0, 21, 499)] == [[0], [21], [499]]
    image = there.queries[137].image
    assert image.shape == (128, 128, 3)


def test_cells_of_the_sample_hold_nothing_of_their_borders(sample: CrossViewSet) -> None:
    """Frames are black; a cell that was cut wrongly has a black row or column along a side."""
    for task in sample.tasks():
        for view in task.queries[::37]:
            sides = view.image[[0, -1]].max(axis=(1, 2)), view.image[:, [0, -1]].max(axis=(0, 2))
            assert min(side.min() for side in sides) > 25


def test_real_satellites_find_their_drones_by_colour_far_above_chance(sample: CrossViewSet) -> None:
    """The source of the sample names colour histograms as what is well above 0.2 %."""
    task = sample.tasks()[1]

    def histogram(view: object) -> np.ndarray:
        lab = cv2.cvtColor(view.image, cv2.COLOR_RGB2LAB)  # type: ignore[attr-defined]
        counts = cv2.calcHist([lab], [0, 1, 2], None, [8, 16, 16], [0, 256] * 3).ravel()
        out: np.ndarray = np.sqrt(counts / counts.sum())
        return out

    query, gallery = (np.stack([histogram(v) for v in views]) for views in (task.queries, task.gallery))
    first = score_retrieval(rank_descriptors(query, gallery, task.relevance)).first
    assert np.mean(first == 0) > 0.05
    assert not (first == NEVER).any()

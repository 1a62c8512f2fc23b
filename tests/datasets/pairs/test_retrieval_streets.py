"""Place recognition along drives: which keyframes are right, what is left out, and what the options mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from refusals import Notes, noted, refused
from small_dataset import ACROSS, CAMERA, WITHIN, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.errors import ConfigError, DatasetError
from relocbench.evaluation.retrieval.opening import SetOptions, open_set
from relocbench.progress import Silent


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=6, query_depth=False)


def centres(dataset: Dataset, traversal: str) -> np.ndarray:
    drive = dataset.traversal(traversal)
    return np.stack([drive.T_world_cam(CAMERA, t)[:3, 3] for t in drive.timestamps(CAMERA)])


@pytest.mark.parametrize("radius", [0.05, 0.2, 0.5, 25.0])
def test_keyframes_within_the_radius_are_right(dataset: Dataset, radius: float) -> None:
    (task,) = StreetPlaces(dataset, radius).tasks()
    queries, gallery = centres(dataset, "winter"), centres(dataset, "summer")
    near = np.linalg.norm(queries[:, None] - gallery, axis=-1) <= radius
    assert [task.relevance.of(q).tolist() for q in range(6)] == [np.flatnonzero(row).tolist() for row in near]
    assert (task.name, task.condition_query, task.condition_gallery) == (
        ACROSS,
        "snow, winter, day",
        "sunny, summer, day",
    )
    assert (
        task.queries[2].key
        == f"traversals/winter/images/{CAMERA}/{dataset.traversal('winter').timestamps(CAMERA)[2]}.png"
    )
    assert (dataset.root / task.queries[2].key).exists()
    assert task.queries[0].image.shape == (72, 96, 3)


def test_a_heading_limit_asks_for_the_same_view(dataset: Dataset) -> None:
    """Both drives are 2 degrees apart in yaw."""
    assert StreetPlaces(dataset, 25.0, 2.5).tasks()[0].relevance.positives.tolist() == [6] * 6
    assert StreetPlaces(dataset, 25.0, 2.0).tasks()[0].relevance.positives.tolist() == [6] * 6
    assert StreetPlaces(dataset, 25.0, 1.5).tasks()[0].relevance.positives.tolist() == [0] * 6


def test_positives_by_pairs_are_the_pairs_of_the_set(dataset: Dataset) -> None:
    (task,) = StreetPlaces(dataset, rule="pairs").tasks()
    pairs = dataset.pair_set(ACROSS).pairs
    found = {
        (int(Path(task.gallery[g].key).stem), int(Path(task.queries[q].key).stem))
        for q in range(len(task.queries))
        for g in task.relevance.of(q)
    }
    assert found == {p.key for p in pairs}


def test_only_queries_of_pairs_are_asked_by_pairs(tmp_path: Path) -> None:
    few = make_small_dataset(tmp_path / "few", frames=5, pairs=3)
    notes = Notes()
    opened = open_set(few.root, tmp_path / "out", SetOptions(positives="pairs"), notes)
    assert [len(t.queries) for t in opened.chosen] == [3]
    assert noted(notes.notes, "2 of 5")


def test_every_choice_of_what_is_right_is_a_set_of_its_own(dataset: Dataset) -> None:
    sets = [
        StreetPlaces(dataset),
        StreetPlaces(dataset, 10.0),
        StreetPlaces(dataset, 25.0, 40.0),
        StreetPlaces(dataset, rule="pairs"),
    ]
    assert [s.name for s in sets] == [
        "small.places-25m",
        "small.places-10m",
        "small.places-25m-40deg",
        "small.places-pairs",
    ]
    assert len({s.fingerprint for s in sets} | {dataset.fingerprint}) == 5
    assert StreetPlaces(dataset, 25.0).fingerprint == sets[0].fingerprint
    assert StreetPlaces(dataset, 10.0, rule="pairs").fingerprint == sets[3].fingerprint


def test_a_traversal_is_not_asked_about_itself(dataset: Dataset, tmp_path: Path) -> None:
    notes = Notes()
    opened = open_set(dataset.root, tmp_path, SetOptions(split="all"), notes)
    assert [t.name for t in opened.chosen] == [ACROSS]
    assert any(WITHIN in note for note in notes.notes)
    with refused(ConfigError, "", None, WITHIN):
        open_set(dataset.root, tmp_path, SetOptions(tasks=(WITHIN,)), notes)


def test_queries_without_a_pose_are_told_and_not_asked(tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "d", frames=4)
    poses = made.layout.traversal("winter").poses
    lines = poses.read_text().splitlines(keepends=True)
    poses.write_text("".join(lines[:-1]))
    places = StreetPlaces(Dataset(made.root))
    assert len(places.tasks()[0].queries) == 3
    poses.write_text(lines[0])
    with refused(DatasetError, "", None, "cam0"):
        StreetPlaces(Dataset(made.root)).tasks()


def test_drives_in_different_worlds_are_refused_by_radius_alone(tmp_path: Path) -> None:
    fault = np.eye(4)
    fault[0, 3] = 30.0
    made = make_small_dataset(tmp_path / "d", frames=4, pose_fault=fault)
    with refused(DatasetError, made.layout.pair_file(ACROSS), None, "30.0 m", "--positives"):
        StreetPlaces(made).tasks()
    assert len(StreetPlaces(made, rule="pairs").tasks()[0].queries) == 4


def test_options_that_contradict_each_other_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    for options, names in (
        (SetOptions(positives="pairs", radius_m=3.0), ("--radius",)),
        (SetOptions(positives="pairs", heading_deg=3.0), ("--heading", "--positives")),
        (SetOptions(radius_m=-3.0), ("--radius", "-3.0")),
        (SetOptions(heading_deg=200.0), ("--heading", "200.0")),
        (SetOptions(by_condition=True), ("--by-condition",)),
        (SetOptions(split="absent"), ("absent",)),
        (SetOptions(tasks=("absent",)), ("absent",)),
    ):
        with refused((ConfigError, DatasetError), "", None, *names):
            open_set(dataset.root, tmp_path, options, Silent())

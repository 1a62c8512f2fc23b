"""``build-dataset photographs``: datasets of single photographs, and what cannot be made into one."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import relocbench
from killing import Fault, run_until_killed
from refusals import Notes, assert_names, refused

from relocbench.datasets.checks.validation import validate_dataset
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.single_photographs import dataset as importer
from relocbench.datasets.learning.training_pairs import DatasetPairs
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.geometry import rotation_angle
from relocbench.progress import Silent

SMALL = {"size": "80x60", "correspondences": 60}
COMMAND = ("--size", "80x60", "--correspondences", "60", "-q")


def write_photographs(folder: Path, count: int, size: tuple[int, int] = (160, 120), seed: int = 0) -> Path:
    """Smooth noise with sharp marks."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        image = cv2.GaussianBlur(rng.uniform(0, 255, size=(size[1], size[0], 3)), (0, 0), 3.0)
        image = np.clip(128 + 6 * (image - image.mean()), 0, 255).astype(np.uint8)
        for u, v in rng.integers(10, (size[0] - 10, size[1] - 10), size=(25, 2)).tolist():
            cv2.rectangle(image, (u, v), (u + 6, v + 5), rng.integers(0, 256, size=3).tolist(), -1)
        cv2.imwrite(str(folder / f"street{number:02d}.png"), image)
    return folder


def built(sources: list[Path], out: Path, workers: int = 0, notes: Silent | None = None, **options: object) -> Dataset:
    chosen = importer.Options.model_validate({**SMALL, **options})
    return importer.build(sources, chosen, out, notes or Silent(), Run(workers=workers))


def content(root: Path) -> Mapping[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


@pytest.mark.thorough
def test_a_dataset_of_photographs_is_valid_and_can_be_learnt_from(tmp_path: Path) -> None:
    source = write_photographs(tmp_path / "streets", 5)
    dataset = built([source], tmp_path / "set", licence="CC0-1.0", keyframes=2, changes=("none", "night"), test=0.2)
    found = validate_dataset(dataset.root, Silent())
    assert not found.faults
    assert dataset.file.licence == "CC0-1.0"
    assert dataset.splits == {
        "train": ("train__train-unchanged__photo", "train__train-night__photo"),
        "validation": ("validation__validation-unchanged__photo", "validation__validation-night__photo"),
        "test": ("test__test-unchanged__photo", "test__test-night__photo"),
    }
    assert str(dataset.traversal("train").condition) == "photograph"
    assert str(dataset.traversal("train-night").condition) == "photograph, darkened"
    assert dataset.traversal("train").file.source == "3 photographs, made-up depth and motion"
    assert sorted(set(dataset.traversal("train").names.values())) == [
        f"street{n:02d}.png@{k}" for n in range(3) for k in (1, 2)
    ]
    learnt = DatasetPairs([dataset.root], "train")
    assert len(learnt) == 12
    pair = learnt.load(0)
    assert pair.image_ref.shape == pair.image_query.shape == (60, 80, 3)
    assert len(pair.u_ref) > 20
    for pair_set in dataset.pair_sets():
        for one in pair_set.pairs:
            drives = dataset.traversal(pair_set.reference), dataset.traversal(pair_set.query)
            T_world_ref = drives[0].T_world_cam("photo", one.ref_timestamp_ns)
            T_world_query = drives[1].T_world_cam("photo", one.query_timestamp_ns)
            assert one.T_query_ref is not None
            assert np.allclose(T_world_query @ one.T_query_ref, T_world_ref, atol=1e-6)


def test_no_photograph_is_in_two_splits_and_neighbours_by_name_stay_together(tmp_path: Path) -> None:
    first = write_photographs(tmp_path / "a", 6)
    second = write_photographs(tmp_path / "b", 4, seed=1)
    (second / "deeper").mkdir()
    (second / "deeper" / "again.png").write_bytes((first / "street02.png").read_bytes())
    notes = Notes()
    dataset = built([first, second], tmp_path / "set", notes=notes, validation=0.3, test=0.2, changes=("exposure",))
    names = {split: set(dataset.traversal(split).names.values()) for split in ("train", "validation", "test")}
    assert names == {
        "train": {*(f"a/street{n:02d}.png" for n in range(3)), "b/street00.png", "b/street01.png"},
        "validation": {"a/street03.png", "a/street04.png", "b/street02.png"},
        "test": {"a/street05.png", "b/street03.png"},
    }
    (told,) = notes.notes
    assert_names(told, "", None, 1, 11)


def test_made_up_weather_has_no_correspondences_on_what_it_takes_for_sky(tmp_path: Path) -> None:
    path = write_photographs(tmp_path / "streets", 1) / "street00.png"
    image = cv2.imread(str(path))
    assert image is not None
    image[:50] = (230, 160, 110)
    cv2.imwrite(str(path), image)
    dataset = built([path.parent], tmp_path / "set", validation=0, changes=("none", "fog"), surfaces=("plane",))
    learnt = DatasetPairs([dataset.root], "train")
    on_sky = {}
    for index in range(len(learnt)):
        pair = learnt.load(index)
        u, v = np.rint(pair.u_ref).astype(int).T
        on_sky[pair.label.condition_query] = np.mean(
            np.all(np.abs(pair.image_ref[v, u] - [110.0, 160, 230]) < 9, axis=1)
        )
    assert on_sky["photograph"] > 0.15
    assert on_sky["photograph, made-up fog"] < 0.02


@pytest.mark.thorough
def test_the_bytes_depend_on_the_seed_and_on_nothing_else(tmp_path: Path) -> None:
    source = write_photographs(tmp_path / "streets", 8)
    alone, shared = built([source], tmp_path / "1"), built([source], tmp_path / "2", workers=2)
    assert content(alone.root) == content(shared.root)
    other = built([source], tmp_path / "3", seed=1)
    poses = "traversals/train-night/poses.csv"
    assert content(other.root)[poses] != content(alone.root)[poses]


@pytest.mark.thorough
def test_another_photograph_beside_it_does_not_change_a_keyframe(tmp_path: Path) -> None:
    few = built([write_photographs(tmp_path / "few", 3)], tmp_path / "1", validation=0)
    more = built([write_photographs(tmp_path / "more", 4)], tmp_path / "2", validation=0)
    pictures = {name: data for name, data in content(few.root).items() if name.endswith(".png")}
    assert len(pictures) == 3 * 5
    assert pictures.items() <= content(more.root).items()


@pytest.mark.thorough
@pytest.mark.parametrize(
    "path",
    [
        r"pairs/train__train-shading.*\.txt$",
        r"train-night/images/photo/2000000000\.png$",
    ],
)
def test_a_build_that_was_killed_goes_on_where_it_was(tmp_path: Path, path: str) -> None:
    source = write_photographs(tmp_path / "streets", 3)
    out = tmp_path / "set"
    command = [sys.executable, "-m", "relocbench", "build-dataset", "photographs", source, "-o", out, "-j", 1, *COMMAND]
    run_until_killed(command, Fault(path, 1), tmp_path / "trace")
    assert not (out / "dataset.yaml").exists()
    kept = {p: p.stat().st_mtime_ns for p in out.rglob("*.png")}
    assert relocbench(*command[3:]).status == 0
    assert {p: p.stat().st_mtime_ns for p in kept if p.exists() and ".part" not in p.name}.items() <= kept.items()
    whole = built([source], tmp_path / "whole")
    assert content(out) == content(whole.root)


def test_a_folder_that_has_changed_is_not_mixed_with_what_was_made_of_it(tmp_path: Path) -> None:
    source = write_photographs(tmp_path / "streets", 3)
    built([source], tmp_path / "set")
    write_photographs(source, 3, seed=4)
    told = relocbench("build-dataset", "photographs", source, "-o", tmp_path / "set", *COMMAND)
    assert told.status == 2
    assert_names(told.complaint, "set", None, "photographs")


def truncated(folder: Path) -> None:
    path = folder / "street01.png"
    path.write_bytes(path.read_bytes()[:-40])


@pytest.mark.parametrize(
    ("spoil", "place", "names"),
    [
        (lambda folder: [path.unlink() for path in folder.iterdir()], "streets", ()),
        (lambda folder: (folder / "street01.png").write_text("hello world"), "street01.png", ()),
        (truncated, "street01.png", ()),
        (lambda folder: write_photographs(folder / "x", 1, (99, 75)), "street00.png", ("99x75",)),
        (lambda folder: [(folder / f"street0{n}.png").unlink() for n in (1, 2)], "", ("train",)),
    ],
)
def test_what_is_no_photograph_is_refused(
    spoil: Callable[[Path], object], place: str, names: tuple[str, ...], tmp_path: Path
) -> None:
    source = write_photographs(tmp_path / "streets", 3)
    spoil(source)
    with refused((DatasetError, ConfigError), place, None, *names):
        built([source], tmp_path / "set")
    assert not (tmp_path / "set" / "build.yaml").exists()


@pytest.mark.parametrize(
    ("option", "value"), [("--size", "12"), ("--changes", "dusk"), ("--surfaces", "plane,plane"), ("--validation", "1")]
)
def test_options_that_mean_nothing_are_one_line(option: str, value: str, tmp_path: Path) -> None:
    source = write_photographs(tmp_path / "streets", 2)
    done = relocbench("build-dataset", "photographs", source, "-o", tmp_path / "set", "-q", option, value)
    assert done.status == 2
    assert_names(done.complaint, "", None, option.strip("-"))


def test_folders_are_there_and_have_names_of_their_own(tmp_path: Path) -> None:
    done = relocbench("build-dataset", "photographs", tmp_path / "none", "-o", tmp_path / "set", *COMMAND)
    assert done.status == 2
    assert_names(done.complaint, tmp_path / "none")
    folders = [write_photographs(tmp_path / part / "a", 1) for part in "xy"]
    with refused(ConfigError, "", None, "a, a"):
        built(folders, tmp_path / "set")


@pytest.mark.thorough
def test_sift_finds_the_poses_of_pairs_of_real_photographs_to_a_fraction_of_a_pixel(
    tmp_path: Path, real_data: Callable[[str], Path]
) -> None:
    walk = real_data("photographs_train") / "ie_tower"
    folder = tmp_path / "photographs"
    folder.mkdir()
    for path in sorted(walk.glob("*.jpg"))[5::120]:
        (folder / path.name).symlink_to(path)
    dataset = built([folder], tmp_path / "set", size="512x384", changes=("none",), validation=0, keyframes=2)
    from baselines.feature_pnp.tracker import SiftPnp

    tracker, errors_px = SiftPnp(), []
    for pair_set in dataset.pair_sets():
        for pair in pair_set.pairs:
            reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
            answer = tracker.track(tracker.prepare(reference), query)
            if answer.T_query_ref is None:
                continue
            assert pair.T_query_ref is not None
            assert reference.depth is not None
            difference = answer.T_query_ref @ np.linalg.inv(pair.T_query_ref)
            depth = float(np.median(reference.depth))
            angle = rotation_angle(difference[:3, :3]) + np.linalg.norm(difference[:3, 3]) / depth
            errors_px.append(angle * reference.camera.fx)
    assert len(errors_px) >= 4
    assert np.median(errors_px) < 1.0

"""A blind export asks the same and tells no time, no pose, no name and no order, and its keys need the salt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from forgery import change_yaml
from refusals import Notes, assert_names, refused
from small_dataset import ACROSS, make_small_dataset
from submissions import SALT_TEXT, blind_export, salt, salt_file, submit

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.salt import read_salt, without_salt
from relocbench.datasets.core.schema import Condition
from relocbench.errors import ConfigError, DatasetError
from relocbench.evaluation.common.blind_names import blind_name
from relocbench.evaluation.submission.check import check_submission
from relocbench.evaluation.submission.contract import SubmissionOptions
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.geometry import make_transform
from relocbench.progress import Silent

OTHER_TEXT = "c3" * 32


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("town") / "ds", frames=4, size=(48, 36))


@pytest.fixture(scope="module")
def blind(town: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return blind_export(town, tmp_path_factory.mktemp("blind") / "b")


@pytest.fixture(scope="module")
def keys(town: Dataset) -> BlindKeys:
    return BlindKeys(town, salt())


def test_the_same_pairs_are_asked_of_the_same_pixels(town: Dataset, blind: Dataset, keys: BlindKeys) -> None:
    assert blind.name == str(keys.name)
    assert {s.name for s in blind.pair_sets()} == {keys.pair_set(s) for s in town.pair_sets()}
    for pair_set in town.pair_sets():
        theirs = blind.pair_set(keys.pair_set(pair_set))
        assert {p.key for p in theirs.evaluated} == set(keys.pairs(pair_set))
        for pair in theirs.evaluated:
            ref, query = keys.pairs(pair_set)[pair.key]
            ours = town.traversal(pair_set.reference).reference(pair_set.reference_camera, ref)
            reference = blind.reference(theirs, pair)
            assert np.array_equal(reference.image, ours.image)
            assert np.array_equal(reference.inverse_depth_map, ours.inverse_depth_map)
            assert (reference.camera, reference.depth_sigma) == (ours.camera, ours.depth_sigma)
            image = blind.query(theirs, pair).image
            assert np.array_equal(image, town.traversal(pair_set.query).image(pair_set.query_camera, query))


def test_no_file_tells_a_time_a_pose_a_name_or_a_path(town: Dataset, blind: Dataset) -> None:
    times = {str(t) for name in town.traversal_names for t in town.traversal(name).timestamps("cam0")}
    words = {*town.traversal_names, *town.file.splits, "cam0", town.name, "corner", "sunny", "snow", str(town.root)}
    for path in blind.root.rglob("*"):
        assert times.isdisjoint(path.parts)
        assert words.isdisjoint(path.relative_to(blind.root).parts)
        if path.suffix in (".csv", ".txt", ".yaml"):
            text = path.read_text()
            assert not any(word in text for word in times | words), path
    for drive in map(blind.traversal, blind.traversal_names):
        assert (drive.poses, drive.condition, drive.file.location, drive.file.rate_hz) == ({}, Condition(), "", None)
        assert np.array_equal(drive.T_rig_cam("camera1"), np.eye(4))
    assert all(p.T_query_ref is None and not p.group for s in blind.pair_sets() for p in s.evaluated)
    assert relocbench("validate", blind.root, "-q").status == 0


def test_only_keyframes_have_depth(town: Dataset, blind: Dataset, keys: BlindKeys) -> None:
    pair_set = town.pair_set(ACROSS)
    winter, camera = blind.traversal(keys.drives[pair_set.query]), keys.cameras["cam0"]
    asked = {keys.key("winter", "cam0", p.query_timestamp_ns) for p in pair_set.evaluated}
    assert winter.timestamps(camera) == sorted(asked)
    assert winter.keyframe_timestamps(camera) == []


def test_keys_need_the_salt_and_differ_by_edition_and_truth(town: Dataset, keys: BlindKeys, tmp_path: Path) -> None:
    again, second, guess = BlindKeys(Dataset(town.root), salt()), BlindKeys(town, salt(), 2), salt(OTHER_TEXT)
    time = town.traversal("summer").timestamps("cam0")[0]
    assert keys.key("summer", "cam0", time) == again.key("summer", "cam0", time)
    for other in (second, BlindKeys(town, guess)):
        assert keys.key("summer", "cam0", time) != other.key("summer", "cam0", time)
        assert keys.name.id != other.name.id
    assert keys.key("summer", "cam0", time) != keys.key("winter", "cam0", time)
    fault = make_transform(np.eye(3), [0.2, 0.0, 0.0])
    moved = make_small_dataset(tmp_path / "other", frames=4, size=(48, 36), pose_fault=fault)
    assert BlindKeys(moved, salt()).name.id != keys.name.id


def test_an_export_goes_on_and_ends_with_the_same_bytes(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    blind_export(town, tmp_path / "b")
    (tmp_path / "b" / "dataset.yaml").unlink()
    image = next((tmp_path / "b").glob("traversals/*/images/*/*.png"))
    image.write_bytes(image.read_bytes()[:40])
    assert blind_export(town, tmp_path / "b").fingerprint == blind.fingerprint
    with refused(DatasetError, tmp_path / "b", None, "options"):
        blind_export(town, tmp_path / "b", 2)


def test_the_name_is_that_of_an_export() -> None:
    found = blind_name("blind12-0123456789abcdef")
    assert found is not None
    assert (found.edition, found.id, str(found)) == (12, "0123456789abcdef", "blind12-0123456789abcdef")
    assert blind_name("town") is blind_name("blind1-0123") is blind_name("town.blind1-0123456789ab") is None


@pytest.mark.parametrize("made_by", [{"kind": "synthetic"}, {"kind": "cross-view"}, {"kind": "photographs"}])
def test_what_follows_from_a_seed_is_exported_with_the_salt_that_it_was_built_with(
    tmp_path: Path, made_by: dict[str, str]
) -> None:
    town = make_small_dataset(tmp_path / "ds", frames=4, size=(48, 36))
    change_yaml(town.root / "dataset.yaml", lambda file: file.update(made_by=made_by))
    with refused(DatasetError, town.root, None, town.name, "--salt-file"):
        blind_export(Dataset(town.root), tmp_path / "b")
    change_yaml(town.root / "dataset.yaml", lambda file: file["made_by"].update(salt=salt(OTHER_TEXT).check))
    with refused(ConfigError, salt().path, None, town.name):
        blind_export(Dataset(town.root), tmp_path / "b")
    assert not (tmp_path / "b").exists()
    change_yaml(town.root / "dataset.yaml", lambda file: file["made_by"].update(salt=salt().check))
    assert blind_export(Dataset(town.root), tmp_path / "b").name


def test_answers_need_the_salt_of_the_export(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", blind)
    with refused(ConfigError, "", None, blind.name, "--salt-file"):
        check_submission(root, SubmissionOptions((town.root,)), Silent())
    with refused(ConfigError, salt(OTHER_TEXT).path, None, blind.name, town.name):
        check_submission(root, SubmissionOptions((town.root,), salt=salt(OTHER_TEXT)), Silent())


def test_answers_to_an_export_of_an_earlier_version_are_refused_by_name(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    earlier = f"{town.name}.blind1-0123456789ab"
    (root / town.name).rename(root / earlier)
    change_yaml(root / "card.yaml", lambda card: card.update(datasets={earlier: card["datasets"][town.name]}))
    checked = check_submission(root, SubmissionOptions((town.root,), salt=salt()), Silent())
    (fault,) = checked.found.faults
    assert_names(str(fault), root / "card.yaml", fault.line, earlier, "--salt-file")


SALTS = {"short": "0" * 31 + "\n", "empty": "", "no text": b"\xff" * 64, "long": "0" * 5000}


@pytest.mark.parametrize("content", SALTS.values(), ids=SALTS.keys())
def test_what_is_no_salt_is_refused_by_file(tmp_path: Path, content: str | bytes) -> None:
    path = tmp_path / "salt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with refused(ConfigError, path, None):
        read_salt(path, [], Silent())


def test_a_salt_is_read_without_white_space_and_from_no_folder_that_is_given_away(tmp_path: Path) -> None:
    path = salt_file(tmp_path)
    assert read_salt(path, [tmp_path / "other"], Silent()).check == salt().check
    assert SALT_TEXT not in repr(read_salt(path, [], Silent()))
    with refused(ConfigError, path, None, str(tmp_path)):
        read_salt(path, [tmp_path], Silent())
    with refused(ConfigError, tmp_path / "none", None):
        read_salt(tmp_path / "none", [], Silent())


def test_a_seed_becomes_another_by_salt_split_and_seed_and_is_named_as_before() -> None:
    seeds = [of.seed(split, n) for of in (salt(), salt(OTHER_TEXT)) for split in ("train", "test") for n in (0, 1)]
    assert len({seed >> 64 for seed in seeds}) == len(seeds)
    assert [without_salt(seed) for seed in seeds] == [0, 1] * 4


def test_who_else_can_read_the_salt_is_told(tmp_path: Path) -> None:
    told = Notes()
    path = salt_file(tmp_path)
    read_salt(path, [], told)
    assert told.notes == []
    path.chmod(0o644)
    read_salt(path, [], told)
    assert [str(path) in note for note in told.notes] == [True]


def test_what_cannot_be_exported_is_refused(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    with refused(DatasetError, blind.root, None, blind.pair_sets()[0].name, "withheld"):
        blind_export(blind, tmp_path / "b")
    with refused(ConfigError, town.root / "b", None, "--out"):
        blind_export(town, town.root / "b")
    asked = ("export", "-d", town.root, "-o", tmp_path / "t")
    given = ("--salt-file", salt_file(tmp_path))
    for options, named in (
        (("-f", "tum", "--edition", 2), "--format blind"),
        (("-f", "tum", *given), "--salt-file"),
        (("-f", "blind"), "--salt-file"),
        (("-f", "blind", "-m", "x", *given), "--method"),
    ):
        outcome = relocbench(*asked, *options)
        assert outcome.status == 2
        assert_names(outcome.complaint, "", None, named)
    assert not (tmp_path / "t").exists()


def test_files_were_written_in_the_order_of_their_keys(blind: Dataset) -> None:
    for kind in ("images", "depth"):
        files = sorted(blind.root.glob(f"traversals/*/{kind}/*/*.png"), key=lambda path: path.stat().st_mtime_ns)
        assert [int(path.stem) for path in files] == sorted(int(path.stem) for path in files) != []

"""A blind export asks the same and tells no time, no pose and no order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from refusals import assert_names, refused
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import ConfigError, DatasetError
from relocbench.evaluation.common.blind_names import blind_name
from relocbench.evaluation.tracking.blind_export import export_blind
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.geometry import make_transform
from relocbench.progress import Silent


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("town") / "ds", frames=4, size=(48, 36))


@pytest.fixture(scope="module")
def blind(town: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return export_blind(town, tmp_path_factory.mktemp("blind") / "b", 1, Silent())


def test_the_same_pairs_are_asked_of_the_same_pixels(town: Dataset, blind: Dataset) -> None:
    keys = BlindKeys(town)
    assert blind.name == str(keys.name)
    for pair_set in town.pair_sets():
        theirs = blind.pair_set(pair_set.name)
        assert {p.key for p in theirs.evaluated} == set(keys.pairs(pair_set))
        for shown, (ref, query) in keys.pairs(pair_set).items():
            ours = town.traversal(pair_set.reference).reference(pair_set.camera, ref)
            reference = blind.traversal(pair_set.reference).reference(pair_set.camera, shown[0])
            assert np.array_equal(reference.image, ours.image)
            assert np.array_equal(reference.inverse_depth_map, ours.inverse_depth_map)
            image = blind.traversal(pair_set.query).image(pair_set.camera, shown[1])
            assert np.array_equal(image, town.traversal(pair_set.query).image(pair_set.camera, query))


def test_no_file_tells_a_time_a_pose_or_a_path(town: Dataset, blind: Dataset) -> None:
    times = {str(t) for name in town.traversal_names for t in town.traversal(name).timestamps("cam0")}
    for path in blind.root.rglob("*"):
        assert path.stem not in times
        if path.suffix in (".csv", ".txt", ".yaml"):
            text = path.read_text()
            assert not any(time in text for time in times), path
            assert str(town.root) not in text
    assert all(not blind.traversal(name).poses for name in blind.traversal_names)
    assert all(p.T_query_ref is None and not p.group for s in blind.pair_sets() for p in s.evaluated)
    assert relocbench("validate", blind.root, "-q").status == 0


def test_only_keyframes_have_depth(town: Dataset, blind: Dataset) -> None:
    keys, pair_set = BlindKeys(town), town.pair_set(ACROSS)
    winter = blind.traversal(pair_set.query)
    assert winter.timestamps("cam0") == sorted({keys.key("winter", p.query_timestamp_ns) for p in pair_set.evaluated})
    assert winter.keyframe_timestamps("cam0") == []


def test_keys_need_the_truth_and_differ_by_edition_and_truth(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    first, again, second = BlindKeys(town), BlindKeys(Dataset(town.root)), BlindKeys(town, 2)
    time = town.traversal("summer").timestamps("cam0")[0]
    assert first.key("summer", time) == again.key("summer", time)
    assert first.key("summer", time) != second.key("summer", time)
    assert first.key("summer", time) != first.key("winter", time)
    assert first.name != second.name
    other = make_small_dataset(
        tmp_path / "other", frames=4, size=(48, 36), pose_fault=make_transform(np.eye(3), [0.2, 0.0, 0.0])
    )
    assert BlindKeys(other).name.id != first.name.id
    with refused(DatasetError, blind.root, None, blind.pair_sets()[0].name, "withheld"):
        BlindKeys(blind)


def test_an_export_goes_on_and_ends_with_the_same_bytes(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    export_blind(town, tmp_path / "b", 1, Silent())
    (tmp_path / "b" / "dataset.yaml").unlink()
    image = next((tmp_path / "b").glob("traversals/*/images/*/*.png"))
    image.write_bytes(image.read_bytes()[:40])
    assert export_blind(town, tmp_path / "b", 1, Silent()).fingerprint == blind.fingerprint


def test_the_name_says_what_it_is_of() -> None:
    found = blind_name("town.north.blind12-0123456789ab")
    assert found is not None
    assert (found.dataset, found.edition, found.id) == ("town.north", 12, "0123456789ab")
    assert str(found) == "town.north.blind12-0123456789ab"
    assert blind_name("town") is blind_name("town.blind1-0123") is None


def test_what_cannot_be_exported_is_refused(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    with refused(ConfigError, blind.root, None, blind.name, "already"):
        export_blind(blind, tmp_path / "b", 1, Silent())
    with refused(ConfigError, town.root / "b", None, "--out"):
        export_blind(town, town.root / "b", 1, Silent())
    outcome = relocbench("export", "-d", town.root, "-f", "tum", "--edition", 2, "-o", tmp_path / "t")
    assert (outcome.status, "--format blind" in outcome.complaint) == (2, True)
    outcome = relocbench("export", "-d", town.root, "-f", "blind", "-m", "x", "-o", tmp_path / "t")
    assert outcome.status == 2
    assert_names(outcome.complaint, "", None, "--edition")
    assert not (tmp_path / "t").exists()

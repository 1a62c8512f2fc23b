"""Pair sets of two cameras: their names, and that every part takes each side from its own camera."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import relocbench
from forgery import change_yaml
from submissions import answer, blind_export, salt
from two_cameras import ACROSS, BACK, RIG, SAME, make_two_cameras

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import pair_set_name, pair_set_parts
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.learning.training_pairs import DatasetPairs
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.datasets.pairs.visibility import warp
from relocbench.evaluation.common.results import dataset_record
from relocbench.evaluation.retrieval.records import TaskRecord
from relocbench.evaluation.tracking.absolute_poses import query_poses
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.evaluation.tracking.colmap_export import export_colmap
from relocbench.evaluation.tracking.exports import export_hloc, truth_lines
from relocbench.evaluation.tracking.kapture_export import export_kapture
from relocbench.leaderboard.retrieval.board import is_part
from relocbench.progress import Silent


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_two_cameras(tmp_path_factory.mktemp("two") / "ds")


def test_names_tell_the_cameras() -> None:
    assert pair_set_name("a", "b", "c") == pair_set_name("a", "b", "c", "c") == "a__b__c"
    assert pair_set_name("a", "b", "c", "d") == "a__b__c__d"
    assert pair_set_parts("a__b__c") == ("a", "b", "c", "c")
    assert pair_set_parts("a__b__c__d") == ("a", "b", "c", "d")
    for name in ("a__b", "a__b__c__c", "a__b__c__d__e"):
        with pytest.raises(ValueError, match="REF__QUERY__REFCAM__QUERYCAM"):
            pair_set_parts(name)


@pytest.mark.thorough
def test_a_dataset_with_them_has_a_format_of_its_own_and_is_sound(two: Dataset, tmp_path: Path) -> None:
    assert two.file.format_version == 5
    assert relocbench("validate", two.root, "--quiet").status == 0
    copy = tmp_path / "copy"
    shutil.copytree(two.root, copy)
    change_yaml(copy / "dataset.yaml", lambda values: values.update(format_version=4))
    told = relocbench("validate", copy, "--quiet")
    assert told.status != 0
    assert "names two cameras, which format_version 5 has; this dataset's is 4" in told.out + told.err


def test_keyframe_and_query_are_seen_by_their_cameras(two: Dataset) -> None:
    for name, cameras in ((SAME, ("near", "near")), (ACROSS, ("near", "far")), (BACK, ("far", "near"))):
        pair_set = two.pair_set(name)
        pair = pair_set.pairs[1]
        reference, query = two.reference(pair_set, pair), two.query(pair_set, pair)
        assert (reference.camera, query.camera) == tuple(RIG[c][0] for c in cameras)
        known = read_correspondences(two.layout.correspondence_file(name), pair.key)
        seen = two.traversal(pair_set.query).image(cameras[1], pair.query_timestamp_ns)
        assert np.array_equal(query.image, seen)
        assert pair.T_query_ref is not None
        points = np.column_stack([known.uv_ref, known.depth_ref])
        uv, _, _ = warp(points, reference.camera, query.camera, pair.T_query_ref)
        np.testing.assert_allclose(uv, known.uv_query, atol=1e-3)


def true_pose(pair: Pair) -> Array:
    assert pair.T_query_ref is not None
    return pair.T_query_ref


def test_a_true_answer_is_right_and_the_record_names_both_cameras(two: Dataset, tmp_path: Path) -> None:
    for pair_set in two.pair_sets():
        answer(tmp_path / "given", pair_set, pose=true_pose)
    words = ("--dataset", two.root, "--out", tmp_path / "results", "--quiet")
    told = relocbench("evaluate", "--predictions", tmp_path / "given", *words)
    assert told.status == 0, told.err
    errors = {path.name[: -len(".errors.csv")]: pd.read_csv(path) for path in tmp_path.glob("results/*/*/*.errors.csv")}
    assert set(errors) == {SAME, ACROSS, BACK}
    for table in errors.values():
        assert len(table) == 4
        assert table["translation_error_m"].max() < 1e-6
        assert table["vcre"].max() < 1e-6
    records = dataset_record(two).model_dump()["pair_sets"]
    assert "reference_camera" not in records[SAME]
    assert (records[ACROSS]["reference_camera"], records[ACROSS]["camera"]) == ("near", "far")


def test_a_blind_export_asks_the_same_of_the_same_images(two: Dataset, tmp_path: Path) -> None:
    keys, blind = BlindKeys(two, salt()), blind_export(two, tmp_path / "blind")
    assert blind.file.format_version == 5
    for pair_set in two.pair_sets():
        theirs = blind.pair_set(keys.pair_set(pair_set))
        for key, times in keys.pairs(pair_set).items():
            shown, pair = theirs.by_key[key], pair_set.by_key[times]
            assert np.array_equal(blind.query(theirs, shown).image, two.query(pair_set, pair).image)
            reference, ours = blind.reference(theirs, shown), two.reference(pair_set, pair)
            assert np.array_equal(reference.image, ours.image)
            assert np.array_equal(reference.inverse_depth_map, ours.inverse_depth_map)


def test_exports_put_each_side_at_its_camera(two: Dataset, tmp_path: Path) -> None:
    for name in (ACROSS, BACK):
        pair_set, lines = two.pair_set(name), truth_lines(two, name)
        drive = two.traversal(pair_set.query)
        for pose in query_poses(two, name, lines):
            expected = drive.T_world_cam(pair_set.query_camera, pose.query_timestamp_ns)
            np.testing.assert_allclose(pose.T_world_query, expected, atol=2e-8)
        of_keyframes, of_queries = pair_set.cameras
        assert export_colmap(two, name, lines, tmp_path / name / "colmap") == 4
        images = (tmp_path / name / "colmap" / "images.txt").read_text()
        assert images.count(f"/{of_keyframes}/") == images.count(f"/{of_queries}/") == 4
        assert export_kapture(two, name, lines, tmp_path / name / "kapture", Silent()) == 4
        export_hloc(two, name, lines, tmp_path / name / "hloc")
        for table in ("kapture/pairs.txt", "hloc/pairs.txt"):
            rows = [row for row in (tmp_path / name / table).read_text().splitlines() if not row.startswith("#")]
            assert len(rows) == 4
            for row in rows:
                asked, keyframe = row.replace(",", " ").split()[:2]
                assert f"/{of_queries}/" in asked
                assert f"/{of_keyframes}/" in keyframe


def test_training_and_places_take_each_image_from_its_camera(two: Dataset) -> None:
    pairs = DatasetPairs([two.root])
    shapes = set()
    for index in range(len(pairs)):
        pair, label = pairs.load(index), pairs.label(index)
        shapes.add((label.camera_ref or label.camera, label.camera))
        for image, camera in ((pair.image_ref, label.camera_ref or label.camera), (pair.image_query, label.camera)):
            assert image.shape[:2] == (RIG[camera][0].height, RIG[camera][0].width)
    assert shapes == {("near", "near"), ("near", "far"), ("far", "near")}
    task = StreetPlaces(two, radius_m=5.0).task(two.pair_set(ACROSS))
    assert all("/near/" in view.key for view in task.gallery)
    assert all("/far/" in view.key for view in task.queries)


@pytest.mark.thorough
def test_inspection_pages_and_pictures_are_made(two: Dataset, tmp_path: Path) -> None:
    told = relocbench("inspect", two.root, "--pictures", tmp_path / "inspected", "--pairs", 1, "--quiet")
    assert told.status == 0, told.err
    words = ("--dataset", two.root, "--out", tmp_path / "results", "--quiet", "--workers", 1)
    assert relocbench("evaluate", "--method", "identity,orb-pnp", *words).status == 0
    site = ("--dataset", two.root, "--html", "--out", tmp_path / "site", "--quiet")
    told = relocbench("leaderboard", tmp_path / "results", *site)
    assert told.status == 0, told.err
    folders = {path.name for path in (tmp_path / "site").glob("**/images/*/*") if path.is_dir()}
    assert {re.sub(r"^.*__", "", name) for name in folders} >= {"near", "far"}


def test_a_set_across_cameras_is_no_part_of_the_set_of_its_first_camera() -> None:
    """Tasks of cross-view sets have parts by condition, whose names begin with the whole one's."""

    def task(query: str, gallery: str) -> TaskRecord:
        return TaskRecord(
            queries=1, gallery=1, without_positives=0, most_positives=1, view_query=query, view_gallery=gallery
        )

    along_streets = dict.fromkeys((SAME, ACROSS), task("street", "street"))
    assert not any(is_part(name, along_streets) for name in along_streets)
    across_views = dict.fromkeys(("drone-satellite", "drone-satellite__Rain"), task("drone", "satellite"))
    assert [is_part(name, across_views) for name in across_views] == [False, True]

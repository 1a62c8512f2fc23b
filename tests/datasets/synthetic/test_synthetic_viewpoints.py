"""Viewpoints that were asked for: distances and angles of pairs, other lanes and directions, other cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import relocbench
from refusals import assert_names

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.pairs.posed_frames import PosedFrames
from relocbench.datasets.synthetic.conditions.presets import conditions_of
from relocbench.datasets.synthetic.drives.drive import DriveStyle
from relocbench.datasets.synthetic.drives.routes import RouteName
from relocbench.datasets.synthetic.jobs.pairs import DistanceSpread, drawn_pairs, nearest_miss
from relocbench.datasets.synthetic.jobs.plan import AskedDrives, TraversalPlan, evaluated_drives, make_plans
from relocbench.geometry import apply, invert, make_transform, so3_exp
from relocbench.progress import Silent

SMOKE = ("build-dataset", "synthetic", "--preset", "smoke")
SQUARE = np.ones((3, 3), np.uint8)


def turning(first_deg: float, per_frame_deg: float) -> PosedFrames:
    """A hundred frames, half a metre apart along a line, each turned further."""
    turns = np.radians(first_deg + per_frame_deg * np.arange(100))
    poses = np.array([make_transform(so3_exp([0, 0, a]), [0.5 * i, 0, 0]) for i, a in enumerate(turns)])
    return PosedFrames(tuple(range(100)), poses, frozenset(range(100)))


def test_pairs_have_the_distances_and_angles_that_were_asked_for() -> None:
    frames = turning(0.0, 0.0), turning(12.0, 0.4)
    spread = DistanceSpread(1.6, 12.0, 40.0, min_m=8.0, min_angle_deg=20.0)
    pairs = drawn_pairs(*frames, spread, np.random.default_rng(0), same_traversal=False)
    distances = np.array([p.distance_m or 0.0 for p in pairs])
    angles = np.array([p.angle_deg or 0.0 for p in pairs])
    assert len(pairs) == 51  # the others are turned by less than 20 or by more than 40 degrees
    assert distances.min() >= 8.0 - 1e-9
    assert distances.max() <= 12.0 + 1e-9
    assert np.histogram(distances, [7.9, 9.25, 10.75, 12.1])[0].min() >= 8
    assert angles.min() >= 20.0
    assert angles.max() <= 40.0


def test_without_a_least_distance_the_draws_are_those_of_before() -> None:
    """Drawn by the version that had no least distance."""
    drawn = DistanceSpread(1.6, 10.0, 30.0).draw(3, np.random.default_rng(5))
    np.testing.assert_allclose(drawn, [2.2239818576083348, 2.234706181041826, 1.4982454070391875], rtol=1e-9)


@pytest.mark.parametrize(
    ("spread", "told"),
    [
        (DistanceSpread(1.6, 90.0, 30.0, min_m=60.0), "is 49.5 m away"),
        (DistanceSpread(1.6, 5.0, 90.0, min_angle_deg=50.0), "is turned by 20 deg"),
        (DistanceSpread(1.6, 5.0, 15.0), "is turned by 20 deg"),
    ],
)
def test_what_came_nearest_is_told(spread: DistanceSpread, told: str) -> None:
    frames = turning(0.0, 0.0), turning(20.0, 0.0)
    assert drawn_pairs(*frames, spread, np.random.default_rng(0), same_traversal=False) == []
    assert nearest_miss([frames], spread, same_traversal=False).endswith(told)


def test_where_keyframes_are_near_enough_but_see_nothing_that_is_told() -> None:
    sides = [(turning(0.0, 0.0), turning(20.0, 0.0))]
    assert "see nothing" in nearest_miss(sides, DistanceSpread(), same_traversal=False)


def planned(*routes: RouteName, traversals: int = 1) -> dict[str, TraversalPlan]:
    conditions = conditions_of(("Neutral", "Rain"), {}, None, 2)
    asked = AskedDrives(("test",), conditions, traversals, 0, routes)
    found = make_plans(asked, 8, DriveStyle(), extent_m=190.0, reporter=Silent())
    return {plan.name: plan for plan in found}


def test_each_condition_is_driven_on_each_route_and_the_first_drive_is_the_map() -> None:
    plans = planned("common", "return", "other-lane")
    assert list(plans) == [
        "test-Neutral-0", "test-Neutral-return-0", "test-Neutral-other-lane-0",
        "test-Rain-0", "test-Rain-return-0", "test-Rain-other-lane-0",
    ]  # fmt: skip
    assert len({plan.times[0] for plan in plans.values()}) == 6
    first = list(planned("return", "common").values())
    drives = evaluated_drives(first, references="first", traversals=1, pair_rule=None)
    assert {reference.name for reference, _ in drives} == {"test-Neutral-return-0"}
    assert len(drives) == 4


def test_a_drive_does_not_depend_on_the_other_routes() -> None:
    alone, two, three = planned("common"), planned("return", "common"), planned("common", "other-lane", "return")
    for plans in (two, three):
        for name, plan in alone.items():
            np.testing.assert_array_equal(plan.drive.T_world_rig, plans[name].drive.T_world_rig)
    for name in ("test-Neutral-return-0", "test-Rain-return-0"):
        np.testing.assert_array_equal(two[name].drive.T_world_rig, three[name].drive.T_world_rig)


def test_drives_on_other_routes_are_in_the_other_lane() -> None:
    plans = planned("common", "return", "other-lane")
    common = plans["test-Neutral-0"].drive.T_world_rig
    for name, way in (("test-Rain-other-lane-0", 1), ("test-Rain-return-0", -1)):
        for T_world_rig in plans[name].drive.T_world_rig:
            T_common_rig = (
                invert(common[np.linalg.norm(common[:, :3, 3] - T_world_rig[:3, 3], axis=1).argmin()]) @ T_world_rig
            )
            assert T_common_rig[0, 0] * way > 0.98
            if abs(T_common_rig[0, 3]) < 1.0:
                assert 3.2 - 2 * 0.6 - 0.2 < T_common_rig[1, 3] < 3.2 + 2 * 0.6 + 0.2


def test_drives_of_one_name_are_refused(tmp_path: Path) -> None:
    config = tmp_path / "config.yaml"
    config.write_text("conditions: [Rain, Rain-return]\nfactors: {Rain-return: {}}\nroute: [common, return]\n")
    told = relocbench(*SMOKE, "--quiet", "--config", config, "--out", tmp_path / "out")
    assert told.status == 2
    assert_names(told.complaint, "", None, "test-Rain-return-0")


def test_the_way_back_is_refused_where_no_camera_looks_there(tmp_path: Path) -> None:
    told = relocbench(*SMOKE, "--quiet", "--steps", "20", "--route", "common,return", "--out", tmp_path / "out")
    assert told.status == 2
    assert_names(told.complaint, "", None, "test-Neutral-0__test-Neutral-return-0__front", "--max-angle", "172 deg")


@pytest.mark.thorough
def test_a_dataset_of_routes_is_sound_and_the_same_by_any_number_of_workers(tmp_path: Path) -> None:
    words = (*SMOKE, "--quiet", "--steps", "12", "--size", "48", "--route", "common,other-lane")
    for workers in (1, 2):
        assert relocbench(*words, "--workers", workers, "--out", tmp_path / f"{workers}").status == 0
    assert relocbench("validate", tmp_path / "1", "--quiet").status == 0
    one, two = (Dataset(tmp_path / name) for name in "12")
    assert one.fingerprint == two.fingerprint
    assert one.file.made_by["options"]["route"] == ["common", "other-lane"]


@pytest.fixture(scope="module")
def around(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Twelve steps there and back, with four cameras that are paired across.

    Without people, whose outlines would leave few places in such small images where depth can be interpolated.
    """
    out = tmp_path_factory.mktemp("around") / "out"
    words = ("--conditions", "Neutral", "--people", 0, "--steps", 12, "--size", "64x48", "--route", "common,return")
    told = relocbench(*SMOKE, *words, "--cameras", "around", "--camera-pairs", "across", "--quiet", "--out", out)
    assert told.status == 0, told.err
    return Dataset(out)


@pytest.mark.thorough
def test_what_the_rear_camera_has_seen_the_front_camera_sees_on_the_way_back(around: Dataset) -> None:
    assert relocbench("validate", around.root, "--quiet").status == 0
    back = [s for s in around.pair_sets() if s.query == "test-Neutral-return-0"]
    assert {s.cameras for s in back} >= {("rear", "front"), ("front", "rear")}
    asked = [(s.query_camera, p.query_timestamp_ns) for s in back for p in s.pairs]
    assert len(asked) == len(set(asked))
    for pair_set in around.pair_sets():
        for pair in pair_set.pairs:
            assert pair.angle_deg is not None
            assert pair.angle_deg <= 30.0
            assert pair.overlap is not None
            if pair_set.query == "test-Neutral-0":  # on the same way each camera sees most of what it has seen
                assert pair_set.reference_camera == pair_set.query_camera


@pytest.mark.thorough
def test_truth_across_cameras_agrees_with_the_depth_of_both(around: Dataset) -> None:
    apart = []
    for pair_set in around.pair_sets():
        query = around.traversal(pair_set.query)
        for pair in pair_set.pairs:
            assert pair.T_query_ref is not None
            known = read_correspondences(around.layout.correspondence_file(pair_set.name), pair.key)
            reference = around.reference(pair_set, pair)
            rays, _ = reference.camera.unproject(known.uv_ref)
            z = apply(pair.T_query_ref, rays * known.depth_ref[:, None])[:, 2]
            depth = query.depth(pair_set.query_camera, pair.query_timestamp_ns)
            assert depth is not None
            # Inverse depth is linear in the image of a plane, so that it can be interpolated.
            inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-6), np.nan).astype(np.float32)
            inverse[cv2.dilate(depth, SQUARE) > 1.1 * cv2.erode(depth, SQUARE)] = np.nan  # leaves and edges
            u, v = known.uv_query[known.visible].T.astype(np.float32)
            off = np.abs(cv2.remap(inverse, u, v, cv2.INTER_LINEAR).ravel() * z[known.visible] - 1)
            off = off[np.isfinite(off)]
            apart.append(off)
            if len(off) > 20:
                assert np.median(off) < 0.003
    assert len(np.concatenate(apart)) > 1000
    assert np.median(np.concatenate(apart)) < 0.001


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (("--camera-pairs", "across"), ("camera_pairs", "front")),
        (("--camera-pairs", "across", "--cameras", "around", "--pair-rule", "nearest"), ("camera_pairs", "nearest")),
        (("--camera-pairs", "across", "--cameras", "around", "--elsewhere", "2"), ("elsewhere", "camera_pairs")),
        (("--camera-pairs", "across", "--recording", "kitti"), ("--camera-pairs", "--recording")),
        (("--min-distance", "12"), ("min_distance", "max_distance")),
        (("--min-angle", "40"), ("min_angle", "max_angle")),
        (("--min-distance", "4", "--distance", "5"), ("--distance", "--min-distance")),
        (("--min-distance", "4", "--pair-rule", "nearest"), ("min_distance", "nearest")),
        (("--min-angle", "4", "--recording", "kitti"), ("--min-angle", "--recording")),
        (("--route", "common,common"), ("--route", "common,common")),
        (("--route", "detour"), ("detour", "--steps")),
    ],
)
def test_mistakes_are_named(tmp_path: Path, options: tuple[str, ...], names: tuple[str, ...]) -> None:
    told = relocbench(*SMOKE, *options, "--quiet", "--out", tmp_path / "out")
    assert told.status == 2
    assert_names(told.complaint, "", None, *names)
    assert not (tmp_path / "out" / "traversals").exists()


def test_a_rule_that_no_pair_meets_is_refused_before_anything_is_rendered(tmp_path: Path) -> None:
    out = tmp_path / "out"
    told = relocbench(*SMOKE, "--min-distance", "8", "--quiet", "--out", out)
    assert told.status == 2
    assert_names(told.complaint, out, None, "test-Neutral-0__test-Neutral-0__front", "--min-distance", "2.41 m")
    assert [path.name for path in out.iterdir()] == ["build.yaml"]

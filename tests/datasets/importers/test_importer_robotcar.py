"""RobotCar recordings become datasets whose truth comes from their lidar, by the command a user types."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from fenced_street import fenced_street_mesh
from refusals import assert_names, refused
from robotcar_street import Built, RobotCarStreet, build_robotcar
from small_street import SolidTexture, Street

from relocbench.datasets.groundtruth.jobs.build import RIG, check_recordings
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.importers.robotcar.recording import read_robotcar_drives
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS
from relocbench.errors import ConfigError, DatasetError


@pytest.mark.thorough
def test_poses_are_those_of_the_exact_truth_to_centimetres(
    robotcar_street: RobotCarStreet, robotcar_built: Built
) -> None:
    pairs = robotcar_built.dataset.pair_set(robotcar_street.pair_set).pairs
    errors = robotcar_street.errors(robotcar_built.dataset)
    assert len(pairs) >= 8
    assert len(errors.translation_error_m) >= 0.8 * len(pairs)
    assert np.median(errors.translation_error_m) < 0.03
    assert errors.translation_error_m.max() < 0.10
    assert errors.rotation_error_deg.max() < 0.15


@pytest.mark.thorough
def test_every_pair_has_its_sigmas_or_its_reason(robotcar_street: RobotCarStreet, robotcar_built: Built) -> None:
    rows = robotcar_built.table(robotcar_street.pair_set)
    assert {row["source"] for row in rows} == {"lidar registration, pose graph"}
    for row in rows:
        if row["accepted"] == "true":
            assert not row["reason"]
            for name in ("sigma_translation_m", "sigma_along_m", "sigma_across_m", "sigma_height_m"):
                assert 0 < float(row[name]) <= 0.05
            assert 0 < float(row["sigma_rotation_deg"]) <= 0.15
        else:
            assert row["reason"]


@pytest.mark.thorough
def test_the_dataset_has_no_fault(robotcar_built: Built) -> None:
    outcome = relocbench("validate", robotcar_built.root)
    assert outcome.status == 0, outcome.out + outcome.err
    assert "no fault" in outcome.out


@pytest.mark.thorough
def test_depth_is_that_of_the_surfaces(robotcar_street: RobotCarStreet, robotcar_built: Built) -> None:
    traversal = robotcar_built.dataset.traversal(robotcar_street.reference.name)
    truth, camera = robotcar_street.truth(robotcar_street.reference), traversal.camera("stereo_left")
    factors = CONDITIONS["Sunny"].factors
    renderer = SolidTexture(fenced_street_mesh(Street(), factors), factors, np.zeros((0, 3)), 0)
    wrong, share = [], []
    times = traversal.keyframe_timestamps("stereo_left")
    assert len(times) >= 12
    for time_ns in times[3:-3]:
        depth = traversal.depth("stereo_left", time_ns)
        assert depth is not None
        exact = renderer.render(camera, truth.rig(time_ns) @ truth.T_rig["stereo/left"], 0).depth
        known = (depth > 0) & (exact > 0)
        share.append(known.mean())
        wrong.append(np.abs(depth - exact)[known] / exact[known])
    assert np.median(share) > 0.1
    assert np.median(np.concatenate(wrong)) < 0.02


@pytest.mark.thorough
def test_correspondences_lie_where_the_exact_pose_puts_them(
    robotcar_street: RobotCarStreet, robotcar_built: Built
) -> None:
    dataset = robotcar_built.dataset
    camera = dataset.traversal(robotcar_street.query.name).camera("stereo_left")
    path = dataset.layout.correspondence_file(robotcar_street.pair_set)
    apart = []
    for pair in dataset.pair_set(robotcar_street.pair_set).pairs:
        if pair.accepted:
            rows = read_correspondences(path, (pair.ref_timestamp_ns, pair.query_timestamp_ns))
            rays, _ = dataset.traversal(robotcar_street.reference.name).camera("stereo_left").unproject(rows.uv_ref)
            T = robotcar_street.exact(pair)
            points = (rays * rows.depth_ref[:, None]) @ T[:3, :3].T + T[:3, 3]
            uv, valid = camera.project(points)
            apart.append(np.linalg.norm(uv - rows.uv_query, axis=1)[valid & rows.visible])
    everything = np.concatenate(apart)
    assert len(everything) > 200
    assert np.median(everything) < 0.3


@pytest.mark.thorough
def test_conditions_are_those_of_the_tags_and_the_table_of_drives(
    robotcar_street: RobotCarStreet, robotcar_built: Built
) -> None:
    found = [robotcar_built.dataset.traversal(folder.name).condition.weather for folder in robotcar_street.folders]
    assert found == ["sunny", "overcast"]


@pytest.mark.thorough
def test_what_is_noted_counts_pairs_and_compares_lidar_and_stereo(
    robotcar_street: RobotCarStreet, robotcar_built: Built
) -> None:
    notes = [line for line in robotcar_built.outcome.err.splitlines() if line.startswith("note: ")]
    pairs = robotcar_built.dataset.pair_set(robotcar_street.pair_set).all_pairs
    accepted = sum(p.accepted for p in pairs)
    assert any(f"stereo_left: {accepted} of {len(pairs)} " in note for note in notes)
    assert sum("stereo_right" in note for note in notes) == 2


@pytest.mark.thorough
def test_a_recording_is_not_written_to(robotcar_street: RobotCarStreet, robotcar_built: Built) -> None:
    started = (robotcar_built.root / "build.yaml").stat().st_mtime_ns
    everything = [p for p in robotcar_street.reference.folder.rglob("*") if p.is_file()]
    assert len(everything) > 100
    assert all(p.stat().st_mtime_ns < started for p in everything)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("options", "changed", "names"),
    [
        ({}, {"cameras": {}}, ("--cameras", "stereo_left", "none")),
        ({"cameras": ("stereo_top",)}, {}, ("--cameras", "stereo_top", "stereo_left")),
        ({"depth": "stereo"}, {"cameras": ("stereo_left",)}, ("--depth", "stereo_left")),
        ({"first_pose": "1 2 0 0 0 0 0 0 1"}, {}, ("--first-pose", "1")),
        ({"first_pose": "0 0 0 0 0 1"}, {}, ("--first-pose",)),
    ],
)
def test_options_that_do_not_fit_the_recordings_are_refused_before_any_work(
    robotcar_street: RobotCarStreet, options: dict[str, object], changed: dict[str, tuple[str, ...]], names: tuple[str]
) -> None:
    reference, query = read_robotcar_drives(robotcar_street.folders)
    if "cameras" in changed:
        query = replace(query, cameras={name: query.cameras[name] for name in changed["cameras"]})
    with refused(ConfigError, "", None, *names):
        check_recordings([reference, query], FieldOptions.model_validate(options))


@pytest.mark.thorough
def test_without_images_poses_of_the_rig_are_paired_unless_some_drives_have_images(
    robotcar_street: RobotCarStreet,
) -> None:
    drives = read_robotcar_drives(robotcar_street.folders)
    bare = [replace(drive, cameras={}) for drive in drives]
    assert check_recordings(bare, FieldOptions())[0] == (RIG,)
    assert check_recordings([bare[0], drives[1]], FieldOptions(cameras=("none",)))[0] == (RIG,)
    with refused(DatasetError, bare[0].name, None, "--cameras none"):
        check_recordings([bare[0], drives[1]], FieldOptions())


def test_recordings_that_cannot_be_brought_together_are_one_line_and_status_2(
    robotcar_street: RobotCarStreet, tmp_path: Path
) -> None:
    reference, query = robotcar_street.folders
    absent = query.parent / "2024-12-24-10-00-00"
    for arguments, place, names in (
        ((reference,), "", ("1",)),
        ((reference, reference), reference.name, ()),
        ((reference, absent), absent.name, ()),
        ((reference, query, "--cameras", "stereo_top"), "", ("stereo_top", "stereo_left")),
        ((reference, query, "--out", query / "dataset"), "", (query.name,)),
    ):
        outcome = build_robotcar(tmp_path / "dataset", *arguments)
        assert outcome.status == 2
        complaints = [line for line in outcome.err.splitlines() if line.startswith("relocbench: ")]
        assert len(complaints) == 1, outcome.err
        assert_names(complaints[0], place, None, *names)
    assert not (query / "dataset").exists()

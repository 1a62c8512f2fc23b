"""4Seasons and MLAD recordings. Facts about the real files come from the recordings themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from refusals import Notes, noted, refused
from small_dataset import render, small_camera, small_pose

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.core import images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import pose_fields, read_pose_lines, write_pose_lines
from relocbench.datasets.importers.four_seasons import dataset as importer
from relocbench.datasets.importers.four_seasons.calibration import read_calibration, read_camera, read_stereo
from relocbench.datasets.importers.four_seasons.files import (
    keyframe_files,
    read_gnss_poses,
    read_keyframe,
    read_times,
    read_transformations,
)
from relocbench.datasets.importers.four_seasons.receiver import agreement, read_gga
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.sensors.geodesy import ecef_from_geodetic
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.geometry import apply, invert, make_transform, rotation_angle, so3_exp

RealData = Callable[[str], Path]
PATCH_OFFSETS = ((0, -2), (-1, -1), (1, -1), (-2, 0), (0, 0), (2, 0), (-1, 1), (0, 2))
"""(du, dv) of the eight grey values stored with a point (Engel et al. 2018, pattern 8)"""
RECORDING = "recording_2020-10-07_14-47-51"
POINT_COUNTS = {
    1602074877390449152: 1958,
    1602074877423449344: 567,
    1602074877522449664: 520,
    1602074877555449600: 87,
}


@pytest.fixture(scope="module")
def sample(real_data: RealData) -> Path:
    return real_data("fourseasons_sample") / RECORDING


def test_real_keyframes_hold_their_points_beside_a_gps_fix_in_one_of_them(sample: Path) -> None:
    keyframes = {time: read_keyframe(path) for time, path in keyframe_files(sample).items()}
    assert {time: len(k) for time, k in keyframes.items()} == POINT_COUNTS


def test_point_filter_keeps_points_by_the_published_thresholds(sample: Path) -> None:
    keyframe = read_keyframe(sample / "KeyFrameData" / "KeyFrame_1602074877423449344.txt")
    variance = 1 / (keyframe.hessian + 0.01)
    for kept, idepth, var, baseline in zip(
        keyframe.reliable, keyframe.inverse_depth, variance, keyframe.relative_baseline, strict=True
    ):
        assert kept == (idepth > 0 and (1 / idepth) ** 4 * var <= 0.001 and var <= 0.001 and baseline >= 0.1)
    assert 0 < keyframe.reliable.sum() < len(keyframe)


def test_keyframe_depths_and_unscaled_gnss_poses_share_their_unit(sample: Path) -> None:
    """Why depth is multiplied by the scale: the odometry's baselines are those of the unscaled fused poses."""
    gnss = read_gnss_poses(sample / "GNSSPoses.txt")
    keyframes = {time: read_keyframe(path) for time, path in keyframe_files(sample).items()}
    first, *_, last = keyframes
    odometry = np.linalg.norm(keyframes[last].T_w_cam[:3, 3] - keyframes[first].T_w_cam[:3, 3])
    unscaled = np.linalg.norm(gnss[last].T_w_cam[:3, 3] - gnss[first].T_w_cam[:3, 3])
    metric = np.linalg.norm(gnss[last].metric[:3, 3] - gnss[first].metric[:3, 3])
    assert odometry / unscaled == pytest.approx(1.0, abs=0.005)
    assert metric / unscaled == pytest.approx(0.962356, abs=1e-9)


@pytest.mark.parametrize(("scaled", "ratio"), [(True, 1.0008), (False, 1.040)])
def test_path_length_agrees_with_the_receivers_track_only_with_the_scale(
    sample: Path, scaled: bool, ratio: float
) -> None:
    T_e_w = read_transformations(sample / "Transformations.txt").T_e_w
    poses = read_gnss_poses(sample / "GNSSPoses.txt")
    chosen = {t: (p.metric if scaled else p.T_w_cam)[None, :3, 3] for t, p in poses.items()}
    found = agreement({t: apply(T_e_w, p)[0] for t, p in chosen.items()}, read_gga(sample / "septentrio.nmea"))
    assert found is not None
    assert found.path_ratio == pytest.approx(ratio, abs=2e-4)
    assert found.horizontal_m == pytest.approx(4.0 if scaled else 12.2, abs=0.1)
    assert found.vertical_m == pytest.approx(-3.9 if scaled else -4.0, abs=0.1)


def test_real_recording_files_have_as_many_lines_as_the_recording_says(sample: Path) -> None:
    assert len(read_gnss_poses(sample / "GNSSPoses.txt")) == 2874
    assert len(read_trajectory(sample / "result.txt").times_ns) == 10026
    assert len(read_times(sample / "times.txt")) == 10030
    assert len(read_gga(sample / "septentrio.nmea")) == 3414
    assert read_transformations(sample / "Transformations.txt").scale == 0.962356


def test_real_calibration_gives_rectified_stereo_with_its_baseline(sample: Path) -> None:
    folder = sample.parent / "calibration"
    stereo = read_calibration(folder)
    assert stereo.cam0.model == "pinhole"
    assert stereo.cam0.size == (800, 400)
    assert stereo.T_cam1_cam0 is not None
    np.testing.assert_allclose(stereo.T_cam1_cam0[:3, 3], [-0.3004961618953472, 0, 0])
    assert read_camera(folder / "calib_0.txt").model == "equidistant"
    assert len(read_camera(folder / "calib_1.txt").distortion) == 4
    raw = read_stereo(folder / "calib_stereo.txt")
    np.testing.assert_allclose(raw[:3, :3] @ raw[:3, :3].T, np.eye(3), atol=1e-12)


PAIR_FILE_LINES = {
    "mlad-iccv2021": [129, 227, 227],
    "mlad-eccv2022": [113, 630, 690],
    "spatialai-eccv2024": [348, 455, 703],
}


@pytest.mark.parametrize("challenge", list(PAIR_FILE_LINES))
def test_real_pair_files_parse_to_their_line_counts_and_write_back_byte_for_byte(
    real_data: RealData, tmp_path: Path, challenge: str
) -> None:
    counts = []
    for path in (real_data("mlad_pair_files") / challenge).glob("*.txt"):
        lines = read_pose_lines(path)
        counts.append(len(lines))
        write_pose_lines(tmp_path / path.name, lines)
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()
    assert sorted(counts) == PAIR_FILE_LINES[challenge]


@pytest.mark.parametrize(
    ("trajectory", "recording", "count"),
    [("business", "2020-10-08_09-30-57", 455), ("country", "2020-06-12_11-26-43", 703)],
)
def test_reference_timestamps_of_pair_files_are_keyframes_of_their_trajectory(
    real_data: RealData, trajectory: str, recording: str, count: int
) -> None:
    """Trajectory times are printed to 0.1 us and went through a double (238 ns apart): half of both is 0.17 us off."""
    poses = read_trajectory(real_data("fourseasons_trajectories") / f"4seasons_{trajectory}_{recording}.txt", "wxyz")
    times = poses.times_ns
    (path,) = (real_data("mlad_pair_files") / "spatialai-eccv2024").glob(f"*_recording_{recording}_to_*.txt")
    references = [line.ref_timestamp_ns for line in read_pose_lines(path)]
    assert len(references) == count
    assert max(int(np.abs(times - time).min()) for time in references) < 500


def test_published_trajectory_is_the_gnss_poses_times_their_scale(sample: Path, real_data: RealData) -> None:
    """Two prints of one trajectory, the one unscaled with xyzw quaternions, the other scaled with wxyz."""
    published = read_trajectory(
        real_data("fourseasons_trajectories") / "4seasons_neighbor_2020-10-07_14-47-51.txt", "wxyz"
    )
    own = read_gnss_poses(sample / "GNSSPoses.txt")
    theirs = published.transforms
    assert len(theirs) == len(own)
    ours = np.array([pose.metric for pose in own.values()])
    np.testing.assert_allclose(theirs[:, :3, 3], ours[:, :3, 3], atol=2e-6)
    assert np.asarray(rotation_angle(np.swapaxes(theirs[:, :3, :3], 1, 2) @ ours[:, :3, :3])).max() < 5e-6


@pytest.mark.thorough
def test_real_recording_without_images_is_imported_for_inspection_and_says_so(sample: Path, tmp_path: Path) -> None:
    reporter = Notes()
    dataset = importer.build([sample], importer.Options(point_filter="none"), tmp_path / "out", reporter, Run())
    assert dataset.pair_set_names == []
    assert any("none of its pairs can be evaluated" in note for note in reporter.notes)
    assert noted(reporter.notes, "1.0008")
    traversal = dataset.traversal(RECORDING)
    assert len(traversal.poses) == 2874
    for time, count in POINT_COUNTS.items():
        points = traversal.points("cam0", time)
        assert points is not None
        assert len(points) == count


# Two recordings of one rendered street corner, each with a SLAM world and a scale of its own, in the official layout.

CAMERA = small_camera(160, 120)
STEP_NS = 100_000_000


@dataclass
class Drive:
    """What a made-up recording knows of itself."""

    name: str
    start_ns: int
    lateral_m: float
    scale: float
    seed: int
    T_e_true: Array
    frames: int = 3
    T_true_cam: dict[int, Array] = field(default_factory=dict)

    def write(self, root: Path, *, transformations: bool = True, cam1: bool = True) -> Path:
        folder = root / self.name
        rng = np.random.default_rng(self.seed)
        T_w_true = random_transform(rng, 5.0)
        w_gpsw = random_transform(rng, 1.0)
        gnss, times = ["# header\n"], []
        for i in range(self.frames):
            time = self.start_ns + i * STEP_NS
            T_true_cam = small_pose(i, lateral_m=self.lateral_m, yaw_deg=3.0 * self.seed, spacing_m=0.3)
            self.T_true_cam[time] = T_true_cam
            T_w_cam = T_w_true @ T_true_cam
            T_w_cam[:3, 3] /= self.scale
            gnss.append(f"{time},{','.join(pose_fields(T_w_cam))},{self.scale!r},2\n")
            times.append(f"{time} {time // 10**9}.{time % 10**9:09d} 0.25\n")
            image, depth = render(CAMERA, T_true_cam)
            images.write_image(folder / "undistorted_images" / "cam0" / f"{time}.png", image)
            if cam1:
                T_true_cam1 = T_true_cam @ make_transform(np.eye(3), [0.3, 0, 0])
                right = render(CAMERA, T_true_cam1)[0]
                images.write_image(folder / "undistorted_images" / "cam1" / f"{time}.png", right)
            write_keyframe(folder, time, T_w_cam, image, depth, self.scale, rng)
        (folder / "GNSSPoses.txt").write_text("".join(gnss))
        (folder / "times.txt").write_text("".join(times))
        if transformations:
            e_gpsw = self.T_e_true @ invert(T_w_true) @ w_gpsw
            parts = {
                "transform_S_AS": np.eye(4),
                "TS_cam_imu": np.eye(4),
                "transform_w_gpsw": w_gpsw,
                "transform_gps_imu": np.eye(4),
                "transform_e_gpsw": e_gpsw,
            }
            text = "".join(f"# {name}: translation\n{','.join(pose_fields(t))}\n\n" for name, t in parts.items())
            (folder / "Transformations.txt").write_text(text + f"# GNSS scale\n{self.scale!r}\n")
        return folder


def random_transform(rng: np.random.Generator, metres: float) -> Array:
    return make_transform(so3_exp(rng.normal(size=3)), metres * rng.normal(size=3))


def write_keyframe(
    folder: Path,
    time: int,
    T_w_cam: Array,
    image: Image,
    depth: Floats,
    scale: float,
    rng: np.random.Generator,
) -> None:
    v, u = np.nonzero(depth[4:-4, 4:-4] > 0)
    rows = np.sort(rng.choice(len(u), 300, replace=False))
    lines = [
        f"# timestamp\n{time}\n",
        f"{CAMERA.fx},{CAMERA.fy},{CAMERA.cx},{CAMERA.cy},{CAMERA.width},{CAMERA.height},{len(rows)}\n",
        f"{','.join(pose_fields(T_w_cam))}\n# Exposure time (ms)\n0.25\n",
    ]
    if rng.integers(2):
        lines.append("# GPS Data\n1,0,0,0,1,0,0,0,1\n\n0.5,0.25,0.125\n")
    for x, y in zip(u[rows] + 4, v[rows] + 4, strict=True):
        patch = ",".join(str(image[y + dv, x + du]) for du, dv in PATCH_OFFSETS)
        idepth = scale / float(depth[y, x])
        lines.append(f"{x}.000000,{y}.000000,{idepth!r},4e6,0.5,0,1\n{patch},\n")
    (folder / "KeyFrameData").mkdir(exist_ok=True)
    (folder / "KeyFrameData" / f"KeyFrame_{time}.txt").write_text("".join(lines))


def write_calibration(root: Path) -> None:
    folder = root / "Calibration"
    folder.mkdir()
    numbers = f"{CAMERA.fx} {CAMERA.fy} {CAMERA.cx} {CAMERA.cy} 0.0 0.0 0.0 0.0"
    for index in (0, 1):
        (folder / f"undistorted_calib_{index}.txt").write_text(f"Pinhole {numbers}\n160 120\ncrop\n160 120\n")
    (folder / "undistorted_calib_stereo.txt").write_text("1 0 0 -0.3\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")


@pytest.fixture
def two_drives(tmp_path: Path) -> tuple[Drive, Drive]:
    """On the earth, hundreds of thousands of times farther out than they are long."""
    T_e_true = make_transform(so3_exp([0.4, -1.2, 0.7]), ecef_from_geodetic(np.array([48.19, 11.61, 540.0])))
    write_calibration(tmp_path)
    return (
        Drive("recording_2020-10-07_14-47-51", 1602074877390449152, 0.0, 0.9623, 1, T_e_true),
        Drive("recording_2021-02-25_13-25-15", 1614255920291144192, 0.15, 1.0371, 2, T_e_true),
    )


def build(sources: list[Path], out: Path, **options: object) -> tuple[Dataset, list[str]]:
    reporter = Notes()
    chosen = importer.Options.model_validate({"correspondences": 50, **options})
    return importer.build(sources, chosen, out, reporter, Run()), reporter.notes


def test_pairs_across_recordings_have_the_true_pose_in_spite_of_scales_and_worlds(
    tmp_path: Path, two_drives: tuple[Drive, Drive]
) -> None:
    reference, query = two_drives
    dataset, _ = build([reference.write(tmp_path), query.write(tmp_path)], tmp_path / "out")
    (pair_set,) = dataset.pair_sets()
    assert pair_set.name == f"{reference.name}__{query.name}__cam0"
    assert [p.query_timestamp_ns for p in pair_set.pairs] == list(query.T_true_cam)
    for pair in pair_set.pairs:
        truth = invert(query.T_true_cam[pair.query_timestamp_ns]) @ reference.T_true_cam[pair.ref_timestamp_ns]
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref, truth, atol=1e-7)
        assert pair.source == "GNSSPoses.txt"


def test_keyframe_points_are_metric_and_show_the_query_what_the_reference_saw(
    tmp_path: Path, two_drives: tuple[Drive, Drive]
) -> None:
    reference, query = two_drives
    dataset, _ = build([reference.write(tmp_path), query.write(tmp_path)], tmp_path / "out")
    (pair_set,) = dataset.pair_sets()
    for pair in pair_set.pairs:
        T_query_ref = pair.T_query_ref
        assert T_query_ref is not None
        ref, seen = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
        _, depth = render(CAMERA, reference.T_true_cam[pair.ref_timestamp_ns])
        u, v = ref.points.uv.astype(int).T
        np.testing.assert_allclose(1 / ref.points.inverse_depth, depth[v, u], rtol=1e-6)
        np.testing.assert_allclose(ref.points.sigma, 1 / np.sqrt(4e6 + 0.01) / reference.scale, rtol=1e-12)
        rays, _ = CAMERA.unproject(ref.points.uv)
        pixels, _ = CAMERA.project(apply(T_query_ref, rays / ref.points.inverse_depth[:, None]))
        inside = CAMERA.contains(pixels, 2)
        uq, vq = np.rint(pixels[inside]).astype(int).T
        differences = np.abs(seen.image[vq, uq].astype(float) - ref.image[v[inside], u[inside]])
        assert inside.sum() > 100
        assert np.median(differences) < 8
    found = read_correspondences(dataset.layout.correspondence_file(pair_set.name))
    assert set(found.check) == {"none"}
    assert len(found) == 50 * len(pair_set.pairs)


def test_right_camera_stands_a_baseline_to_the_right(tmp_path: Path, two_drives: tuple[Drive, Drive]) -> None:
    drive = two_drives[0]
    dataset, _ = build([drive.write(tmp_path)], tmp_path / "out")
    traversal = dataset.traversal(drive.name)
    np.testing.assert_allclose(traversal.T_rig_cam("cam1"), make_transform(np.eye(3), [0.3, 0, 0]))
    assert traversal.timestamps("cam1") == list(drive.T_true_cam)


def test_images_are_linked_and_one_recording_is_paired_with_itself_by_steps(
    tmp_path: Path, two_drives: tuple[Drive, Drive]
) -> None:
    drive = two_drives[0]
    folder = drive.write(tmp_path, transformations=False)
    dataset, _ = build([folder], tmp_path / "out", pair_step=(1, 2))
    (pair_set,) = dataset.pair_sets()
    assert sorted(p.group for p in pair_set.pairs) == ["step_1", "step_1", "step_2"]
    time = pair_set.pairs[0].query_timestamp_ns
    linked = dataset.layout.traversal(drive.name).image("cam0", time)
    assert linked.resolve() == (folder / "undistorted_images" / "cam0" / f"{time}.png").resolve()


def test_recordings_without_transformations_are_refused_by_rule_before_any_work(
    tmp_path: Path, two_drives: tuple[Drive, Drive]
) -> None:
    sources = [two_drives[0].write(tmp_path), two_drives[1].write(tmp_path, transformations=False)]
    with refused(DatasetError, "", None, "relocalization-files"):
        build(sources, tmp_path / "out")


def relocalization_file(path: Path, drives: tuple[Drive, Drive], *, poses: bool) -> Path:
    lines = []
    for r, q in zip(drives[0].T_true_cam, drives[1].T_true_cam, strict=True):
        pose = pose_fields(invert(drives[1].T_true_cam[q]) @ drives[0].T_true_cam[r]) if poses else []
        lines.append(" ".join([str(r), str(q), *pose]) + "\n")
    path.write_text("# ref query\n" + "".join(lines))
    return path


def test_relocalization_file_with_poses_is_the_truth_and_agrees_with_the_recordings(
    tmp_path: Path, two_drives: tuple[Drive, Drive]
) -> None:
    sources = [drive.write(tmp_path) for drive in two_drives]
    file = relocalization_file(tmp_path / "relocalizationFile_x_easy.txt", two_drives, poses=True)
    dataset, notes = build(sources, tmp_path / "out", relocalization_files=(str(file),))
    (pair_set,) = dataset.pair_sets()
    given = {line.key: line.T_query_ref for line in read_pose_lines(file)}
    assert given.keys() == pair_set.by_key.keys()
    for key, pair in pair_set.by_key.items():
        told = given[key]
        assert told is not None
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref, told, atol=2e-9)
        assert pair.group == "easy"
    (note,) = [n for n in notes if "differ from the recordings' own" in n]
    assert float(note.split(" by ")[1].split(" m")[0]) < 1e-6


@pytest.mark.parametrize(("withheld_truth", "known"), [("leave", False), ("from-poses", True)])
def test_withheld_truth_stays_withheld_unless_it_is_asked_from_the_poses(
    tmp_path: Path, two_drives: tuple[Drive, Drive], withheld_truth: str, known: bool
) -> None:
    sources = [drive.write(tmp_path) for drive in two_drives]
    file = relocalization_file(tmp_path / "relocalizationFile_x.txt", two_drives, poses=False)
    options = {"relocalization_files": (str(file),), "withheld_truth": withheld_truth}
    dataset, notes = build(sources, tmp_path / "out", **options)
    (pair_set,) = dataset.pair_sets()
    assert pair_set.has_truth == known
    assert noted(notes, "withheld") != known
    for pair in pair_set.pairs:
        if known:
            truth = invert(two_drives[1].T_true_cam[pair.query_timestamp_ns])
            truth = truth @ two_drives[0].T_true_cam[pair.ref_timestamp_ns]
            assert pair.T_query_ref is not None
            np.testing.assert_allclose(pair.T_query_ref, truth, atol=1e-7)


def test_mlad_layout_needs_no_transformations_and_takes_depth_as_metres(
    tmp_path: Path, two_drives: tuple[Drive, Drive]
) -> None:
    """The challenges' own layout: poses.txt for the map, images alone for the query."""
    for drive in two_drives:
        drive.scale = 1.0
    sources = [drive.write(tmp_path, transformations=False) for drive in two_drives]
    metric = read_gnss_poses(sources[0] / "GNSSPoses.txt")
    poses = "".join(f"{t},{','.join(pose_fields(p.metric))}\n" for t, p in metric.items())
    (sources[0] / "poses.txt").write_text(poses)
    for source in sources:
        (source / "GNSSPoses.txt").unlink()
    for path in (sources[1] / "KeyFrameData").iterdir():
        path.unlink()
    assert read_trajectory(sources[0] / "poses.txt").times_ns.tolist() == list(two_drives[0].T_true_cam)
    file = relocalization_file(tmp_path / "relocalizationFile_x_hard.txt", two_drives, poses=False)
    dataset, notes = build(sources, tmp_path / "out", relocalization_files=(str(tmp_path / file.name),))
    (pair_set,) = dataset.pair_sets()
    assert not pair_set.has_truth
    assert {p.group for p in pair_set.pairs} == {"hard"}
    assert any("taken to be in metres" in n for n in notes)
    reference = dataset.reference(pair_set, pair_set.pairs[0])
    _, depth = render(CAMERA, two_drives[0].T_true_cam[pair_set.pairs[0].ref_timestamp_ns])
    u, v = reference.points.uv.astype(int).T
    np.testing.assert_allclose(1 / reference.points.inverse_depth, depth[v, u], rtol=1e-6)


@pytest.mark.thorough
def test_same_build_again_gives_the_same_fingerprint(tmp_path: Path, two_drives: tuple[Drive, Drive]) -> None:
    sources = [drive.write(tmp_path) for drive in two_drives]
    first, _ = build(sources, tmp_path / "one")
    second, _ = build(sources, tmp_path / "two")
    assert first.fingerprint == second.fingerprint


def spoil(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_faults_of_recordings_are_named_with_file_and_line(tmp_path: Path, two_drives: tuple[Drive, Drive]) -> None:
    drive = two_drives[0]
    folder = drive.write(tmp_path)
    time = drive.start_ns
    keyframe = folder / "KeyFrameData" / f"KeyFrame_{time}.txt"
    whole = keyframe.read_text()

    keyframe.write_text("\n".join(whole.splitlines()[:-1]) + "\n")
    with refused(DatasetError, f"KeyFrame_{time}.txt", 3, "299.5"):
        read_keyframe(keyframe)
    keyframe.write_text(whole.replace("4e6", "-1", 1))
    with refused(DatasetError, f"KeyFrame_{time}.txt", None, "idepth_hessian"):
        read_keyframe(keyframe)
    keyframe.write_text(whole.replace(str(CAMERA.fx), str(CAMERA.fx + 1), 1))
    with refused(DatasetError, f"KeyFrame_{time}.txt"):
        build([folder], tmp_path / "out1")
    keyframe.write_text(whole)

    spoil(folder / "Transformations.txt", "transform_w_gpsw", "transform_gps_imu")
    with refused(DatasetError, "Transformations.txt", 8, "w_gpsw"):
        read_transformations(folder / "Transformations.txt")
    spoil(folder / "GNSSPoses.txt", ",2\n", "x,2\n")
    with refused(DatasetError, "GNSSPoses.txt", 2):
        read_gnss_poses(folder / "GNSSPoses.txt")


def test_relocalization_file_that_names_an_unknown_frame_is_refused(
    tmp_path: Path, two_drives: tuple[Drive, Drive]
) -> None:
    sources = [drive.write(tmp_path) for drive in two_drives]
    file = tmp_path / "pairs.txt"
    file.write_text(f"{two_drives[0].start_ns} {two_drives[1].start_ns}\n{two_drives[0].start_ns} 12345\n")
    with refused(DatasetError, "pairs.txt", 2, "12345"):
        build(sources, tmp_path / "out", relocalization_files=(str(file),))


def test_cut_nmea_sentences_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "log.nmea"
    good = "$GPGGA,124637.70,4811.7613024,N,01137.1665137,E,5,05,2.6,494.6412,M,47.5367,M,0.7,3119*48"
    path.write_bytes(
        b"\xff,D*1C\n" + good.encode() + b"\n" + good[:30].encode() + b"\n" + good.replace("48", "49", 1).encode()
    )
    (fix,) = read_gga(path)
    assert fix.time_of_day_ns == (12 * 3600 + 46 * 60 + 37) * 10**9 + 700_000_000
    assert fix.latitude_deg == pytest.approx(48 + 11.7613024 / 60, abs=1e-12)
    assert fix.height_m == pytest.approx(494.6412 + 47.5367)


def test_ecef_of_known_places() -> None:
    """At the equator and the poles the ellipsoid's own axes (WGS 84)."""
    places = np.array([[0.0, 0.0, 10.0], [0.0, 90.0, 0.0], [-90.0, 0.0, 0.0]])
    expected = [[6378147.0, 0.0, 0.0], [0.0, 6378137.0, 0.0], [0.0, 0.0, -6356752.314245]]
    np.testing.assert_allclose(ecef_from_geodetic(places), expected, atol=1e-5)

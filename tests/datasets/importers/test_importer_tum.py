"""TUM RGB-D recordings become datasets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from refusals import Notes, noted, refused

from relocbench.datasets.core import images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.clocks import poses_at
from relocbench.datasets.importers.tum_rgbd import dataset as tum_rgbd
from relocbench.datasets.importers.tum_rgbd.dataset import INTRINSICS
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.geometry import apply, invert

SECONDS = "1305031102"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A made-up freiburg3 sequence: images at .1, .2, .3, .9 s, of which the third has no depth within 0.02 s.

    The camera moves along x at 1 m/s: at .1 s it is at 0.1 m. The image listed at .4 s is not there, and the truth
    ends at .5 s.
    """
    folder = tmp_path / "rgbd_dataset_freiburg3_made_up"
    rng = np.random.default_rng(0)
    for tenth in (1, 2, 3, 9):
        noise = cv2.resize(rng.integers(0, 255, (60, 80), dtype=np.uint8), (640, 480))
        images.write_image(folder / f"rgb/{SECONDS}.{tenth}00000.png", np.dstack([noise, noise, noise]))
    (folder / "depth").mkdir()
    for name in (f"{SECONDS}.115000", f"{SECONDS}.190000", f"{SECONDS}.330000"):
        cv2.imwrite(str(folder / f"depth/{name}.png"), np.full((480, 640), 10_000, dtype=np.uint16))
    rgb = [f"{SECONDS}.{t}00000 rgb/{SECONDS}.{t}00000.png" for t in (1, 2, 3, 4, 9)]
    depth = [f"{SECONDS}.{t} depth/{SECONDS}.{t}.png" for t in ("115000", "190000", "330000")]
    truth = [f"{SECONDS}.{t:04d} {t / 1e4!r} 0 0 0 0 0 1" for t in range(0, 5001, 250)]
    for name, lines in (("rgb", rgb), ("depth", depth), ("groundtruth", truth)):
        (folder / f"{name}.txt").write_text("\n".join(["# made up", *lines]) + "\n")
    return folder


def build(sources: list[Path], out: Path, notes: Notes | None = None, workers: int = 1, **options: object) -> Dataset:
    settings = tum_rgbd.Options.model_validate({"correspondences": 100, **options})
    return tum_rgbd.build(sources, settings, out, notes or Notes(), Run(workers))


def test_images_depth_and_truth_are_put_together_by_time(recording: Path, tmp_path: Path) -> None:
    notes = Notes()
    dataset = build([recording], tmp_path / "out", notes)
    traversal = dataset.traversal(recording.name)
    times = [int(f"{SECONDS}{t}00000000") for t in (1, 2, 3)]
    assert traversal.timestamps("rgb") == times
    assert traversal.keyframe_timestamps("rgb") == times[:2]
    np.testing.assert_allclose(traversal.T_world_cam("rgb", times[0])[:3, 3], [0.1, 0, 0], atol=1e-9)
    depth = traversal.depth("rgb", times[0])
    assert depth is not None
    np.testing.assert_allclose(depth, 2.0, atol=1 / 512)
    assert noted(notes.notes, "rgb.txt", "1 of 5")
    assert noted(notes.notes, "1 of 4")
    assert noted(notes.notes, "1 of 3")


def test_the_truth_is_that_of_the_images_time_plus_the_offset(recording: Path, tmp_path: Path) -> None:
    # 1 m/s and -0.02 s: 2 cm back, between two rows of the truth.
    traversal = build([recording], tmp_path / "out", time_offset=(-0.02,)).traversal(recording.name)
    pose = traversal.T_world_cam("rgb", int(f"{SECONDS}100000000"))
    np.testing.assert_allclose(pose[:3, 3], [0.08, 0, 0], atol=1e-9)


def test_an_image_at_the_time_of_a_true_pose_has_it_even_after_a_gap(tmp_path: Path) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text("".join(f"{s} {s} 0 0 0 0 0 1\n" for s in (1.0, 1.5, 1.6)))
    times = [1_000_000_000, 1_400_000_000, 1_500_000_000, 1_550_000_000, 1_700_000_000]
    truth = read_trajectory(path)
    poses = poses_at(Trajectory(truth.times_ns, truth.transforms, 200_000_000), times, 0.0)
    assert {t: round(float(T[0, 3]), 9) for t, T in poses.items()} == {times[0]: 1.0, times[2]: 1.5, times[3]: 1.55}


def test_nothing_is_interpolated_over_a_gap_of_the_truth(recording: Path, tmp_path: Path) -> None:
    lines = (recording / "groundtruth.txt").read_text().splitlines()
    kept = [line for line in lines if not f"{SECONDS}.16" < line < f"{SECONDS}.27"]
    (recording / "groundtruth.txt").write_text("\n".join(kept) + "\n")
    dataset = build([recording], tmp_path / "out", pair_step=(1,))
    assert dataset.traversal(recording.name).timestamps("rgb") == [
        int(f"{SECONDS}100000000"),
        int(f"{SECONDS}300000000"),
    ]


def test_images_without_distortion_are_linked(recording: Path, tmp_path: Path) -> None:
    traversal = build([recording], tmp_path / "out").traversal(recording.name)
    path = traversal.layout.image("rgb", int(f"{SECONDS}100000000"))
    assert path.resolve() == (recording / f"rgb/{SECONDS}.100000.png").resolve()


@pytest.mark.thorough
def test_distorted_images_and_depth_become_those_of_a_pinhole_camera(recording: Path, tmp_path: Path) -> None:
    camera = INTRINSICS["fr1"]
    image = np.zeros((480, 640), dtype=np.uint8)
    points = np.array([[-0.5, -0.35, 1.0], [0.4, 0.3, 1.0], [0.0, 0.0, 1.0]])
    for u, v in camera.project(points)[0]:
        cv2.circle(image, (round(u), round(v)), 4, 255, -1)
    path = recording / f"rgb/{SECONDS}.100000.png"
    images.write_image(path, image)
    traversal = build([recording], tmp_path / "out", intrinsics=("fr1",)).traversal(recording.name)
    assert traversal.camera("rgb") == camera.pinhole()
    found = traversal.image("rgb", int(f"{SECONDS}100000000"))
    centres = cv2.connectedComponentsWithStats((found > 127).astype(np.uint8))[3][1:]
    expected = camera.pinhole().project(points)[0]
    for pixel in expected:
        assert np.min(np.linalg.norm(centres - pixel, axis=1)) < 0.8
    # Nearest neighbour: no depth that was not there.
    depth = traversal.depth("rgb", int(f"{SECONDS}100000000"))
    assert depth is not None
    assert set(np.unique(depth)) <= {np.float32(0.0), np.float32(2.0)}


@pytest.mark.thorough
def test_workers_and_interruptions_do_not_change_the_bytes(recording: Path, tmp_path: Path) -> None:
    one = build([recording], tmp_path / "one", intrinsics=("fr1",))
    two = build([recording], tmp_path / "two", workers=2, intrinsics=("fr1",))
    assert one.fingerprint == two.fingerprint
    torn = two.traversal(recording.name).layout.image("rgb", int(f"{SECONDS}200000000"))
    torn.write_bytes(torn.read_bytes()[:1000])
    two.layout.dataset_yaml.unlink()
    assert build([recording], tmp_path / "two", intrinsics=("fr1",)).fingerprint == one.fingerprint


@pytest.mark.parametrize(
    ("name", "line", "names"),
    [
        ("groundtruth.txt", f"{SECONDS}.1000 0.1 0 0 0 0 0 1.1", ("norm 1.1", "1")),
        ("groundtruth.txt", f"{SECONDS}.1000 0.1 0 0 0 0 1", ("8 columns", "found 7")),
        ("groundtruth.txt", f"{SECONDS}.0010 0.1 0 0 0 0 0 1", (f"{SECONDS}.0010", "line 5")),
        ("groundtruth.txt", "noon 0.1 0 0 0 0 0 1", ("noon",)),
        ("rgb.txt", f"{SECONDS}.100000 rgb/again.png", (f"{SECONDS}.100000", "again")),
        ("rgb.txt", f"{SECONDS}.950000 rgb/a b.png", ("2 columns", "found 3")),
    ],
)
def test_a_bad_line_is_named(recording: Path, tmp_path: Path, name: str, line: str, names: tuple[str, ...]) -> None:
    path = recording / name
    lines = path.read_text().splitlines()
    lines[5] = line
    path.write_text("\n".join(lines) + "\n")
    with refused(DatasetError, path, 6, *names):
        build([recording], tmp_path / "out")


@pytest.mark.parametrize(("folder", "name"), [("rgb", "100000"), ("depth", "115000")])
def test_a_truncated_image_is_named(recording: Path, tmp_path: Path, folder: str, name: str) -> None:
    path = recording / folder / f"{SECONDS}.{name}.png"
    path.write_bytes(path.read_bytes()[:-50])
    with refused(DatasetError, f"{folder}/{SECONDS}.{name}.png"):
        build([recording], tmp_path / "out")


def test_an_image_of_another_size_is_named(recording: Path, tmp_path: Path) -> None:
    images.write_image(recording / f"rgb/{SECONDS}.200000.png", np.zeros((48, 64), dtype=np.uint8))
    with refused(DatasetError, f"{SECONDS}.200000.png", None, "64x48", "640x480"):
        build([recording], tmp_path / "out", intrinsics=("fr1",))


def test_a_folder_that_does_not_tell_its_camera_needs_the_option(recording: Path, tmp_path: Path) -> None:
    renamed = recording.rename(recording.with_name("office"))
    with refused(ConfigError, "", None, "--intrinsics"):
        build([renamed], tmp_path / "out")
    assert build([renamed], tmp_path / "out", intrinsics=("ros-default",)).traversal("office").camera("rgb").fx == 525


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("groundtruth.txt", "# nothing\n", "holds no pose"),
        ("groundtruth.txt", "5.0 0 0 0 0 0 0 1\n", "time of any image"),
        ("rgb.txt", "# nothing\n", "empty"),
        ("rgb.txt", "5.0 rgb/none.png\n", "exist"),
    ],
)
def test_a_list_of_nothing_that_is_there_is_named(
    recording: Path, tmp_path: Path, name: str, text: str, words: str
) -> None:
    (recording / name).write_text(text)
    with refused(DatasetError, recording / name, None, words):
        build([recording], tmp_path / "out")


def test_three_sequences_are_one_too_many(recording: Path, tmp_path: Path) -> None:
    with refused(ConfigError, "", None, "one or two", "got 3"):
        build([recording] * 3, tmp_path / "out")


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt", "groundtruth.txt"])
def test_a_missing_list_is_named(recording: Path, tmp_path: Path, name: str) -> None:
    (recording / name).unlink()
    with refused(DatasetError, name, None, "missing"):
        build([recording], tmp_path / "out")


@pytest.mark.thorough
def test_the_clock_of_a_real_recording_is_told_by_its_images(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    folder, notes = real_data("tum_rgbd"), Notes()
    for name in ("desk", "xyz"):
        dataset = build([folder / f"rgbd_dataset_freiburg1_{name}"], tmp_path / name, notes, correspondences=0)
        clock = dataset.traversal(dataset.traversal_names[0]).file.clock
        assert clock is not None
        assert (clock.verdict, clock.applied_s) == ("one clock", 0.0)
        assert clock.offset_s == pytest.approx(0.0, abs=0.006)
        # A Kinect's rolling shutter; taken for one of all rows at once, rotations would say -20 ms.
        assert clock.readout_s == pytest.approx(0.02, abs=0.008)
    # rgb.txt of the whole sequence stands beside nine of its images.
    assert noted(notes.notes, "rgb.txt", "604 of 613")


@pytest.mark.thorough
def test_real_correspondences_lie_on_the_same_surface(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    desk = real_data("tum_rgbd") / "rgbd_dataset_freiburg1_desk"
    dataset = build([desk], tmp_path / "out", time_offset=(-0.02,), correspondences=500)
    pair_set = dataset.pair_sets()[0]
    pair = pair_set.pairs[0]
    assert pair.overlap is not None
    assert pair.overlap > 0.9
    assert pair.T_query_ref is not None
    rows = read_correspondences(dataset.layout.correspondence_file(pair_set.name), pair.key)
    assert len(rows) == 500
    camera = dataset.traversal(pair_set.query).camera("rgb")
    lifted = camera.unproject(rows.uv_ref)[0] * rows.depth_ref[:, None]
    there = camera.project(apply(pair.T_query_ref, lifted))[0]
    np.testing.assert_allclose(there, rows.uv_query, atol=1e-3)
    grey = [
        np.asarray(v.image).mean(axis=2) for v in (dataset.reference(pair_set, pair), dataset.query(pair_set, pair))
    ]
    a, b = (
        g[tuple(np.rint(uv[:, ::-1]).astype(int).T)] for g, uv in zip(grey, (rows.uv_ref, rows.uv_query), strict=True)
    )
    # The same surface has the same brightness 30 ms on; other pixels have not.
    assert np.median(np.abs(a - b)[rows.visible]) < 0.2 * np.median(np.abs(a - np.roll(b, 100)))


@pytest.mark.thorough
def test_two_real_sessions_are_paired_across(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    folder = real_data("tum_rgbd")
    sources = [folder / "rgbd_dataset_freiburg1_xyz", folder / "rgbd_dataset_freiburg1_desk"]
    with refused(DatasetError, "", None, "--max-angle"):
        build(sources, tmp_path / "a", max_angle=30)
    dataset = build(sources, tmp_path / "b", max_angle=70, time_offset=(0.0, -0.02))
    pairs = dataset.pair_sets()[0].pairs
    assert len(pairs) == 9
    # The data's description: the view turns by 55 to 65 degrees.
    assert all(p.angle_deg is not None and 55 < p.angle_deg < 66 for p in pairs)
    T_query_ref = pairs[0].T_query_ref
    assert T_query_ref is not None
    assert np.allclose(invert(T_query_ref) @ T_query_ref, np.eye(4), atol=1e-12)

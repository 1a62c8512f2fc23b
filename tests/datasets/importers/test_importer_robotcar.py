"""RobotCar recordings become datasets whose truth comes from their lidar, by the command a user types."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import Outcome, relocbench
from fenced_street import fenced_street_mesh
from killing import Fault, run_until_killed
from numpy.typing import NDArray
from recording_reading import Truth, hashes
from small_street import SolidTexture, StraightRoad, Street

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS
from relocbench.datasets.synthetic.jobs.recording import Recorded, record
from relocbench.geometry import invert, rotation_angle, se3_exp, transform_to_tq

Array = NDArray[np.float64]

FRAMES = 64
# The default matcher of the search takes longer than all else; test_importer_lidar_kinds.py builds with it.
SMALL = (
    *("--submap", 30, "--depth-submap", 16, "--keyframe-distance", 1.5, "--query-distance", 3),
    *("--max-distance", 3, "--correspondences", 200, "--matcher", "fgr"),
)
GAP_US = (2_000_000, 2_700_000)
"""after the first step of visual odometry"""


@dataclass(frozen=True)
class Elsewhere(StraightRoad):
    """Another part of the street, or the same the other way."""

    start_m: float = 0.0
    backwards: bool = False

    def pose(self, s: float, lateral_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        pose = super().pose(s, lateral_m, yaw_rad)
        pose[0, 3] += self.start_m
        turn = np.diag([-1.0, -1.0, 1.0, 1.0])
        return turn @ pose if self.backwards else pose


@dataclass(frozen=True)
class Drives:
    """Recordings of one street, and the exact truth."""

    reference: Recorded
    query: Recorded
    far: Recorded
    backwards: Recorded

    @property
    def pair_set(self) -> str:
        return f"{self.reference.name}__{self.query.name}__stereo_left"

    def exact(self, pair: Pair) -> Array:
        """``T_query_ref`` of the left stereo camera."""
        ref, query = Truth(self.reference.truth), Truth(self.query.truth)
        T_world_ref = ref.rig(pair.ref_timestamp_ns) @ ref.T_rig["stereo/left"]
        T_world_query = query.rig(pair.query_timestamp_ns) @ query.T_rig["stereo/left"]
        return np.asarray(invert(T_world_query) @ T_world_ref)

    def errors(self, dataset: Dataset) -> Array:
        """(N, 2) metres and degrees of the accepted pairs."""
        out = []
        for pair in dataset.pair_set(self.pair_set).pairs:
            if pair.accepted:
                assert pair.T_query_ref is not None
                wrong = invert(self.exact(pair)) @ pair.T_query_ref
                out.append((np.linalg.norm(wrong[:3, 3]), np.degrees(rotation_angle(wrong[:3, :3]))))
        return np.array(out)


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Drives:
    out = tmp_path_factory.mktemp("recordings")

    def drive(
        number: int, condition: str, path: StraightRoad, cameras: tuple[str, ...], frames: int = FRAMES
    ) -> Recorded:
        return record(
            Street(),
            path,
            CONDITIONS[condition].factors,
            out,
            "robotcar",
            frames=frames,
            scale=0.06,
            number=number,
            cameras=cameras,
            renderer_factory=SolidTexture,
            compose=fenced_street_mesh,
        )

    pair = ("stereo/left", "stereo/right")
    found = Drives(
        drive(0, "Sunny", StraightRoad(), pair),
        drive(1, "Overcast", StraightRoad(), pair),
        drive(2, "Sunny", Elsewhere(start_m=110.0), ("stereo/left",), 16),
        drive(3, "Sunny", Elsewhere(start_m=-FRAMES / 2, backwards=True), ("stereo/left",), 48),
    )
    rows = [("name", "condition"), (found.reference.name, "Sunny"), (found.query.name, "Overcast")]
    (out / "drives.csv").write_text("".join(",".join(row) + "\n" for row in rows))
    return found


def build(out: Path, *arguments: object, workers: int = 1) -> Outcome:
    return relocbench("build-dataset", "robotcar", "--out", out, "-j", workers, *SMALL, *arguments)


@dataclass(frozen=True)
class Built:
    root: Path
    outcome: Outcome

    @property
    def dataset(self) -> Dataset:
        return Dataset(self.root)


@pytest.fixture(scope="module")
def built(drives: Drives, tmp_path_factory: pytest.TempPathFactory) -> Built:
    out = tmp_path_factory.mktemp("built") / "dataset"
    outcome = build(out, drives.reference.folder, drives.query.folder)
    assert outcome.status == 0, outcome.err
    return Built(out, outcome)


pytestmark = pytest.mark.slow


def test_poses_are_those_of_the_exact_truth_to_centimetres(drives: Drives, built: Built) -> None:
    pairs = built.dataset.pair_set(drives.pair_set).pairs
    errors = drives.errors(built.dataset)
    assert len(pairs) >= 8
    assert len(errors) >= 0.8 * len(pairs)
    assert np.median(errors[:, 0]) < 0.03
    assert errors[:, 0].max() < 0.10
    assert errors[:, 1].max() < 0.15


def table(built: Built, pair_set: str) -> list[dict[str, str]]:
    with built.dataset.layout.pair_table(pair_set).open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_every_pair_has_its_sigmas_or_its_reason(drives: Drives, built: Built) -> None:
    rows = table(built, drives.pair_set)
    assert {row["source"] for row in rows} == {"lidar registration, pose graph"}
    for row in rows:
        if row["accepted"] == "true":
            assert not row["reason"]
            for name in ("sigma_translation_m", "sigma_along_m", "sigma_across_m", "sigma_height_m"):
                assert 0 < float(row[name]) <= 0.05
            assert 0 < float(row["sigma_rotation_deg"]) <= 0.15
        else:
            assert row["reason"]


def test_the_dataset_has_no_fault(built: Built) -> None:
    outcome = relocbench("validate", built.root)
    assert outcome.status == 0, outcome.out + outcome.err
    assert "no fault" in outcome.out


def test_depth_is_that_of_the_surfaces(drives: Drives, built: Built) -> None:
    traversal = built.dataset.traversal(drives.reference.name)
    truth, camera = Truth(drives.reference.truth), traversal.camera("stereo_left")
    factors = CONDITIONS["Sunny"].factors
    renderer = SolidTexture(fenced_street_mesh(Street(), factors, ()), factors, np.zeros((0, 3)), 0)
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


def test_correspondences_lie_where_the_exact_pose_puts_them(drives: Drives, built: Built) -> None:
    dataset = built.dataset
    camera = dataset.traversal(drives.query.name).camera("stereo_left")
    path = dataset.layout.correspondence_file(drives.pair_set)
    apart = []
    for pair in dataset.pair_set(drives.pair_set).pairs:
        if pair.accepted:
            rows = read_correspondences(path, (pair.ref_timestamp_ns, pair.query_timestamp_ns))
            rays, _ = dataset.traversal(drives.reference.name).camera("stereo_left").unproject(rows.uv_ref)
            T = drives.exact(pair)
            points = (rays * rows.depth_ref[:, None]) @ T[:3, :3].T + T[:3, 3]
            uv, valid = camera.project(points)
            apart.append(np.linalg.norm(uv - rows.uv_query, axis=1)[valid & rows.visible])
    everything = np.concatenate(apart)
    assert len(everything) > 200
    assert np.median(everything) < 0.3


def test_conditions_are_those_of_the_tags_and_the_table_of_drives(drives: Drives, built: Built) -> None:
    traversals = built.dataset
    assert traversals.traversal(drives.reference.name).condition.weather == "sunny"
    assert traversals.traversal(drives.query.name).condition.weather == "overcast"


def test_the_notes_say_how_many_pairs_and_how_lidar_and_stereo_agree(drives: Drives, built: Built) -> None:
    notes = [line for line in built.outcome.err.splitlines() if line.startswith("note: ")]
    assert any("stereo_left: " in n and "pairs accepted, median sigma" in n for n in notes)
    assert sum("lidar against stereo with stereo_right: median" in n for n in notes) == 2


def test_a_recording_is_not_written_to(drives: Drives, built: Built) -> None:
    started = (built.root / "build.yaml").stat().st_mtime_ns
    everything = [p for p in drives.reference.folder.rglob("*") if p.is_file()]
    assert len(everything) > 100
    assert all(p.stat().st_mtime_ns < started for p in everything)


def test_a_build_killed_twice_and_for_two_workers_ends_with_the_same_bytes(
    drives: Drives, built: Built, tmp_path: Path
) -> None:
    out = tmp_path / "dataset"
    sources = (drives.reference.folder, drives.query.folder)
    arguments = ["build-dataset", "robotcar", *sources, *SMALL, "--out", out, "-q"]

    registrations = Fault(r"groundtruth/registrations/.*\.journal$", 2, ("append",), "main")
    depth = Fault(r"traversals/[^/]+/depth/.*\.png$", 3, ("rename",), "main")
    for number, stage in enumerate((registrations, depth)):  # within the submaps: test_groundtruth_submaps
        command = ["python", "-m", "relocbench", *arguments, "-j", 2 - number]
        run_until_killed(command, stage, tmp_path / f"trace{number}")
        assert not (out / "dataset.yaml").exists()
    journals = list(out.glob("groundtruth/registrations/*"))
    assert journals
    assert all(p.suffix == ".csv" for p in journals)
    assert relocbench(*arguments, "-j", 2).status == 0
    assert hashes(out) == hashes(built.root)


def copied(drives: Drives, folder: Path) -> tuple[Path, Path]:
    """Reference and query in a folder of their own, to be damaged."""
    for source in (drives.reference.folder, drives.query.folder):
        shutil.copytree(source, folder / source.name)
    for name in ("extrinsics", "models", "tags"):
        shutil.copytree(drives.reference.folder.parent / name, folder / name)
    return folder / drives.reference.name, folder / drives.query.name


def pose_words(drives: Drives, built: Built, moved: Array) -> str:
    """``--first-pose`` of a moment in the middle of the drive; the truth is multiplied by ``moved``."""
    pair = built.dataset.pair_set(drives.pair_set).pairs[5]
    rig = built.dataset.traversal(drives.query.name).T_rig_cam("stereo_left")
    T_ref_query = rig @ invert(drives.exact(pair)) @ invert(rig) @ moved
    t, q = transform_to_tq(T_ref_query)
    return " ".join(map(str, [pair.ref_timestamp_ns, pair.query_timestamp_ns, *t.tolist(), *q.tolist()]))


def test_limits_of_sigma_hold_and_a_right_first_pose_is_taken(drives: Drives, built: Built, tmp_path: Path) -> None:
    out = tmp_path / "dataset"
    first = pose_words(drives, built, np.eye(4))
    outcome = build(out, drives.reference.folder, drives.query.folder, "--max-sigma", 0.0002, "--first-pose", first)
    assert outcome.status == 2
    assert "no pair of 2024-03-02-10-00-00 could be accepted; most often: sigma" in outcome.err
    assert "exceeds 0.0002 m" in outcome.err
    assert "does not hold" not in outcome.err
    with next((out / "groundtruth" / "registrations").glob("*.csv")).open(newline="") as stream:
        assert all(row["trusted"] == "1" for row in csv.DictReader(stream))


@pytest.fixture(scope="module")
def unusual(drives: Drives, built: Built, tmp_path_factory: pytest.TempPathFactory) -> Built:
    """A gap in the visual odometry, a first pose 6 m off, empty scans, depth by stereo."""
    folder = tmp_path_factory.mktemp("unusual")
    reference, query = copied(drives, folder)
    path = query / "vo" / "vo.csv"
    header, *rows = path.read_text().splitlines()
    start = int(rows[0].split(",")[1])
    kept = [row for row in rows if not GAP_US[0] <= int(row.split(",")[0]) - start <= GAP_US[1]]
    assert len(kept) < len(rows) - 8
    path.write_text("\n".join([header, *kept]) + "\n")
    for scan in sorted((query / "lms_rear").glob("*.bin"))[20:24]:
        scan.write_bytes(np.zeros((541, 3)).tobytes())
    out = folder / "dataset"
    first = pose_words(drives, built, se3_exp(np.array([6.0, 0, 0, 0, 0, 0])))
    others = ("--depth", "stereo", "--cameras", "stereo_left", "--max-angle", 50)
    outcome = build(out, reference, query, "--first-pose", first, *others)
    assert outcome.status == 0, outcome.err
    return Built(out, outcome)


def test_pairs_in_a_gap_of_the_odometry_are_rejected_and_the_rest_is_right(drives: Drives, unusual: Built) -> None:
    rows = table(unusual, drives.pair_set)
    gap = [int(r["query_timestamp_ns"]) for r in rows if r["reason"] == "no odometry at the time of the query"]
    accepted = [int(r["query_timestamp_ns"]) for r in rows if r["accepted"] == "true"]
    assert gap
    # Beyond the gap the drive is found again.
    assert min(accepted) < min(gap) < max(gap) < max(accepted)
    errors = drives.errors(unusual.dataset)
    assert errors[:, 0].max() < 0.10
    assert errors[:, 1].max() < 0.15


def test_a_wrong_first_pose_is_found_out(unusual: Built) -> None:
    assert "the given pose of query node" in unusual.outcome.err
    assert "does not hold" in unusual.outcome.err


def test_depth_by_stereo_is_dense_and_says_so(drives: Drives, unusual: Built) -> None:
    traversal = unusual.dataset.traversal(drives.reference.name)
    assert "depth from stereo" in traversal.layout.traversal_yaml.read_text()
    depth = [traversal.depth("stereo_left", t) for t in traversal.keyframe_timestamps("stereo_left")]
    assert all(d is not None and (d > 0).mean() > 0.05 for d in depth)


def test_a_drive_the_other_way_has_no_keyframe_that_looks_its_way(drives: Drives, tmp_path: Path) -> None:
    outcome = build(tmp_path / "dataset", drives.reference.folder, drives.backwards.folder)
    assert outcome.status == 2
    complaint = next(line for line in outcome.err.splitlines() if line.startswith("relocbench: "))
    assert re.search(r"could be accepted; most often: no keyframe within 60 deg: 1[78]\d deg", complaint), complaint


def test_drives_that_never_meet_are_told_so(drives: Drives, tmp_path: Path) -> None:
    outcome = build(tmp_path / "dataset", drives.reference.folder, drives.far.folder)
    assert outcome.status == 2
    assert "the reference did not come by, as far as the prior tells" in outcome.err


Damage = Callable[[Path, Path], list[object]]


def cut_scan(reference: Path, query: Path) -> list[object]:
    path = sorted((query / "lms_front").glob("*.bin"))[7]
    path.write_bytes(path.read_bytes()[:-5])
    return [reference, query]


def scan_of_nans(reference: Path, query: Path) -> list[object]:
    path = sorted((query / "lms_front").glob("*.bin"))[7]
    path.write_bytes(np.full((541, 3), np.nan).tobytes())
    return [reference, query]


def scan_without_bytes(reference: Path, query: Path) -> list[object]:
    sorted((reference / "lms_rear").glob("*.bin"))[0].write_bytes(b"")
    return [reference, query]


def scans_without_returns(reference: Path, query: Path) -> list[object]:
    for path in query.glob("lms_*/*.bin"):
        path.write_bytes(np.zeros((541, 3)).tobytes())
    return [reference, query]


def timestamps_out_of_order(reference: Path, query: Path) -> list[object]:
    path = query / "lms_front.timestamps"
    lines = path.read_text().splitlines()
    lines[3], lines[4] = lines[4], lines[3]
    path.write_text("\n".join(lines) + "\n")
    return [reference, query]


def odometry_out_of_order(reference: Path, query: Path) -> list[object]:
    path = query / "vo" / "vo.csv"
    lines = path.read_text().splitlines()
    lines[5], lines[6] = lines[6], lines[5]
    path.write_text("\n".join(lines) + "\n")
    return [reference, query]


def missing_folder(reference: Path, query: Path) -> list[object]:
    return [reference, query.parent / "2024-12-24-10-00-00"]


def one_source(reference: Path, query: Path) -> list[object]:
    return [reference]


def the_same_twice(reference: Path, query: Path) -> list[object]:
    return [reference, reference]


def unknown_camera(reference: Path, query: Path) -> list[object]:
    return [reference, query, "--cameras", "stereo_top"]


def camera_that_is_not_there(reference: Path, query: Path) -> list[object]:
    return [reference, query, "--cameras", "mono_rear"]


def no_images(reference: Path, query: Path) -> list[object]:
    shutil.rmtree(query / "stereo")
    return [reference, query]


def first_pose_of_another_day(reference: Path, query: Path) -> list[object]:
    return [reference, query, "--first-pose", "1 2 0 0 0 0 0 0 1"]


def first_pose_that_is_none(reference: Path, query: Path) -> list[object]:
    return [reference, query, "--first-pose", "0 0 0 0 0 1"]


def stereo_without_a_partner(reference: Path, query: Path) -> list[object]:
    shutil.rmtree(query / "stereo" / "right")
    return [reference, query, "--depth", "stereo"]


def out_inside_a_recording(reference: Path, query: Path) -> list[object]:
    return [reference, query, "--out", query / "dataset"]


DAMAGES: list[tuple[Damage, str]] = [
    (cut_scan, r"lms_front/\d+\.bin: \d+ bytes are not a whole number of points"),
    (scan_of_nans, r"lms_front/\d+\.bin: holds a value that is not finite"),
    (scan_without_bytes, r"lms_rear/\d+\.bin: is empty"),
    (timestamps_out_of_order, r"lms_front\.timestamps:[45]: "),
    (odometry_out_of_order, r"vo\.csv:\d+: "),
    (missing_folder, r"2024-12-24-10-00-00: no such folder"),
    (one_source, r"needs a reference and at least one other, got 1"),
    (the_same_twice, r"is given twice; expected different recordings"),
    (unknown_camera, r"no camera 'stereo_top'; available: stereo_left"),
    (camera_that_is_not_there, r"mono_rear: no such folder; expected images"),
    (no_images, r"--cameras: 2024-03-02-10-00-00 has no images of a camera 'stereo_left'"),
    (first_pose_of_another_day, r"--first-pose: 1 \(nanoseconds\) is outside the times of 2024-03-01-10-00-00"),
    (first_pose_that_is_none, r"--first-pose: expected 'REF_NS QUERY_NS tx ty tz qx qy qz qw'"),
    (stereo_without_a_partner, r"--depth stereo: 2024-03-02-10-00-00 has no camera to the right of stereo_left"),
    (out_inside_a_recording, r"lies inside the recording"),
]


def test_scans_without_returns_are_told_for_each_lidar(drives: Drives, tmp_path: Path) -> None:
    reference, query = copied(drives, tmp_path / "recordings")
    outcome = build(tmp_path / "dataset", *scans_without_returns(reference, query))
    assert outcome.status == 2
    complaints = [line for line in outcome.err.splitlines() if line.startswith("relocbench: ")]
    assert len(complaints) == 2
    for line, lidar in zip(complaints, ("lms_front", "lms_rear"), strict=True):
        assert f"{query}: {lidar}: its first, middle and last scan have no point within 50 m" in line


def test_without_any_odometry_it_is_said_what_is_needed(drives: Drives, tmp_path: Path) -> None:
    reference, query = copied(drives, tmp_path / "recordings")
    (query / "vo" / "vo.csv").unlink()
    outcome = build(tmp_path / "dataset", reference, query)
    assert outcome.status == 2
    assert "vo/vo.csv, or scans of a Velodyne to compute it from" in outcome.err
    assert "single planes), or --odometry ins" in outcome.err


@pytest.mark.parametrize(("damage", "words"), DAMAGES, ids=[damage.__name__ for damage, _ in DAMAGES])
def test_what_is_wrong_is_one_line_and_status_2(drives: Drives, tmp_path: Path, damage: Damage, words: str) -> None:
    reference, query = copied(drives, tmp_path / "recordings")
    outcome = build(tmp_path / "dataset", *damage(reference, query))
    assert outcome.status == 2
    assert "Traceback" not in outcome.err
    complaints = [line for line in outcome.err.splitlines() if line.startswith("relocbench: ")]
    assert len(complaints) == 1
    assert re.search(words, complaints[0]), complaints[0]

"""Trajectories and files of pairs become datasets without images, by the commands a user types."""

from __future__ import annotations

import itertools
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import relocbench
from recording_reading import hashes
from refusals import ErrorData, assert_names
from repository import ROOT
from two_laps import LAP, START_NS, laps, matrix_lines, tum_lines

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair, read_pose_lines
from relocbench.datasets.core.schema import POSES_VERSION
from relocbench.geometry import invert, make_transform, rotation_angle, so3_exp

REAL = Path(os.environ.get("RELOCBENCH_REAL_DATA", ROOT.parent / "shared" / "data"))
WINTER_NS = START_NS + 10**14
SUMMER, WINTER = laps(1), laps(1, start_ns=WINTER_NS)
WINTER = {time: pose @ make_transform(so3_exp(np.array([0.01, 0.0, 0.05])), [0.7, 0.2, 0.1])
          for time, pose in WINTER.items()}  # fmt: skip


@pytest.fixture
def drives(tmp_path: Path) -> list[Path]:
    """Two drives of one loop, in a folder whose name has a blank."""
    folder = tmp_path / "my drives"
    folder.mkdir()
    for name, poses in (("summer", SUMMER), ("winter", WINTER)):
        (folder / f"{name}.txt").write_text(tum_lines(poses))
    return [folder / "summer.txt", folder / "winter.txt"]


def built(out: Path, *arguments: object, kind: str = "poses") -> Dataset:
    outcome = relocbench("build-dataset", kind, *arguments, "--out", out, "-q")
    assert outcome.status == 0, outcome.err
    checked = relocbench("validate", out)
    assert checked.status == 0, checked.out
    return Dataset(out)


def test_queries_of_the_second_drive_have_the_nearest_keyframe_of_the_first(drives: list[Path], tmp_path: Path) -> None:
    config = tmp_path / "c.yaml"
    config.write_text("conditions:\n  summer: {season: summer}\n  winter: {season: winter, weather: snow}\n")
    dataset = built(tmp_path / "d", *drives, "--config", config, "--frame", "lidar", "--max-distance", 3)
    assert dataset.file.format_version == POSES_VERSION
    assert (dataset.traversal("summer").cameras, dataset.traversal("summer").frames) == ([], ["lidar"])
    assert str(dataset.traversal("winter").condition) == "snow, winter"
    (pair_set,) = dataset.pair_sets()
    assert pair_set.name == "summer__winter__lidar"
    assert len(pair_set.pairs) == LAP
    for pair in pair_set.pairs:
        expected = invert(WINTER[pair.query_timestamp_ns]) @ SUMMER[pair.ref_timestamp_ns]
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref, expected, atol=2e-8)
        apart = [np.linalg.norm((T - WINTER[pair.query_timestamp_ns])[:3, 3]) for T in SUMMER.values()]
        assert pair.distance_m == pytest.approx(min(apart), abs=1e-8)
    assert not dataset.has_images(pair_set)
    assert not list((tmp_path / "d").glob("traversals/*/images"))
    assert not (tmp_path / "d" / "correspondences").exists()


@pytest.mark.thorough
def test_every_format_gives_the_same_pairs_and_the_same_bytes(drives: list[Path], tmp_path: Path) -> None:
    plain = built(tmp_path / "d", *drives)
    other = tmp_path / "other"
    other.mkdir()
    (other / "summer.kitti").write_text(matrix_lines(SUMMER, timed=False))
    (other / "summer-times.txt").write_text("".join(f"{t}\n" for t in SUMMER))
    (other / "winter.txt").write_text(matrix_lines(WINTER, timed=True))
    times = f"{other / 'summer-times.txt'},{other / 'summer-times.txt'}"
    found = built(tmp_path / "e", other / "summer.kitti", other / "winter.txt", "--times", times)
    own = built(tmp_path / "f", *(tmp_path / "d" / "traversals" / name / "poses.csv" for name in ("summer", "winter")))
    (one,), (two,), (three,) = plain.pair_sets(), found.pair_sets(), own.pair_sets()
    assert [p.key for p in one.pairs] == [p.key for p in two.pairs] == [p.key for p in three.pairs]
    for a, b, c in zip(one.pairs, two.pairs, three.pairs, strict=True):
        assert a.T_query_ref is not None
        assert b.T_query_ref is not None
        assert c.T_query_ref is not None
        np.testing.assert_allclose(a.T_query_ref, b.T_query_ref, atol=2e-9)
        np.testing.assert_allclose(a.T_query_ref, c.T_query_ref, atol=2e-7)
    before = hashes(tmp_path / "d")
    (tmp_path / "d" / "dataset.yaml").unlink()
    built(tmp_path / "d", *drives)
    assert hashes(tmp_path / "d") == before


def test_revisits_of_one_drive_have_older_keyframes_beside_them(tmp_path: Path) -> None:
    (tmp_path / "two.txt").write_text(tum_lines(laps(2)))
    dataset = built(tmp_path / "d", tmp_path / "two.txt", "--revisit-gap", 20, "--max-distance", 3)
    (pair_set,) = dataset.pair_sets()
    assert LAP - 2 <= len(pair_set.pairs) <= LAP
    for pair in pair_set.pairs:
        assert pair.query_timestamp_ns - pair.ref_timestamp_ns >= 20 * 10**9
        assert pair.distance_m is not None
        assert pair.distance_m < 3


def test_one_drive_is_paired_with_its_own_next_poses_at_a_stated_spacing(tmp_path: Path) -> None:
    poses = laps(1)
    (tmp_path / "one.txt").write_text(tum_lines(poses))
    dataset = built(tmp_path / "d", tmp_path / "one.txt", "--keyframe-distance", 10, "--pair-step", "1,2")
    (pair_set,) = dataset.pair_sets()
    near = [p for p in pair_set.pairs if p.group == "step_1"]
    assert {p.group for p in pair_set.pairs} == {"step_1", "step_2"}
    assert all(p.distance_m is not None and 10 < p.distance_m < 15 for p in near)
    assert all(a.query_timestamp_ns == b.ref_timestamp_ns for a, b in itertools.pairwise(near))


def test_spacing_thins_keyframes_and_queries_each_by_its_own_distance(drives: list[Path], tmp_path: Path) -> None:
    spaced = ("--keyframe-distance", 20, "--query-distance", 8, "--max-distance", 15)
    (pair_set,) = built(tmp_path / "d", *drives, *spaced).pair_sets()
    way = LAP * 2 * np.pi * 40 / LAP
    assert len({p.ref_timestamp_ns for p in pair_set.pairs}) <= way / 20 + 1
    assert way / 13 < len(pair_set.pairs) <= way / 8 + 1


@pytest.mark.thorough
def test_sigmas_of_pairs_follow_from_those_of_poses(drives: list[Path], tmp_path: Path) -> None:
    """Checked against pairs of poses that are wrong at random by as much."""
    (pair_set,) = built(tmp_path / "d", *drives, "--sigma", 0.02, "--sigma-rotation", 1.0).pair_sets()
    pair = max(pair_set.pairs, key=lambda p: p.distance_m or 0.0)
    rng = np.random.default_rng(1)

    def moved(T: np.ndarray) -> np.ndarray:
        wrong = T.copy()
        wrong[:3, :3] = so3_exp(np.radians(rng.normal(size=3))) @ T[:3, :3]
        wrong[:3, 3] += 0.02 * rng.normal(size=3)
        return wrong

    true = invert(SUMMER[pair.ref_timestamp_ns]) @ WINTER[pair.query_timestamp_ns]
    centres, angles = [], []
    for _ in range(4000):
        T_ref_query = invert(moved(SUMMER[pair.ref_timestamp_ns])) @ moved(WINTER[pair.query_timestamp_ns])
        centres.append((T_ref_query - true)[:3, 3])
        angles.append(np.degrees(rotation_angle(true[:3, :3].T @ T_ref_query[:3, :3])) / np.sqrt(3))
    assert pair.sigma_translation_m == pytest.approx(np.sqrt(np.mean(np.square(centres))), rel=0.03)
    assert pair.sigma_rotation_deg == pytest.approx(np.sqrt(np.mean(np.square(angles))), rel=0.03)


def test_files_of_the_same_name_are_called_after_their_folders(drives: list[Path], tmp_path: Path) -> None:
    for drive in drives:
        (tmp_path / drive.stem).mkdir()
        shutil.copy(drive, tmp_path / drive.stem / "poses.txt")
    dataset = built(tmp_path / "d", tmp_path / "summer" / "poses.txt", tmp_path / "winter" / "poses.txt")
    assert dataset.pair_set_names == ["summer__winter__rig"]
    dataset = built(tmp_path / "e", *drives, "--traversals", "A,B")
    assert dataset.pair_set_names == ["A__B__rig"]


def test_what_looks_misread_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(tum_lines(laps(2), "wxyz"))
    told = relocbench("build-dataset", "poses", tmp_path / "a.txt", "--out", tmp_path / "d").err
    assert_names(told, "", None, "xyzw", "wxyz")
    right = relocbench("build-dataset", "poses", tmp_path / "a.txt", "--quaternions", "wxyz", "--out", tmp_path / "e")
    assert (right.status, "wxyz" in right.err) == (0, False)
    origin = invert(next(iter(SUMMER.values())))
    for name, poses in (("b", SUMMER), ("c", WINTER)):
        first = invert(next(iter(poses.values())))
        (tmp_path / f"{name}.txt").write_text(tum_lines({t: first @ T for t, T in poses.items()}))
    both = relocbench("build-dataset", "poses", tmp_path / "b.txt", tmp_path / "c.txt", "--out", tmp_path / "f").err
    assert "millimetre" in both
    assert origin.shape == (4, 4)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.txt"], ("nowhere.txt",)),
        (["."], ("", None, "folder")),
        (["summer.txt", "summer.txt"], ("summer.txt",)),
        (["summer.txt", "winter.txt", "--traversals", "A"], ("", None, "--traversals", "1", "2")),
        (["summer.txt", "winter.txt", "--traversals", "A,A"], ("", None, "--traversals")),
        (["summer.txt", "winter.txt", "--traversals", "A,a"], ("", None, "A", "a")),
        (["summer.txt", "winter.txt", "--traversals", "A,b__c"], ("", None, "b__c", "--traversals")),
        (["summer.txt", "winter.txt", "--revisit-gap", "3"], ("", None, "--revisit-gap")),
        (["summer.txt", "winter.txt", "--pair-rule", "step"], ("", None, "--pair-rule")),
        (["summer.txt", "winter.txt", "--times", "t.txt"], ("", None, "--times", "1", "2")),
        (["summer.txt", "--query-distance", "3"], ("", None, "--query-distance")),
        (["summer.txt", "--pair-rule", "step", "--revisit-gap", "3"], ("", None, "pair_rule")),
        (["summer.txt", "--revisit-gap", "9999"], ("", None, "9999")),
        (
            ["summer.txt", "far.txt"],
            ("", None, "177", "--max-distance", "5", "--max-angle", "60"),
        ),
        (["summer.txt", "--frame", "a/b"], ("", None, "a/b")),
        (["summer.txt", "--sigma", "0"], ("", None, "sigma")),
        (["summer.txt", "--correspondences", "9"], ("", None, "--correspondences")),
        (["summer.txt", "--conditions", "x"], ("", None, "--conditions")),
    ],
)
def test_bad_input_is_one_line_and_leaves_no_dataset(
    drives: list[Path], tmp_path: Path, arguments: list[str], words: ErrorData, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(drives[0].parent)
    far = {time: make_transform(T[:3, :3], T[:3, 3] + [1e4, 0, 0]) for time, T in WINTER.items()}
    Path("far.txt").write_text(tum_lines(far))
    outcome = relocbench("build-dataset", "poses", *arguments, "--out", tmp_path / "d", "-q")
    assert outcome.status == 2
    assert_names(outcome.complaint, *words)
    assert not (tmp_path / "d" / "dataset.yaml").exists()


def test_a_file_of_pairs_is_the_truth_as_it_stands(drives: list[Path], tmp_path: Path) -> None:
    made = built(tmp_path / "d", *drives)
    (source,) = (tmp_path / "d" / "pairs").glob("*.txt")
    file = shutil.copy(source, tmp_path / "relocalizationFile_summer_to_winter.txt")
    dataset = built(tmp_path / "p", file, "--sigma", 0.05, "--sigma-rotation", 0.1, kind="pair-files")
    (pair_set,) = dataset.pair_sets()
    assert pair_set.name == "summer__winter__cam0"
    known = {line.key: line.T_query_ref for line in read_pose_lines(source)}
    assert [p.key for p in pair_set.pairs] == list(known)
    for pair in pair_set.pairs:
        T_query_ref = known[pair.key]
        assert T_query_ref is not None
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref, T_query_ref, atol=3e-9)
    assert {(p.sigma_translation_m, p.sigma_rotation_deg, p.source) for p in pair_set.pairs} == {
        (0.05, 0.1, "relocalizationFile_summer_to_winter.txt")
    }
    assert dataset.traversal("winter").poses == {}
    own = built(tmp_path / "q", source, kind="pair-files")
    assert own.pair_set_names == made.pair_set_names
    assert [p.group for p in own.pair_sets()[0].pairs] == ["nearest"] * LAP


def test_poses_of_the_reference_place_queries_too(drives: list[Path], tmp_path: Path) -> None:
    built(tmp_path / "d", *drives)
    (source,) = (tmp_path / "d" / "pairs").glob("*.txt")
    placed = f"summer={drives[0]}"
    dataset = built(tmp_path / "p", source, "--trajectories", placed, kind="pair-files")
    found = dataset.traversal("winter").poses
    assert sorted(found) == sorted(WINTER)
    np.testing.assert_allclose([found[t] for t in WINTER], list(WINTER.values()), atol=1e-6)
    assert relocbench("export", "-d", tmp_path / "p", "-f", "tum", "-o", tmp_path / "t").status == 0


def _pairs(*lines: str) -> str:
    return "".join(f"{line}\n" for line in lines)


@pytest.mark.parametrize(
    ("name", "text", "arguments", "words"),
    [
        ("a_to_b.txt", "", [], ("a_to_b.txt",)),
        ("a_to_b.txt", _pairs("1 2 0 0 0 0 0 0 2"), [], ("a_to_b.txt", 1, "2", "1")),
        ("a_to_b.txt", _pairs("1 2 0 0 0"), [], ("a_to_b.txt", 1, "2", "9")),
        ("a_to_b.txt", _pairs("1 2", "1 2"), [], ("a_to_b.txt", 2, "1", "2")),
        ("a_to_b.txt", _pairs("1.5 2"), [], ("", None, "1.5")),
        (
            "pairs.txt",
            _pairs("1 2"),
            [],
            ("", None, "REF,QUERY"),
        ),
        ("pairs.txt", _pairs("1 2"), ["--traversals", "a"], ("", None, "--traversals")),
        ("a_to_b.txt", _pairs("1 2"), ["--trajectories", "x"], ("", None, "x", "--trajectories")),
        ("a_to_b.txt", _pairs("1 2"), ["--trajectories", "c=x"], ("", None, "c")),
        ("a_to_b.txt", _pairs("1 2"), ["--trajectories", "a=nowhere"], ("nowhere",)),
    ],
)
def test_a_bad_file_of_pairs_is_refused_in_one_line(
    tmp_path: Path, name: str, text: str, arguments: list[str], words: ErrorData, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text)
    outcome = relocbench("build-dataset", "pair-files", name, *arguments, "--out", "d", "-q")
    assert outcome.status == 2
    assert_names(outcome.complaint, *words)


@pytest.mark.thorough
@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")
def test_real_trajectories_revisit_places_and_are_scored(tmp_path: Path) -> None:
    """The business campus of 4Seasons was driven round more than once in one recording."""
    source = REAL / "fourseasons_trajectories" / "4seasons_business_2020-10-08_09-30-57.txt"
    arguments = ("--quaternions", "wxyz", "--traversals", "business", "--frame", "cam0", "--revisit-gap", 20)
    spaced = ("--keyframe-distance", 2, "--query-distance", 2, "--max-distance", 3)
    (pair_set,) = built(tmp_path / "d", source, *arguments, *spaced).pair_sets()
    assert len(pair_set.pairs) > 500
    distances = [p.distance_m for p in pair_set.pairs if p.distance_m is not None]
    # Each lap was driven on the same side of the road: the median is half the distance between keyframes.
    assert 0.3 < float(np.median(distances)) < 1.2
    assert max(p.angle_deg or 0.0 for p in pair_set.pairs) < 15


@pytest.mark.thorough
@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real recordings at {REAL}")
def test_real_pair_files_and_a_trajectory_of_their_reference_fit_together(tmp_path: Path) -> None:
    """The challenge withholds the poses; the times of its keyframes are those of the published trajectory."""
    name = "recording_2020-06-12_11-26-43_to_recording_2021-01-07_14-03-57"
    source = REAL / "mlad_pair_files" / "spatialai-eccv2024" / f"relocalizationFile_{name}.txt"
    file = REAL / "fourseasons_trajectories" / "4seasons_country_2020-06-12_11-26-43.txt"
    placed = f"recording_2020-06-12_11-26-43={file}"
    outcome = relocbench("build-dataset", "pair-files", source, "--trajectories", placed, "--quaternions", "wxyz",
                         "--out", tmp_path / "d")  # fmt: skip
    assert outcome.status == 0, outcome.err
    assert_names(outcome.err, source.name, None, "703 of 703")
    assert "no pose at" not in outcome.err
    dataset = Dataset(tmp_path / "d")
    (pair_set,) = dataset.pair_sets()
    assert (len(pair_set.evaluated), pair_set.has_truth) == (703, False)
    reference = dataset.traversal(pair_set.reference)
    assert {p.ref_timestamp_ns for p in pair_set.evaluated} <= set(reference.poses)
    assert [line.key for line in read_pose_lines(source)] == [p.key for p in _as_listed(source, pair_set.by_key)]
    assert relocbench("validate", tmp_path / "d").status == 0


def _as_listed(source: Path, by_key: dict[tuple[int, int], Pair]) -> list[Pair]:
    return [by_key[line.key] for line in read_pose_lines(source)]


def test_the_description_of_other_datasets_is_written_as_before(tmp_path: Path) -> None:
    """Frames are in a description only where there are any: fingerprints of earlier datasets stay."""
    from small_dataset import make_small_dataset

    dataset = make_small_dataset(tmp_path / "d")
    text = (tmp_path / "d" / "traversals" / "summer" / "traversal.yaml").read_text()
    assert "frames" not in yaml.safe_load(text)
    assert not re.search(r"^frames", text, re.MULTILINE)
    assert dataset.file.format_version < POSES_VERSION

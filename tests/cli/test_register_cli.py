"""``relocbench register``: what it prints and writes, its exit status, and its words for bad input."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from register_scenes import Pair, room_pair

from relocbench.geometry import invert, make_transform, so3_exp

FindData = Callable[[str], Path]


@pytest.fixture(scope="module")
def pair() -> Pair:
    return room_pair(1)


@pytest.fixture(scope="module")
def files(pair: Pair, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("two clouds")
    for name, cloud in (("a", pair.a), ("b", pair.b)):
        np.save(folder / f"{name}.npy", cloud.points)
    return folder / "a.npy", folder / "b.npy"


@pytest.mark.thorough
def test_a_trusted_registration_is_printed_and_written_and_exits_0(
    pair: Pair, files: tuple[Path, Path], tmp_path: Path
) -> None:
    outcome = relocbench("register", *files, "--out", tmp_path / "out", "--save-cloud", "--json")
    assert outcome.status == 0, outcome.err
    told = json.loads(outcome.out)
    assert told["trusted"]
    assert told["counts"]["files_written"] == 7
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {
        "registration.json", "covariance.txt", "pose.txt", "pose_tum.txt", "before_after.png", "residuals.png",
        "b_in_a.ply",
    }  # fmt: skip
    T = np.loadtxt(tmp_path / "out" / "pose.txt")
    np.testing.assert_array_equal(T, told["T_a_b"])
    np.testing.assert_allclose(T, pair.T_a_b, atol=5e-3)
    covariance = np.loadtxt(tmp_path / "out" / "covariance.txt")
    np.testing.assert_allclose(covariance @ np.array(told["information"]), np.eye(6), atol=1e-6)


@pytest.mark.thorough
def test_what_is_not_trusted_exits_1_with_the_reason(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cube = rng.uniform(-1, 1, size=(30_000, 3))  # which looks alike from all sides
    cube[np.arange(len(cube)), rng.integers(3, size=len(cube))] = rng.choice([-1.0, 1.0], len(cube))
    for name, points in (("a", cube[:15_000]), ("b", cube[15_000:])):
        np.save(tmp_path / name, points + 0.002 * rng.normal(size=points.shape))
    outcome = relocbench("register", tmp_path / "a.npy", tmp_path / "b.npy", "--initial", "0 0 0 0 0 0 1", "-q")
    assert outcome.status == 1
    assert outcome.out.startswith("verdict: not trusted: ")


@pytest.mark.thorough
def test_a_folder_with_poses_is_put_together(pair: Pair, files: tuple[Path, Path], tmp_path: Path) -> None:
    scans = tmp_path / "scans of a room"
    scans.mkdir()
    for k, cloud in enumerate((pair.a, pair.b)):
        cloud.points.astype("<f4").tofile(scans / f"{k}.bin")
    T = make_transform(so3_exp([0, 0, 0.5]), [2.0, 1.0, 0.0])
    rows = [T, T @ pair.T_a_b]
    (tmp_path / "poses.txt").write_text("".join(" ".join(map(repr, pose[:3].ravel().tolist())) + "\n" for pose in rows))
    outcome = relocbench("register", scans, files[0], "--poses", tmp_path / "poses.txt", "--json", "-q")
    assert outcome.status == 0, outcome.out + outcome.err
    np.testing.assert_allclose(json.loads(outcome.out)["T_a_b"], T, atol=5e-3)


@pytest.mark.thorough
def test_all_pairs_of_a_folder_are_compared_with_a_graph(real_data: FindData) -> None:
    folder = real_data("lidar_submaps_with_graph") / "newer_01"
    outcome = relocbench("register", folder, "--files", "planes_0000[01]0.bin", "--json", "-q")
    assert outcome.status == 0, outcome.err
    told = json.loads(outcome.out)
    assert told["counts"] == {"pairs": 1, "trusted": 1}
    T = np.array(told["pairs"][0]["T_a_b"])
    assert np.linalg.norm(invert(T)[:3, 3]) == pytest.approx(1.09, abs=0.05)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere.ply", "a.npy"), "nowhere.ply: missing"),
        (("a.npy", "empty"), "empty: no file is a point cloud"),
        (("a.npy", "a.npy", "--initial", "1 2 3"), "expected 'tx ty tz qx qy qz qw', found 3 numbers"),
        (("a.npy", "a.npy", "--initial", "0 0 0 0 0 0 2"), "--initial: quaternion qx qy qz qw has norm 2"),
        (("a.npy", "a.npy", "--save-cloud"), "--save-cloud writes into the folder of --out"),
        (("a.npy", "a.npy", "--poses", "a.npy"), "--poses is given 1 times, but 0 of A and B are folders"),
        (("a.npy", "picture.png"), "picture.png: is not a point cloud by its name"),
        (("a.npy",), "expected a second cloud"),
        (("a.npy", "few.npy"), "few.npy: has 3 points; registration needs at least 200"),
        (("a.npy", "nothing.npy"), "nothing.npy: all of its 500 points are zero or not finite"),
    ],
)
def test_bad_input_is_one_line_and_exits_2(
    files: tuple[Path, Path], tmp_path: Path, arguments: tuple[str, ...], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.npy").write_bytes(files[0].read_bytes())
    np.save(tmp_path / "few.npy", np.eye(3))
    np.save(tmp_path / "nothing.npy", np.zeros((500, 3)))
    (tmp_path / "picture.png").write_bytes(b"\x89PNG")
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    outcome = relocbench("register", *arguments, "-q")
    assert outcome.status == 2
    assert said in outcome.err
    assert outcome.err.count("\n") == 1

"""The recordings of the page of real sets: made as their tools say, and printed as the leaderboard has them."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import cv2
import generic_folder
import kitti_lidar_poses
import numpy as np
import pandas as pd
import pytest
import real
import still_camera
from repository import ROOT

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.generic import dataset as generic
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.geometry import invert
from relocbench.progress import Silent

RECORDINGS = Path(os.environ.get("RELOCBENCH_REAL_DATA", ROOT.parent / "shared" / "data"))


def photographs(folder: Path, days: int, size: tuple[int, int] = (640, 420), hour: int = 12) -> Path:
    """Smooth noise, the same on every day but for its light, as a camera that never moves would take it."""
    folder.mkdir(parents=True)
    noise = np.random.default_rng(3).uniform(0, 255, size=(size[1], size[0], 3))
    scene = cv2.GaussianBlur(noise, (0, 0), 4.0)
    scene = 128 + 5 * (scene - scene.mean())
    for day in range(days):
        light = np.clip(scene * (1.0 - 0.04 * day), 0, 255)
        cv2.imwrite(str(folder / f"201301{day + 1:02d}_{hour}0000.png"), light.astype(np.uint8))
    return folder


def copied(folder: Path, to: str, source: str) -> None:
    (folder / to).write_bytes((folder / source).read_bytes())


def smaller(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((400, 600, 3), dtype=np.uint8))


def made(out: Path, *folders: Path, pairs: int = 4, seed: int = 0) -> Path:
    rng = np.random.default_rng(seed)
    drawn = {folder.name: still_camera.draw(folder, pairs, rng) for folder in folders}
    generic_folder.write(out, still_camera.views(drawn))
    return out


def imported(still: Path, names: list[str], out: Path) -> Dataset:
    sources = [still / name for name in ("map", *names)]
    return generic.build(sources, generic.Options(), out, Silent(), Run(workers=0))


@pytest.mark.thorough
def test_a_query_shows_every_point_where_its_pose_and_the_depth_of_the_keyframe_say(tmp_path: Path) -> None:
    larger, smaller = photographs(tmp_path / "a", 8), photographs(tmp_path / "b", 8, (540, 400), hour=15)
    still = made(tmp_path / "still", larger, smaller)
    dataset = imported(still, ["a", "b"], tmp_path / "set")
    seen = 0
    for pair_set in dataset.pair_sets():
        assert len(pair_set.pairs) == 4
        for pair in pair_set.pairs:
            reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
            assert reference.depth is not None
            assert pair.T_query_ref is not None
            v, u = np.mgrid[8:320:8, 8:480:8].reshape(2, -1)
            rays, _ = reference.camera.unproject(np.stack([u, v], axis=-1))
            points = rays * reference.depth[v, u][:, None]
            uv, valid = query.camera.project(points @ pair.T_query_ref[:3, :3].T + pair.T_query_ref[:3, 3])
            valid &= query.camera.contains(uv)
            at = uv[valid].astype(np.float32)[None]
            shown = cv2.remap(query.image, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0].astype(float)
            stood = reference.image[v, u][valid].astype(float)
            # The light of a day scales all grey values; the noise decorrelates over 8 pixels.
            assert np.corrcoef(shown.ravel(), stood.ravel())[0, 1] > 0.99
            assert np.linalg.norm(invert(pair.T_query_ref)[:3, 3]) <= still_camera.MOST_M + 1e-6
            seen += 1
    assert seen == 8


def test_the_same_seed_gives_the_same_bytes_and_another_one_other_motions(tmp_path: Path) -> None:
    source = photographs(tmp_path / "a", 8)
    first, again, other = (made(tmp_path / f"{i}", source, seed=seed) for i, seed in enumerate((0, 0, 1)))
    of_first = {path.relative_to(first): path.read_bytes() for path in sorted(first.rglob("*")) if path.is_file()}
    assert of_first == {p.relative_to(again): p.read_bytes() for p in sorted(again.rglob("*")) if p.is_file()}
    assert (first / "a" / "poses.txt").read_text() != (other / "a" / "poses.txt").read_text()


def test_no_image_is_in_two_pairs_and_cameras_have_names_of_their_own(tmp_path: Path) -> None:
    pairs = still_camera.draw(photographs(tmp_path / "a", 9), 4, np.random.default_rng(0))
    assert len({path for pair in pairs for path in (pair.reference, pair.query)}) == 8
    with pytest.raises(DatasetError, match="expected different names"):
        still_camera.named([tmp_path / "a", tmp_path / "b" / "a"])
    with pytest.raises(DatasetError, match="none of them 'map'"):
        still_camera.named([tmp_path / "map"])
    with pytest.raises(DatasetError, match="no such folder"):
        still_camera.draw(tmp_path / "none", 4, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda folder: (folder / "20130101_120000.png").rename(folder / "monday.png"), "expected a name YYYYMMDD"),
        (lambda folder: (folder / "20130101_120000.png").write_text("no image"), "no image that OpenCV can read"),
        (lambda folder: [p.unlink() for p in sorted(folder.iterdir())[2:]], "holds 2 different images; expected two"),
        (lambda folder: copied(folder, "20130102_120000.png", "20130101_120000.png"), "holds 7 different images"),
        (lambda folder: smaller(folder / "20130103_120000.png"), "20130103.* pixels; expected 640 x 420 as"),
    ],
)
def test_images_that_do_not_serve_are_refused(spoil: Callable[[Path], object], told: str, tmp_path: Path) -> None:
    source = photographs(tmp_path / "a", 8)
    spoil(source)
    with pytest.raises(DatasetError, match=told):
        made(tmp_path / "out", source)


@pytest.mark.thorough
def test_poses_of_kitti_00_by_its_scans_are_those_of_an_independent_registration(tmp_path: Path) -> None:
    kitti = RECORDINGS / "kitti_odometry"
    if not (kitti / "sequences" / "00" / "velodyne").is_dir():
        pytest.skip(f"no recordings in {RECORDINGS}")
    kitti_lidar_poses.write(kitti, "00", tmp_path / "posed")
    poses: Array = np.loadtxt(tmp_path / "posed" / "poses" / "00.txt").reshape(-1, 3, 4)
    # Generalized ICP of each scan to the first one, by the notes on the recording; along the lidar's x axis, which is
    # about the camera's z axis.
    assert np.allclose(poses[:, 2, 3], [0.0, 0.689, 1.382, 2.100, 2.832, 3.576], atol=0.02)


def board(**changes: object) -> pd.DataFrame:
    row: dict[str, object] = {
        "dataset": "kitti_06",
        "pair_set": "kitti_06__kitti_06__image_0",
        "group": "all",
        "method": "orb-pnp",
        "pairs": 20,
        "answered": 16,
        real.RIGHT: 0.7,
        f"{real.RIGHT}_low": 0.5,
        f"{real.RIGHT}_high": 0.85,
        real.PRECISE: 0.4,
        "median_translation_error_m": 0.02,
        "median_rotation_error_deg": 0.1,
        real.WRONG: 0.125,
        real.SURE: 0.5,
        real.SURE_RIGHT: 1.0,
        "confidence_auc_pr@(0.25m,2deg)": 0.9,
        "median_seconds": 0.2,
    }
    return pd.DataFrame([row | changes])


def test_a_row_counts_refusals_wrong_answers_and_sure_ones() -> None:
    floor = board(method="identity", answered=20, **{real.RIGHT: 0.9, real.SURE: 0.0, real.SURE_RIGHT: np.nan})
    floor["confidence_auc_pr@(0.25m,2deg)"] = np.nan
    rendered, total = board(dataset="town_demo"), board(pair_set="total")
    found = real.sets(pd.concat([board(), floor, rendered, total]))
    assert list(found) == ["kitti_06"]
    row, last = found["kitti_06"]
    assert (row.refused, row.wrong, row.sure, row.sure_right) == (4, 2, 10, 1.0)
    assert (last.method, last.sure) == ("identity", None)  # the floor stands last, however good it is
    text = real.table("kitti_06", [row, last])
    assert "| orb-pnp | 70.0 | 50.0 to 85.0 | 40.0 | 0.020 | 0.10 | 4 | 2 | 10 | 100.0 | 0.20 |" in text


def test_a_tracker_that_was_not_asked_of_a_set_has_an_empty_cell() -> None:
    other = "kitti_00__kitti_00__image_0"
    found = real.sets(pd.concat([board(), board(method="dso"), board(dataset="kitti_00", pair_set=other)]))
    lines = real.overview(found)
    assert lines[-2:] == ["| dso |  | 70.0 |", "| orb-pnp | 70.0 | 70.0 |"]


def test_a_dataset_whose_pair_sets_have_cameras_of_their_own_is_one_set() -> None:
    names = ("map__other_light__ArtL", "map__same_light__Shelf", "total")
    rows = [
        board(dataset="middlebury", pair_set=name, pairs=number) for name, number in zip(names, (1, 1, 2), strict=True)
    ]
    found = real.sets(pd.concat(rows))
    assert {name: [row.pairs for row in rows] for name, rows in found.items()} == {"middlebury": [2]}


def test_the_page_tells_of_the_sets_that_it_has() -> None:
    text = real.head({"kitti_06", "fr1_desk", "oxford"})
    assert [line.split(" | ")[0] for line in text.splitlines() if line.startswith("| ")][1:] == [
        "| kitti_06",
        "| fr1_xyz, fr1_desk",
        "| oxford",
    ]
    assert "focal length of `oxford`" in text
    assert "webcams" not in text


def test_the_published_page_is_what_the_published_leaderboard_gives() -> None:
    page = ROOT / "leaderboard" / "real" / "real.md"
    found = real.sets(pd.read_csv(ROOT / "leaderboard" / "leaderboard.csv"))
    for name, rows in found.items():
        assert "\n".join(real.table(name, rows)) in page.read_text()
    assert "\n".join(real.overview(found)) in page.read_text()
    assert "\n".join(real.together(found)) in page.read_text()

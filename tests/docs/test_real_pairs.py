"""Pairs with known poses from photographs that were published for other purposes, and the page of their shifts."""

from __future__ import annotations

import shutil
import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import archives
import cv2
import generic_folder
import homographies
import numpy as np
import numpy.typing as npt
import pytest
import recompute
import shifted_images
import shifts
import stereo_pairs
import still_camera
from repository import ROOT

from relocbench.arrays import Array, Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.generic import dataset as generic
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.geometry import make_transform, so3_exp
from relocbench.progress import Silent


def noise(width: int, height: int, seed: int = 3) -> Image:
    """A smooth picture in which each place looks like no other."""
    rough = np.random.default_rng(seed).uniform(0, 255, size=(height, width, 3))
    return np.clip(128 + 5 * (cv2.GaussianBlur(rough, (0, 0), 4.0) - 128), 0, 255).astype(np.uint8)


def save(path: Path, image: npt.NDArray[Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def built(made: dict[str, list[generic_folder.Query]], folder: Path, name: str = "set") -> Dataset:
    """The dataset that the generic importer makes of queries."""
    generic_folder.write(folder / "made", made)
    sources = [folder / "made" / name for name in ("map", *made)]
    options = generic.Options(name=name, time_offset=(0.0,), max_distance=25.0, correspondences=0)
    return generic.build(sources, options, folder / name, Silent(), Run(workers=0))


def likeness(dataset: Dataset) -> list[float]:
    """For each pair, how well what the query shows, where pose and depth say, correlates with the keyframe."""
    out = []
    for pair_set in dataset.pair_sets():
        for pair in pair_set.pairs:
            reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
            assert reference.depth is not None
            assert pair.T_query_ref is not None
            v, u = np.argwhere(reference.depth > 0)[::37].T
            points = reference.camera.unproject(np.stack([u, v], axis=-1))[0] * reference.depth[v, u][:, None]
            uv, valid = query.camera.project(points @ pair.T_query_ref[:3, :3].T + pair.T_query_ref[:3, 3])
            valid &= query.camera.contains(uv)
            assert valid.sum() > 100
            at = uv[valid].astype(np.float32)[None]
            shown = cv2.remap(query.image, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0].astype(float)
            out.append(float(np.corrcoef(shown.ravel(), reference.image[v, u][valid].ravel())[0, 1]))
    return out


def days_and_nights(folder: Path, days: int, nights: int) -> Path:
    for number in range(days + nights):
        light = 1.0 if number < days else 0.2
        image = (noise(640, 420) * (light - 0.01 * number)).astype(np.uint8)
        save(folder / f"201301{number + 1:02d}_120000.png", image)
    return folder


def test_pairs_of_unlike_light_have_the_night_at_one_end(tmp_path: Path) -> None:
    folder = days_and_nights(tmp_path / "city", 6, 4)
    to_night, to_day = still_camera.draw_unlike(folder, 3, 60.0, np.random.default_rng(0))
    days = {path.name for path in sorted(folder.iterdir())[:6]}
    lit, dark = [pair.reference.name for pair in to_night], [pair.query.name for pair in to_night]
    lit += [pair.query.name for pair in to_day]
    dark_again = [pair.reference.name for pair in to_day]
    assert set(lit) == days  # each image of the day in one pair
    assert len(set(dark)) == len(set(dark_again)) == 3
    assert not days & {*dark, *dark_again}
    with pytest.raises(DatasetError, match="holds 4 different images with a mean grey below 60 and 6 others; expected"):
        still_camera.draw_unlike(folder, 4, 60.0, np.random.default_rng(0))


def places(folder: Path, shift: Array, size: tuple[int, int] = (320, 120)) -> Namespace:
    """A place for each row of shifts, and a session for each column."""
    for place, row in enumerate(np.atleast_2d(shift), start=1):
        scene = noise(800, size[1], seed=place)
        for session, at in enumerate(row, start=1):
            save(folder / "images" / f"{session:02d}{place:02d}.jpg", scene[:, 240 - at : 240 - at + size[0]])
        table = folder / "ground_truth" / f"location_{place}.txt"
        table.parent.mkdir(exist_ok=True)
        np.savetxt(table, row[None, :] - row[:, None], fmt="%d")
    return Namespace(folder=folder)


@pytest.mark.thorough
def test_shifted_images_are_pairs_of_all_sessions_and_forty_pixels_are_a_quarter_metre(tmp_path: Path) -> None:
    options = places(tmp_path / "year", np.array([[0, 20, -70], [10, 10, 40]]))
    dataset = built(shifted_images.made(options), tmp_path)
    (pair_set,) = dataset.pair_sets()
    metres = sorted(pair.T_query_ref[0, 3] for pair in pair_set.pairs if pair.T_query_ref is not None)
    assert np.allclose(metres, np.array([-90, -70, 0, 20, 30, 30]) / 160, atol=1e-9)
    assert shifted_images.sideways(40)[0, 3] == 0.25
    assert min(likeness(dataset)) > 0.98  # JPEG files


@pytest.mark.thorough
def test_a_shift_is_right_by_pixels_however_the_pose_explains_it(tmp_path: Path) -> None:
    from relocbench.api import evaluate

    options = places(tmp_path / "year", np.array([[0, 20, -70], [10, 10, 40]]))
    dataset = built(shifted_images.made(options), tmp_path, "michigan")
    evaluate(dataset, ["identity"], out=tmp_path / "results", workers=0)
    true, found = shifts.shifts(dataset, tmp_path / "results")
    assert np.allclose(np.sort(true), [-90, -70, 0, 20, 30, 30], atol=0.05)
    assert np.allclose(found["identity"].off, np.abs(true))
    row = shifts.table(true, found, 40.0).splitlines()[-1]
    assert row.startswith("| identity | 4 | 0 | 30.0 | 0 |")
    (pair_set,) = dataset.pair_sets()
    draw = shifts.Drawn(dataset, pair_set, pair_set.pairs[0])
    turned = make_transform(so3_exp(np.array([0.0, np.arctan(30 / 800), 0.0])), np.zeros(3))
    assert draw.shift(turned) == pytest.approx(30, abs=0.5)
    assert draw.shift(make_transform(np.eye(3), np.array([0.0, 0.0, -20.0]))) == np.inf

    board = tmp_path / "board"
    archives.pack(tmp_path / "results", "michigan", "identity", board / "real/predictions/michigan/identity.tar.xz")
    assert [one.outcome for one in recompute.shifts(board, tmp_path, tmp_path)] == ["differs: not published"]
    shutil.copy(tmp_path / "real" / "michigan.md", board / "real")
    assert [one.outcome for one in recompute.shifts(board, tmp_path, tmp_path)] == ["byte-equal"]


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda year: (year / "images" / "0201.jpg").unlink(), "0201.jpg: no image that OpenCV can read"),
        (
            lambda year: save(year / "images" / "0201.jpg", noise(300, 120)),
            "300 x 120 pixels; expected those of 0101",
        ),
        (lambda year: (year / "ground_truth" / "location_1.txt").unlink(), "no location_P.txt"),
        (lambda year: (year / "ground_truth" / "location_1.txt").write_text("0 5\n5 0\n"), r"entry \(b, a\)"),
        (lambda year: (year / "ground_truth" / "location_1.txt").write_text("0 x\n5 0\n"), "a table of numbers"),
    ],
)
def test_shifted_images_that_do_not_serve_are_refused(
    spoil: Callable[[Path], object], told: str, tmp_path: Path
) -> None:
    options = places(tmp_path / "year", np.array([[0, 20, -70]]))
    spoil(options.folder)
    with pytest.raises(DatasetError, match=told):
        shifted_images.made(options)


def stereo_scene(folder: Path, width: int = 300, height: int = 200) -> Path:
    """A plane 2 m away, two cameras 0.2 m apart, the disparity of the upper rows unknown."""
    scene = noise(width + 60, height)
    disparity = np.full((height, width), 30.0, dtype=np.float32)  # 400 px * 0.2 m / 2 m less doffs
    disparity[:20] = np.inf
    save(folder / "im0.png", scene[:, :width])
    save(folder / "im1.png", scene[:, 30 : width + 30])
    (folder / "disp0GT.pfm").write_bytes(b"Pf\n%d %d\n-0.003922\n" % (width, height) + disparity[::-1].tobytes())
    (folder / "calib.txt").write_text(
        f"cam0=[ 400 0 140 ; 0 400 99 ; 0 0 1 ] \ncam1=[ 400 0 150 ; 0 400 99 ; 0 0 1 ]\n doffs= 10 \nbaseline= 200\n"
        f" width= {width} \nheight= {height}\n ndisp= 64 \n"
    )
    return folder


@pytest.mark.thorough
def test_stereo_pairs_are_a_baseline_apart_and_each_scene_has_a_camera(tmp_path: Path) -> None:
    scenes = [stereo_scene(tmp_path / "ArtL"), stereo_scene(tmp_path / "Shelf", 280, 220)]
    dataset = built(stereo_pairs.made(Namespace(folders=scenes)), tmp_path)
    assert dataset.pair_set_names == ["map__other_light__ArtL", "map__same_light__Shelf"]
    for pair_set in dataset.pair_sets():
        (pair,) = pair_set.pairs
        reference = dataset.reference(pair_set, pair)
        assert reference.depth is not None
        assert pair.T_query_ref is not None
        assert np.allclose(pair.T_query_ref, make_transform(np.eye(3), np.array([-0.2, 0.0, 0.0])))
        assert np.all(reference.depth[:20] == 0)
        assert np.allclose(reference.depth[20:], 2.0)
    assert min(likeness(dataset)) > 0.999


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda scene: (scene / "calib.txt").unlink(), "expected the calibration of a scene"),
        (lambda scene: (scene / "calib.txt").write_text("cam0=[ 1 0 ]"), "expected cam0, cam1"),
        (lambda scene: (scene / "disp0GT.pfm").unlink(), "no grey PFM file"),
        (lambda scene: (scene / "disp0GT.pfm").write_bytes(b"Pf\n300 200\n-1\n0"), "no grey PFM file"),
        (lambda scene: save(scene / "im1.png", noise(200, 200)), "differ in size"),
    ],
)
def test_stereo_scenes_that_do_not_serve_are_refused(
    spoil: Callable[[Path], object], told: str, tmp_path: Path
) -> None:
    scene = stereo_scene(tmp_path / "Shelf")
    spoil(scene)
    with pytest.raises(DatasetError, match=told):
        stereo_pairs.pair_of(scene, 1)


def wall(folder: Path, H: Array, size: tuple[int, int] = (760, 560)) -> Path:
    """Two photographs of a plane with a homography between them, the second larger than the first."""
    picture, larger = noise(*size), (size[0] + 40, size[1] + 20)
    save(folder / "img1.png", picture)
    save(folder / "img2.png", np.asarray(cv2.warpPerspective(picture, H, larger, flags=cv2.INTER_CUBIC)))
    np.savetxt(folder / "H1to2p", -0.5 * H)  # of any scale
    return folder


@pytest.mark.thorough
def test_pose_and_plane_of_a_homography_show_the_second_photograph(tmp_path: Path) -> None:
    H = np.array([[0.95, 0.12, 20.0], [-0.1, 1.02, 30.0], [1e-4, -5e-5, 1.0]])
    query = homographies.pair_of(wall(tmp_path / "graf", H), 2, generic_folder.made_up_ns(0))
    assert query is not None
    assert min(likeness(built({"viewpoint": [query]}, tmp_path))) > 0.99
    assert query.keyframe.depth[255:257, 351:353].mean() == pytest.approx(homographies.PLANE_M, rel=1e-2)


@pytest.mark.parametrize("seed", range(5))
def test_every_homography_of_a_motion_before_a_plane_has_a_pose_and_a_plane_that_give_it(seed: int) -> None:
    rng, camera = np.random.default_rng(seed), homographies.CAMERA
    T_query_ref = make_transform(so3_exp(rng.uniform(-0.2, 0.2, size=3)), rng.uniform(-1, 1, size=3))
    H = generic_folder.plane_homography(camera, T_query_ref, np.array([*rng.uniform(-0.05, 0.05, size=2), 0.2]))
    found = homographies.decomposed(3.0 * H)
    assert found is not None
    again = generic_folder.plane_homography(camera, *found)
    assert np.allclose(again / again[2, 2], H / H[2, 2], rtol=1e-8, atol=1e-8)
    assert np.all(generic_folder.plane_depth(camera, found[1]) > 0)


def test_the_identity_is_a_camera_at_rest_before_a_plane_across_its_axis() -> None:
    found = homographies.decomposed(np.eye(3))
    assert found is not None
    assert np.allclose(found[0], np.eye(4))
    assert np.allclose(found[1], [0, 0, 1 / homographies.PLANE_M])


def test_a_homography_that_takes_pixels_of_the_keyframe_to_infinity_has_no_plane_that_serves() -> None:
    assert homographies.decomposed(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1 / 400, 0.0, 1.0]])) is None


def test_a_plane_that_is_far_from_the_query_tells_no_pose() -> None:
    camera, inverse = homographies.CAMERA, np.array([0.0, 0.0, 1 / homographies.PLANE_M])
    near, far = (make_transform(np.eye(3), np.array([0.0, 0.0, metres])) for metres in (2.0, 12.0))
    assert homographies.decomposed(generic_folder.plane_homography(camera, near, inverse)) is not None
    assert homographies.decomposed(generic_folder.plane_homography(camera, far, inverse)) is None


def test_the_sigmas_of_a_pose_are_those_of_poses_from_pixels_with_errors() -> None:
    K, rng = homographies.CAMERA.matrix, np.random.default_rng(0)
    points = np.array([[-2.0, -1.4, 5.0], [2.0, -1.4, 6.0], [-2.0, 1.4, 5.0], [2.0, 1.4, 6.0]])
    pixels, _ = homographies.CAMERA.project(points)
    squares = []
    for _ in range(400):
        off = pixels + rng.normal(scale=0.1, size=pixels.shape)
        turn, step = cv2.solvePnPRefineLM(points, off, K, None, np.zeros((3, 1)), np.zeros((3, 1)))
        squares.append([10**2 * np.sum(step**2), 10**2 * np.sum(np.degrees(turn) ** 2)])
    assert np.allclose(np.sqrt(np.mean(squares, axis=0)), homographies.sigmas(points), rtol=0.1)


def test_homographies_that_do_not_serve_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "H1to2p"
    for text, told in (("1 2 3", "three rows of three"), ("-1 0 0\n0 1 0\n0 0 1", "does not mirror")):
        path.write_text(text)
        with pytest.raises(DatasetError, match=told):
            homographies.read_homography(path)


@pytest.mark.thorough
def test_the_command_says_in_one_line_what_is_wrong(tmp_path: Path) -> None:
    def command(*words: object) -> subprocess.CompletedProcess[str]:
        asked = [sys.executable, *map(str, (ROOT / "tools" / "real_sets", *words))]
        return subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True, check=False)

    scene, out = stereo_scene(tmp_path / "Shelf"), tmp_path / "out"
    assert command("stereo-pairs", out, scene).returncode == 0
    assert sorted(path.name for path in out.iterdir()) == ["map", "same_light"]
    again = command("stereo-pairs", out, scene)
    assert (again.returncode, again.stderr) == (2, f"{out}: exists already; expected a folder that is to be made\n")

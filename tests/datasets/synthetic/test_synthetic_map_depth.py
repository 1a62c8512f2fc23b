"""Maps that know depth as real ones do: their sigma is true, and the truth of pairs stays as exact as it was."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import relocbench
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import assert_names
from small_street import Street, box, street_mesh

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.core import images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.rendered import dataset as synthetic
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS, Factors, condition_named
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.datasets.synthetic.map_depth.matched import (
    STEREO_BASELINE_M,
    beside_nearer,
    correlated_errors,
    matched_depth,
    seen_by_both,
    stored_sigma,
    textured,
)
from relocbench.datasets.synthetic.map_depth.scanned import T_RIG_LIDAR, Surroundings, scan_returns, seen_points
from relocbench.datasets.synthetic.map_depth.triangulated import triangulated_points
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.execution import Run
from relocbench.geometry import Camera, make_transform
from relocbench.progress import Silent
from relocbench.tracking import KeyframePoints, Reference

pytestmark = pytest.mark.usefixtures("renderer_kept")
CAMERA = Camera("pinhole", 320, 240, 210.0, 210.0, 159.5, 119.5)
T_RIG_CAM = make_transform(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], dtype=float), [0.9, 0.0, 1.5])
EVERY: dict[str, dict[str, Any]] = {
    "points": {"depth": "points"},
    "lidar": {"depth": "lidar", "rings": 16},
    "stereo": {"depth": "stereo"},
}
SMOKE: dict[str, Any] = {
    "preset": "smoke", "conditions": ("Neutral",), "traversals": 2, "correspondences": 40, "people": 0.0,
}  # fmt: skip
KEYFRAMES = "test-Neutral-0"


def true(normalised: Array) -> bool:
    """Whether errors in units of their sigma have a mean square near 1."""
    return 0.8 <= float(np.mean(normalised**2)) <= 1.25


def valley(seed: int) -> tuple[Image, Floats]:
    """A textured image (240, 320) and its depth, of a ground that rises slowly to 30 m, without edges."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:240, :320].astype(np.float64)
    inverse = 1 / 30 + (v / 240) * (1 / 4 - 1 / 30) + 0.02 * np.sin(u / 60 + rng.uniform(0, 6)) * v / 240
    return rng.integers(0, 255, size=(240, 320), dtype=np.uint8), (1 / inverse).astype(np.float32)


def inverse_at(points: KeyframePoints, depth: Floats) -> Array:
    u, v = points.uv.astype(int).T
    inverse: Array = 1.0 / depth[v, u].astype(np.float64)
    return inverse


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.05, 1.0))
def test_errors_of_triangulated_points_have_their_sigma(seed: int, error_px: float) -> None:
    image, depth = valley(seed)
    everywhere = np.ones(depth.shape, dtype=bool)
    points = triangulated_points(image, depth, everywhere, CAMERA, 3000, error_px, np.random.default_rng(seed))
    assert len(points) > 1500
    assert len(np.unique(points.uv, axis=0)) == len(points)
    np.testing.assert_allclose(points.sigma, error_px / CAMERA.fx)
    assert true((points.inverse_depth - inverse_at(points, depth)) / points.sigma)


def test_points_are_at_corners_spread_over_the_image_and_not_on_what_may_move() -> None:
    _, depth = valley(0)
    board = np.where((np.indices((240, 320)) // 20).sum(axis=0) % 2, 200, 50).astype(np.uint8)
    usable = np.ones(depth.shape, dtype=bool)
    usable[100:160, 120:200] = False
    points = triangulated_points(board, depth, usable, CAMERA, 100, 0.5, np.random.default_rng(0))
    assert 80 <= len(points) <= 100
    off = np.abs((points.uv + 10) % 20 - 10)
    assert off.max() <= 2  # of the corners of the board
    u, v = points.uv.astype(int).T
    assert usable[v, u].all()
    apart = np.linalg.norm(points.uv[:, None] - points.uv[None], axis=-1) + 1e3 * np.eye(len(points))
    assert apart.min() >= 0.5 * np.sqrt(320 * 240 / 100)
    few = triangulated_points(board, depth, usable, CAMERA, 100, 5.0, np.random.default_rng(0))
    assert (inverse_at(few, depth) >= 4 * few.sigma).all()  # the others are too far to be known so badly


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.05, 1.0))
def test_errors_of_matched_depth_have_the_sigma_of_the_camera(seed: int, error_px: float) -> None:
    image, depth = valley(seed)
    found = matched_depth(image, depth, CAMERA, error_px, np.random.default_rng(seed))
    assert np.mean(found > 0) > 0.4
    sigma = stored_sigma(CAMERA, error_px)
    points = Reference("", None, image, CAMERA, depth=found, depth_sigma=sigma).points
    inverse = (points.inverse_depth - inverse_at(points, depth)) / points.sigma
    assert true(inverse)
    z = 1 / points.inverse_depth
    assert true((z - 1 / inverse_at(points, depth)) / (sigma[0] + sigma[2] * z * z))


def test_errors_of_matched_depth_are_alike_nearby_and_not_far_away() -> None:
    field = correlated_errors((400, 400), np.random.default_rng(0))
    assert np.mean(field**2) == pytest.approx(1.0, abs=0.1)
    assert np.mean(field[:, 1:] * field[:, :-1]) > 0.85
    assert abs(np.mean(field[:, 20:] * field[:, :-20])) < 0.1
    assert np.mean(field[:2] ** 2) == pytest.approx(np.mean(field**2), abs=0.3)  # at the border as inside


def test_there_is_no_match_without_texture_where_one_camera_sees_and_beside_edges() -> None:
    """A board at 4 m before a wall at 20 m: disparities of 28 and 6 pixels."""
    depth = np.full((240, 320), 20.0, dtype=np.float32)
    depth[60:180, 120:220] = 4.0
    disparity = CAMERA.fx * STEREO_BASELINE_M / depth.astype(np.float64)
    hidden = ~seen_by_both(disparity)
    wide = int(disparity[100, 150] - disparity[0, 0])
    assert hidden[:, : int(disparity[0, 0])].all()
    assert not hidden[:60, 6:].any()
    assert hidden[60:180, 120 - wide : 120].all()
    assert hidden[60:180, 6:].sum() == 120 * wide
    assert not hidden[60:180, 120:].any()
    edge = beside_nearer(disparity)
    assert edge[58:60, 120:220].all()
    assert not edge[60:180, 120:220].any()
    image = np.random.default_rng(0).integers(0, 255, size=(240, 320), dtype=np.uint8)
    image[190:230, 20:300] = 128
    assert not textured(image)[200:220, 40:280].any()
    found = matched_depth(image, depth, CAMERA, 0.2, np.random.default_rng(0)) > 0
    assert found[100:140, 130:210].all()
    assert not (found & (hidden | edge)).any()
    assert not found[200:220, 40:280].any()
    assert not (matched_depth(image, depth, CAMERA, 2.0, np.random.default_rng(0))[:50] > 0).any()


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([16, 32, 64]), st.floats(-20, 20), st.sampled_from(["Neutral", "Rain"]))
def test_errors_of_scanned_points_have_their_sigma_and_none_is_hidden(
    seed: int, rings: int, yaw_deg: float, weather: str
) -> None:
    street = LidarScene(street_mesh(Street(seed % 5), Factors()))
    pole = LidarScene(box((8.0, -1.0, 0.0), (8.4, -0.6, 4.0), Material.METAL, 9))
    around = Surroundings(street, pole, condition_named(weather).factors)
    turn = np.radians(yaw_deg)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    T_world_rig = make_transform(rotation, [0.0, 0.0, 0.0])
    T_world_cam = T_world_rig @ T_RIG_CAM @ make_transform(np.eye(3), [0.6, 0.0, 0.0])
    returns = scan_returns(around, T_world_rig @ T_RIG_LIDAR, rings, np.random.default_rng(seed))
    points = seen_points(returns, around, CAMERA, T_world_cam)
    assert len(points) > 60 * rings
    assert len(np.unique(np.rint(points.uv), axis=0)) == len(points)
    rays = np.column_stack([(points.uv - [CAMERA.cx, CAMERA.cy]) / CAMERA.fx, np.ones(len(points))])
    origins = np.broadcast_to(T_world_cam[:3, 3], rays.shape)
    towards = rays @ T_world_cam[:3, :3].T
    exact = np.minimum(street.hits(origins, towards).range, pole.hits(origins, towards).range)
    normalised = (points.inverse_depth - 1 / exact) / points.sigma
    assert true(normalised)
    assert np.abs(normalised).max() < 6  # neither behind the pole, which the lidar sees past, nor drops of rain
    hidden = np.linalg.norm(returns.points[:, :2] - returns.origin[:2], axis=1)
    if weather == "Rain":
        assert np.any(hidden < 3.0)  # drops right before the lidar, whose lowest beams meet the ground at 3.7 m


def build(out: Path, workers: int = 1, **options: Any) -> Dataset:
    return synthetic.build([], synthetic.Options.model_validate({**SMOKE, **options}), out, Silent(), Run(workers))


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return build(tmp_path_factory.mktemp("exact") / "out")


def files(dataset: Dataset) -> Mapping[str, bytes]:
    root = dataset.root
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@pytest.mark.thorough
@pytest.mark.parametrize(("kind", "workers"), [("points", 1), *((kind, 2) for kind in EVERY)])
def test_only_the_map_changes_and_the_same_bytes_come_after_a_stop(
    kind: str, workers: int, exact: Dataset, tmp_path: Path
) -> None:
    made = build(tmp_path / "out", **EVERY[kind])
    before, after = files(exact), files(made)
    texts = {"build.yaml", "dataset.yaml", "manifest.csv"}
    texts |= {f"traversals/{name}/traversal.yaml" for name in exact.traversal_names}
    same = {name for name in before if "/depth/" not in name} - texts
    tables = {name for name in same if name.startswith("pairs/") and name.endswith(".csv")}
    assert {name for name in same - tables if after.get(name) != before[name]} == set()
    for name in tables:
        rows = [list(csv.DictReader(content[name].decode().splitlines())) for content in (before, after)]
        assert all(
            float(row["depth_error"]) > float(exactly["depth_error"]) for exactly, row in zip(*rows, strict=True)
        )
        of_the_map = {"depth_error", "similarity"}  # of patches that are taken to the query by the map's depth
        kept = [[{k: v for k, v in row.items() if k not in of_the_map} for row in each] for each in rows]
        assert kept[0] == kept[1]
    stored = "depth" if kind == "stereo" else "points"
    rest = {name for name in after if name not in same} - texts
    assert len(rest) == 8
    assert all(f"/{stored}/front/" in name for name in rest)
    assert relocbench("validate", made.root).status == 0

    # One worker that drew from one generator would make the same of all again, two would not: it makes every other one.
    torn, *gone = sorted(rest)[:: 3 - workers]
    (made.root / torn).write_bytes(after[torn][:-20])
    for name in gone:
        (made.root / name).unlink()
    (made.root / "dataset.yaml").unlink()
    assert files(build(made.root, workers=workers, **EVERY[kind])) == after

    drive, errors = made.traversal(KEYFRAMES), []
    town = scenes.static_scene(scenes.DistrictSpec(0, "test", 190.0), condition_named("Neutral").factors)
    for time_ns in drive.keyframe_timestamps("front"):
        keyframe = drive.reference("front", time_ns)
        assert (keyframe.depth is None) == (keyframe.sparse_points is not None) == (stored == "points")
        T_world_cam = drive.T_world_cam("front", time_ns)
        origins, directions, lengths = scenes.pixel_rays(keyframe.camera, T_world_cam, keyframe.points.uv)
        exact_inverse = lengths / town.hits(origins, directions).range
        errors.append((keyframe.points.inverse_depth - exact_inverse) / keyframe.points.sigma)
    assert true(np.concatenate(errors))


def test_the_recipe_names_what_is_not_by_default() -> None:
    def recorded(**options: Any) -> dict[str, Any]:
        values = synthetic.Options.model_validate({"preset": "smoke", **options}).recorded()
        return {name: values[name] for name in ("depth", "depth_points", "depth_error") if name in values}

    assert recorded() == recorded(depth="exact") == {}
    assert recorded(depth="points") == {"depth": "points"}
    assert recorded(depth="points", depth_points=100, depth_error=1.0) == {
        "depth": "points", "depth_points": 100, "depth_error": 1.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (("--depth-points", 100), ("--depth-points", "points")),
        (("--depth", "stereo", "--depth-points", 100), ("--depth-points", "points")),
        (("--depth-error", 1), ("--depth-error", "points", "stereo")),
        (("--depth", "lidar", "--depth-error", 1), ("--depth-error", "points", "stereo")),
        (("--rings", 32), ("--rings", "lidar", "recordings")),
        (("--depth", "points", "--rings", 32), ("--rings", "lidar")),
        (("--depth", "lidar", "--azimuths", 500), ("--azimuths", "--recording")),
        (("--depth", "lidar", "--rings", 8), ("--rings", 16)),
        (("--depth", "radar"), ("--depth", "exact")),
        (("--depth", "points", "--depth-points", 0), ("--depth-points", 20)),
        (("--depth", "points", "--recording", "kitti"), ("--depth", "--recording")),
    ],
)
def test_options_without_effect_are_refused(options: tuple[Any, ...], names: tuple[Any, ...], tmp_path: Path) -> None:
    told = relocbench("build-dataset", "synthetic", "--preset", "smoke", *options, "--out", tmp_path / "out")
    assert told.status == 2
    assert_names(told.complaint, "", None, *names)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("kind", "reach"), [("stereo", "1.4 m"), ("points", "3.1 m")])
def test_errors_that_leave_no_depth_are_refused(kind: str, reach: str, tmp_path: Path) -> None:
    words = ("--preset", "smoke", "--depth", kind, "--depth-error", 5, "--out", tmp_path / "out")
    told = relocbench("build-dataset", "synthetic", *words)
    assert told.status == 2
    assert_names(told.complaint, "", None, "--depth-error", 5, "96x96", reach, "--size")
    assert not (tmp_path / "out" / "traversals").exists()


@pytest.mark.thorough
@pytest.mark.usefixtures("small_preview")
def test_a_preview_shows_what_maps_know(tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.png"
    words = ("preview", "-c", "Sunny", "--map-depths", "--size", "96x72", "--out", sheet, "--quiet")
    assert relocbench(*words).status == 0
    picture = images.read_image(sheet)
    assert picture.shape == (72, 5 * 96 + 4 * 4, 3)
    coloured = [np.ptp(picture[:60, k * 100 : k * 100 + 96].astype(int), axis=2) > 60 for k in range(1, 5)]
    exact, points, lidar, stereo = (np.mean(known) for known in coloured)
    assert 0.05 < points < exact
    assert 0.05 < lidar < exact
    assert 0.05 < stereo < exact
    told = relocbench("preview", "--all", "--map-depths", "--out", sheet)
    assert told.status == 2
    assert_names(told.complaint, "", None, "--map-depths", len(CONDITIONS))


def test_points_that_were_not_written_to_their_end_are_noticed(tmp_path: Path) -> None:
    path = tmp_path / "1.csv"
    assert not images.is_whole(path)
    images.write_points(path, KeyframePoints(np.ones((3, 2)), np.ones(3), np.ones(3)))
    assert images.is_whole(path)
    for content in (path.read_bytes()[:-5], b"", b"u,v\n1,2\n"):
        path.write_bytes(content)
        assert not images.is_whole(path)

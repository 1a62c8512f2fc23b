"""A rolling shutter: each row shows what the camera sees at the time of the row, and the truth stays as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from refusals import assert_names

from relocbench.arrays import Array, Floats
from relocbench.datasets.core import images
from relocbench.datasets.core.schema import TraversalFile
from relocbench.datasets.importers.rendered import dataset as synthetic
from relocbench.datasets.synthetic.camera.rolling_shutter import Readout, rolling, row_poses, sources
from relocbench.datasets.synthetic.conditions.presets import conditions_of
from relocbench.datasets.synthetic.drives.drive import DriveStyle
from relocbench.datasets.synthetic.jobs.plan import AskedDrives, make_plans
from relocbench.execution import Run
from relocbench.geometry import Camera
from relocbench.progress import Silent

CAMERA = Camera("pinhole", 81, 61, 50.0, 52.0, 40.0, 30.0)
NORMAL, DISTANCE_M = np.array([0.2, -0.3, 0.93]), 6.0


def rays() -> Array:
    """(H, W, 3) with length 1 along the optical axis."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(float)
    return CAMERA.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))[0].reshape(CAMERA.height, CAMERA.width, 3)


def plane() -> Floats:
    """The depth of a slanted plane, which all pixels see."""
    return np.asarray(DISTANCE_M / (rays() @ NORMAL), dtype=np.float32)


@pytest.mark.parametrize("seed", range(5))
def test_a_pixel_shows_what_its_ray_meets_at_the_time_of_its_row(seed: int) -> None:
    """On a plane the point that a ray of the moving camera meets has a closed form."""
    rng = np.random.default_rng(seed)
    readout = Readout(0.05, np.concatenate([rng.uniform(-8, 8, 3), rng.uniform(-0.5, 0.5, 3)]))
    T_cam_row = row_poses(CAMERA.height, readout)
    along = np.einsum("hij,hwj->hwi", T_cam_row[:, :3, :3], rays())
    start = T_cam_row[:, None, :3, 3]
    reach = (DISTANCE_M - start @ NORMAL) / (along @ NORMAL)
    expected, valid = CAMERA.project((start + reach[..., None] * along).reshape(-1, 3))
    inside = valid & CAMERA.contains(expected)
    assert inside.mean() > 0.5
    found = sources(plane(), CAMERA, readout).reshape(-1, 2)
    off = np.linalg.norm(found - expected, axis=1)[inside]
    moved = np.linalg.norm(expected - np.indices((61, 81))[::-1].reshape(2, -1).T, axis=1)[inside]
    assert np.median(off) < 0.01
    assert off.max() < 0.05 * moved.max()


def test_the_middle_row_is_that_of_the_pose() -> None:
    found = sources(plane(), CAMERA, Readout(0.1, np.array([3.0, 1.0, 8.0, 0.2, 0.3, 0.1])))
    np.testing.assert_allclose(found[30], np.column_stack([np.arange(81), np.full(81, 30)]), atol=1e-6)


def test_a_camera_that_stands_and_the_sky_of_one_that_does_not_turn_are_left_alone() -> None:
    light = np.random.default_rng(0).random((61, 81, 3)).astype(np.float32)
    for depth, twist in ((plane(), np.zeros(6)), (np.zeros((61, 81), np.float32), np.array([9.0, 1, 5, 0, 0, 0]))):
        seen, far = rolling(light, depth, CAMERA, Readout(0.05, twist))
        np.testing.assert_allclose(seen, light, atol=1e-3)
        np.testing.assert_array_equal(far, depth)


def test_a_vertical_edge_leans_with_the_motion() -> None:
    """To a camera that moves right, what is seen later, below, has moved to the left."""
    depth = np.full((61, 81), 5.0, np.float32)
    light = np.repeat((np.arange(81) >= 40).astype(np.float32)[None, :, None], 61, axis=0).repeat(3, axis=2)
    seen, _ = rolling(light, depth, CAMERA, Readout(0.1, np.array([8.0, 0, 0, 0, 0, 0])))
    edge = np.argmax(seen[..., 0] > 0.5, axis=1)
    speed_px = CAMERA.fx * 8.0 / 5.0
    assert edge[0] - edge[-1] == pytest.approx(0.1 * speed_px, abs=1.1)


def test_the_readout_stands_in_the_traversals_file_and_nothing_does_without() -> None:
    assert "rolling_shutter" not in synthetic.Options().recorded()
    assert synthetic.Options(rolling_shutter=0.02).recorded()["rolling_shutter"] == 0.02
    conditions = conditions_of(("Sunny",), {}, None, 2)

    def described(readout_s: float) -> TraversalFile:
        asked = AskedDrives(("test",), conditions, 1, 0), 2, DriveStyle()
        return make_plans(*asked, extent_m=190.0, reporter=Silent(), readout_s=readout_s)[0].file()

    plain, rolled = described(0.0), described(0.02)
    assert plain.clock is None
    assert "clock" not in plain.model_dump()
    assert rolled.clock is not None
    assert rolled.clock.readout_s == 0.02
    assert "middle row" in rolled.clock.how


def test_a_shutter_without_effect_is_refused(tmp_path: Path) -> None:
    command, out = ("build-dataset", "synthetic"), ("--out", tmp_path / "out")
    for words in (("--rolling-shutter", 0.02, "--recording", "kitti"), ("--rolling-shutter", 30)):
        told = relocbench(*command, *words, *out)
        assert told.status == 2
        assert_names(told.complaint, "", None, "rolling")
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_images_alone_are_rolled_and_workers_do_not_matter(tmp_path: Path) -> None:
    def built(name: str, workers: int, **options: object) -> Path:
        given = synthetic.Options.model_validate({"preset": "smoke", **options})
        return synthetic.build([], given, tmp_path / name, Silent(), Run(workers)).root

    plain, one, two = built("plain", 1), built("one", 1, rolling_shutter=0.05), built("two", 2, rolling_shutter=0.05)
    files = {path.relative_to(one) for path in one.rglob("*") if path.is_file()}
    assert all((one / name).read_bytes() == (two / name).read_bytes() for name in files)
    for name in files:
        # The table of pairs beside their poses says how alike images look.
        if {"depth", "correspondences"} & set(name.parts) or name.suffix == ".txt" or name.name == "poses.csv":
            assert (one / name).read_bytes() == (plain / name).read_bytes(), name
    pictures = [name for name in files if "images" in name.parts]
    assert any(np.any(images.read_image(one / name) != images.read_image(plain / name)) for name in pictures)

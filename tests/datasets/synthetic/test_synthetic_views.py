"""A rig of its own for each drive: other focal lengths, sizes, mounts and lenses, with the truth kept."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from command_line import relocbench
from refusals import assert_names
from synthetic_truth import check, report

from relocbench.datasets.core import images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.rendered import dataset as synthetic
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.synthetic.camera.rectified import RadialLens
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.conditions.presets import conditions_of
from relocbench.datasets.synthetic.conditions.views import CameraView, draw_view
from relocbench.datasets.synthetic.drives.drive import DriveStyle
from relocbench.datasets.synthetic.drives.rig import RIGS, rig_named
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.latest import forget_renderer
from relocbench.datasets.synthetic.jobs.plan import AskedDrives, drive_views, make_plans
from relocbench.datasets.synthetic.jobs.rendering import RenderUnit, missing_steps, render_unit
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.renderer.samples import View, ray
from relocbench.execution import Run
from relocbench.geometry import Camera, apply, invert
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("renderer_kept")
TINY: dict[str, Any] = {
    "preset": "smoke",
    "conditions": ("Neutral",),
    "size": "64x48",
    "steps": 2,
    "traversals": 2,
    "correspondences": 40,
}
LENSES = (-0.3, -0.1, 0.05, 0.3)


def build(out: Path, **options: Any) -> Dataset:
    return synthetic.build([], synthetic.Options.model_validate({**TINY, **options}), out, Silent(), Run(1))


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return build(tmp_path_factory.mktemp("views") / "out", views="varied", extras=("normals", "changed"))


@pytest.mark.thorough
def test_each_traversal_states_its_own_camera_and_the_reference_the_plain_one(varied: Dataset) -> None:
    recipe = yaml.safe_load((varied.root / "build.yaml").read_text(encoding="utf-8"))
    assert recipe["options"]["views"] == "varied"
    assert recipe["views"] == varied.file.made_by["views"]
    assert list(recipe["views"]) == ["test-Neutral-1"]
    view = CameraView.model_validate(recipe["views"]["test-Neutral-1"])
    plain, T_plain = rig_named("front").cameras(64, 48)["front"]
    first, second = (varied.traversal(f"test-Neutral-{n}") for n in (0, 1))
    assert first.camera("front") == plain
    assert second.camera("front") != plain
    width, height = map(int, str(view.size).split("x"))
    assert second.camera("front").size == (width, height)
    assert second.camera("front").fx / width == pytest.approx(view.focal * plain.fx / 64)
    mount = np.array(second.file.cameras["front"].T_rig_cam.matrix)
    assert mount[:3, 3] - T_plain[:3, 3] == pytest.approx([0, 0, view.up_m])
    yaw, down = np.radians([view.yaw_deg, view.down_deg])
    assert mount[:3, 2] == pytest.approx([np.cos(yaw) * np.cos(down), np.sin(yaw) * np.cos(down), -np.sin(down)])


def test_images_depth_and_extras_have_the_size_of_their_camera(varied: Dataset) -> None:
    pictures = sorted(varied.root.rglob("*.png"))
    assert len(pictures) == 2 * 2 * 4
    for path in pictures:
        camera = varied.traversal(next(p for p in path.parts if p.startswith("test-"))).camera("front")
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert picture is not None
        assert picture.shape[1::-1] == camera.size, path


def test_correspondences_lie_where_the_stated_cameras_see_them(varied: Dataset) -> None:
    (pair_set,) = varied.pair_sets()
    cameras = [varied.traversal(name).camera("front") for name in (pair_set.reference, pair_set.query)]
    for pair in pair_set.pairs:
        rows = read_correspondences(varied.layout.correspondence_file(pair_set.name), pair.key)
        assert len(rows) > 10
        rays, _ = cameras[0].unproject(rows.uv_ref)
        assert pair.T_query_ref is not None
        expected, _ = cameras[1].project(apply(pair.T_query_ref, rays * rows.depth_ref[:, None]))
        assert np.abs(expected - rows.uv_query).max() < 0.01
        assert cameras[1].contains(rows.uv_query).all()


def test_a_drawn_view_depends_on_the_seed_and_not_on_what_else_is_built() -> None:
    conditions = conditions_of(("Neutral", "Night"), {}, None, 2)
    size = 320, 240
    everything = drive_views(AskedDrives(("train", "validation", "test"), conditions, 2, 3), "varied", size)
    assert len(everything) == len(set(everything.values())) == 9
    assert not {f"{split}-Neutral-0" for split in ("train", "validation", "test")} & everything.keys()
    alone = drive_views(AskedDrives(("validation",), conditions, 1, 3), "varied", size)
    assert alone.items() <= everything.items()
    assert list(alone) == ["validation-Night-0"]
    other = drive_views(AskedDrives(("validation",), conditions, 1, 4), "varied", size)
    assert other["validation-Night-0"] != alone["validation-Night-0"]
    assert drive_views(AskedDrives(("train",), conditions, 2, 3), "same", size) == {}


def test_drawn_views_fill_their_ranges() -> None:
    drawn = [draw_view(np.random.default_rng(seed), (320, 240)) for seed in range(300)]
    for name, low, high in (
        ("focal", 0.7, 1.5),
        ("up_m", -0.4, 0.7),
        ("down_deg", -5, 8),
        ("yaw_deg", -15, 15),
        ("distortion", -0.2, 0.05),
    ):
        found = np.array([getattr(view, name) for view in drawn])
        assert low <= found.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < found.max() <= high
    assert np.median([view.focal for view in drawn]) == pytest.approx(np.sqrt(0.7 * 1.5), rel=0.1)
    sizes = np.array([list(map(int, str(view.size).split("x"))) for view in drawn])
    assert not (sizes % 2).any()
    assert (sizes[:, 0].min(), sizes[:, 0].max()) == pytest.approx((160, 320), abs=4)
    assert np.abs(sizes[:, 0] - 4 / 3 * sizes[:, 1]).max() < 2.4
    small = draw_view(np.random.default_rng(1), (48, 36))
    assert min(map(int, str(small.size).split("x"))) >= 32


def test_a_view_moves_all_cameras_of_a_rig_as_one_body() -> None:
    view = CameraView(up_m=0.4, down_deg=5, yaw_deg=30, focal=1.2, size="200x150")
    for rig in RIGS.values():
        plain, moved = rig.cameras(320, 240), rig.cameras(320, 240, view)
        names = list(plain)
        for name in names[1:]:
            T_plain, T_moved = (invert(each[names[0]][1]) @ each[name][1] for each in (plain, moved))
            assert T_moved == pytest.approx(T_plain, abs=1e-12)
        shift = np.mean([moved[name][1][:3, 3] - plain[name][1][:3, 3] for name in names], axis=0)
        assert shift == pytest.approx([0, 0, 0.4], abs=1e-12)
        assert {camera.size for camera, _ in moved.values()} == {(200, 150)}
    assert RIGS["front"].cameras(320, 240, CameraView())["front"][1] == pytest.approx(
        RIGS["front"].cameras(320, 240)["front"][1]
    )


@pytest.mark.thorough
def test_a_frame_alone_in_another_process_has_the_same_bytes(varied: Dataset, tmp_path: Path) -> None:
    """The unit of work as another process unpickles it, for the last frame only."""
    conditions = conditions_of(("Neutral",), {}, None, 2)
    asked = AskedDrives(("test",), conditions, 2, 0)
    views = drive_views(asked, "varied", (64, 48))
    plan = make_plans(asked, 2, DriveStyle(), extent_m=190.0, reporter=Silent(), size=(64, 48), views=views)[1]
    layout = type(varied.layout)(tmp_path / "alone")
    step = missing_steps(plan, layout, 0, ("normals",))[-1]
    factors = plan.condition.factors
    assert step.frames[0].distortion == views[plan.name].distortion != 0
    forget_renderer()  # which another process does not have
    render_unit(pickle.loads(pickle.dumps(RenderUnit(plan.place, factors, factors, (step,)))))
    written = list((tmp_path / "alone").rglob("*.png"))
    assert len(written) == 3
    for path in written:
        assert path.read_bytes() == (varied.root / path.relative_to(tmp_path / "alone")).read_bytes()


def test_without_the_option_no_lens_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("relocbench.datasets.synthetic.renderer.render.RadialLens", None)
    dataset = build(tmp_path / "out", views="same", traversals=1)
    assert "views" not in (dataset.root / "build.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "camera",
    [Camera("pinhole", 320, 240, 208.5, 208.5, 159.5, 119.5), Camera("pinhole", 96, 64, 30.0, 30.0, 47.5, 31.5)],
)
@pytest.mark.parametrize("distortion", LENSES)
def test_every_rectified_pixel_shows_what_the_pinhole_camera_sees_there(camera: Camera, distortion: float) -> None:
    """The image that is taken holds, as the renderer's own rays have it, the place of each ray in the pinhole image."""
    lens = RadialLens(camera, distortion)
    c = lens.taken
    view = View(np.zeros(3), np.eye(3), c.fx, c.fy, c.cx, c.cy, lens.bend)
    rays = [ray(view, float(u), float(v))[0] for v in range(c.height) for u in range(c.width)]
    places, _ = camera.project(np.array(rays))
    found = lens.rectified(places.reshape(c.height, c.width, 2).astype(np.float32))
    expected = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    assert np.linalg.norm(found - expected, axis=-1).max() < 0.05
    # The image that is taken ends nowhere in the rectified one, and no more of it is left out than must be.
    assert (lens.rectified(np.full((c.height, c.width, 3), 255, np.uint8)) == 255).all()
    assert lens.rectified(expected.astype(np.float32)).min() < 0.02


@pytest.mark.parametrize("distortion", LENSES)
def test_the_derivatives_of_a_bent_ray_are_those_of_its_direction(distortion: float) -> None:
    camera = Camera("pinhole", 320, 240, 150.0, 160.0, 159.5, 119.5)
    lens = RadialLens(camera, distortion)
    c = lens.taken
    view = View(np.zeros(3), np.eye(3), c.fx, c.fy, c.cx, c.cy, lens.bend)
    for u, v in ((0.0, 0.0), (100.0, 30.0), (250.0, 239.0)):
        _, du, dv = ray(view, u, v)
        by_u = np.array(ray(view, u + 0.5, v)[0]) - ray(view, u - 0.5, v)[0]
        by_v = np.array(ray(view, u, v + 0.5)[0]) - ray(view, u, v - 0.5)[0]
        assert np.array(du) == pytest.approx(by_u, rel=1e-3, abs=1e-6)
        assert np.array(dv) == pytest.approx(by_v, rel=1e-3, abs=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("distortion", [-0.25, 0.15])
def test_a_rectified_picture_lies_on_the_pinhole_picture_and_is_softer(distortion: float) -> None:
    """Shifts of blocks against the picture without a lens; a block's own is uncertain by a tenth of a pixel."""
    place = DistrictSpec(0, "test", 190.0)
    T_world_rig = scenes.district(place).network.drive(150.0, 0).pose(60.0)
    camera, T_rig_cam = rig_named("front").cameras(512, 384)["front"]
    renderer = scenes.renderer(place, condition_named("Overcast").factors)
    plain, through = (
        renderer.render(camera, T_world_rig @ T_rig_cam, 1, T_world_rig, None, d) for d in (0.0, distortion)
    )
    assert np.array_equal(plain.depth, through.depth)
    assert np.array_equal(plain.instance, through.instance)
    first, second = (cv2.cvtColor(each.rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) for each in (plain, through))
    window = cv2.createHanningWindow((64, 64), cv2.CV_32F)
    outward: list[tuple[float, float, float]] = []
    for y in range(0, 384 - 63, 32):
        for x in range(0, 512 - 63, 32):
            block = np.s_[y : y + 64, x : x + 64]
            shift, response = cv2.phaseCorrelate(first[block], second[block], window)
            from_centre = np.array([x - 223.5, y - 159.5])
            if response > 0.5 and np.linalg.norm(from_centre) > 120:
                along = float(np.array(shift) @ from_centre / np.linalg.norm(from_centre))
                outward.append((shift[0], shift[1], along))
    assert len(outward) > 40
    assert np.abs(np.median(np.array(outward), axis=0)).max() < 0.05
    assert cv2.Laplacian(second, cv2.CV_32F).std() < 0.95 * cv2.Laplacian(first, cv2.CV_32F).std()


@pytest.mark.thorough
def test_truth_is_exact_with_drawn_views(tmp_path: Path) -> None:
    options = {"conditions": ("Neutral", "WetNoon"), "traversals": 1, "steps": 3, "size": "160x120"}
    dataset = build(tmp_path / "out", views="varied", correspondences=1000, traffic=2.0, **options)
    found = report(check(dataset, pairs_a_set=2, depth_pixels=2000, seed=0))
    for what in ("depth_in_256ths_m", "forward_px", "backward_px"):
        assert found[what]["rays"] > 1000
        assert found[what]["within_percent"] > 99.9
        assert found[what]["outside_elsewhere"] == 0
    assert found["occlusion"]["agree_percent"] > 99.9


@pytest.mark.thorough
def test_views_by_hand_belong_to_conditions(tmp_path: Path) -> None:
    config, out = tmp_path / "config.yaml", tmp_path / "out"
    config.write_text(
        "preset: smoke\nconditions: [Neutral, Snow]\nsteps: 3\nextent: 190\nsize: 64x48\nmax_angle: 180\n"
        "views:\n  Snow: {size: 48x48, yaw_deg: 180, down_deg: 4, distortion: -0.15}\n"
    )
    told = relocbench("build-dataset", "synthetic", "--config", config, "--out", out, "--quiet")
    assert told.status == 0, told.err
    dataset = Dataset(out)
    assert dataset.file.made_by["views"].keys() == {"test-Snow-0"}
    assert dataset.traversal("test-Snow-0").camera("front").size == (48, 48)
    assert dataset.traversal("test-Neutral-0").camera("front").size == (64, 48)
    back = next(s for s in dataset.pair_sets() if s.query == "test-Snow-0")
    assert all(pair.angle_deg is not None and pair.angle_deg > 170 for pair in back.pairs)
    assert relocbench("validate", out).status == 0


@pytest.mark.thorough
@pytest.mark.usefixtures("small_preview")
def test_a_preview_shows_drawn_views(tmp_path: Path) -> None:
    sheets = []
    for count in (0, 1):
        out = tmp_path / f"{count}.png"
        told = relocbench("preview", "-c", "Sunny", "--drawn-views", count, "--size", "96x72", "--out", out, "--quiet")
        assert told.status == 0, told.err
        sheets.append(images.read_image(out).astype(float))
    assert sheets[1].shape == (72, 2 * 96 + 4, 3)
    assert np.array_equal(sheets[0], sheets[1][:, :96])
    assert np.abs(sheets[1][:60, :96] - sheets[1][:60, 100:]).mean() > 3


def test_mistakes_are_named(tmp_path: Path) -> None:
    command, out = ("build-dataset", "synthetic"), ("--out", tmp_path / "out")
    for words in (
        ("--views", "wild"),
        ("--views", "varied", "--sweep", "light"),
        ("--views", "varied", "--recording", "kitti"),
    ):
        told = relocbench(*command, *words, *out)
        assert told.status == 2
        assert_names(told.complaint, "", None, "views")
    config = tmp_path / "config.yaml"
    for views, key in (
        ("{focal: 1.5, zoom: 3}", "zoom"),
        ("{focal: 9}", "focal"),
        ("{size: 8x8}", "size"),
        ("{yaw_deg: 200}", "yaw_deg"),
        ("{distortion: -0.5}", "distortion"),
    ):
        config.write_text(f"conditions: [Sunny, Snow]\nviews:\n  Snow: {views}\n")
        told = relocbench(*command, "--config", config, *out)
        assert told.status == 2
        assert_names(told.complaint, config, 3, key)
        assert "literal" not in told.complaint
    config.write_text("conditions: [Sunny, Snow]\nviews: {Snwo: {focal: 1.5}}\n")
    told = relocbench(*command, "--config", config, *out)
    assert told.status == 2
    assert_names(told.complaint, "", None, "Snwo", "Snow")
    assert not (tmp_path / "out").exists()

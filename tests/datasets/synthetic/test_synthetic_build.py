"""The procedural town as a dataset: drives, pairs, exact truth, and the same bytes however it is built."""

from __future__ import annotations

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from hypothesis import given, settings
from hypothesis import strategies as st
from killing import Fault, run_until_killed
from refusals import assert_names, refused

from relocbench.arrays import Array
from relocbench.datasets.core import images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.rendered import dataset as synthetic
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.pairs.posed_frames import PosedFrames
from relocbench.datasets.pairs.visibility import warp
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.conditions.presets import References, conditions_of
from relocbench.datasets.synthetic.drives.drive import Drive, DriveStyle, drive, route_length
from relocbench.datasets.synthetic.drives.passers import passers
from relocbench.datasets.synthetic.drives.rig import RIGS
from relocbench.datasets.synthetic.drives.traffic import on_the_road
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.pairs import DistanceSpread, drawn_pairs
from relocbench.datasets.synthetic.jobs.plan import AskedDrives, evaluated_drives, make_plans
from relocbench.datasets.synthetic.jobs.rendering import extra_path
from relocbench.datasets.synthetic.renderer.render import Renderer
from relocbench.datasets.synthetic.town.mesh import Mesh, Semantic
from relocbench.datasets.synthetic.town.moving import Kind, moves, moving_mesh
from relocbench.datasets.synthetic.town.streets import KERB_M
from relocbench.datasets.synthetic.town.town import compose
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.geometry import apply, invert, is_rotation, rotation_angle
from relocbench.progress import Silent

SMOKE = {"preset": "smoke", "extras": ("changed", "instance", "semantic", "normals")}
PLACE = scenes.DistrictSpec(0, "test", 190.0)
REFERENCE, QUERY = "test-Neutral-0", "test-WetNoon-0"
ACROSS = f"{REFERENCE}__{QUERY}__front"


def build(out: Path, workers: int = 1, **options: object) -> Dataset:
    return synthetic.build([], synthetic.Options.model_validate({**SMOKE, **options}), out, Silent(), Run(workers))


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return build(tmp_path_factory.mktemp("synthetic") / "out")


@pytest.fixture(scope="module")
def resumed(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The same without extras: killed when the first images were on disk, and finished by two workers.

    ``benchmarks/truth/kills.py`` kills workers as well.
    """
    folder = tmp_path_factory.mktemp("killed")
    out = folder / "out"
    command = ["build-dataset", "synthetic", "--preset", "smoke", "--workers", 1, "--quiet", "--out", out]
    third = Fault(r"images/front/\d+\.png$", 3)
    run_until_killed(["python", "-m", "relocbench", *command], third, folder / "trace")
    assert len(list(out.rglob("images/front/[0-9]*.png"))) == 2
    with refused(DatasetError, out):
        Dataset(out)
    for torn in list(out.rglob("depth/front/*.png"))[:1]:
        torn.write_bytes(torn.read_bytes()[:50])
    return build(out, workers=2, extras=())


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The same without people, so that all that is seen stands still."""
    return build(tmp_path_factory.mktemp("empty") / "out", people=0.0)


@pytest.fixture(scope="module")
def wet() -> Mesh:
    """What stands still in the query's condition."""
    return compose(scenes.district(PLACE), condition_named("WetNoon").factors)


class Straight:
    """A route along x."""

    length = 400.0
    other_lane_m = 3.2

    def pose(self, s: float, lateral_m: float = 0.0, yaw_rad: float = 0.0) -> np.ndarray:
        c, n = np.cos(yaw_rad), np.sin(yaw_rad)
        return np.array([[c, -n, 0, s], [n, c, 0, lateral_m], [0, 0, 1, 0], [0, 0, 0, 1.0]])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.floats(0, 2), st.floats(0, 15), st.integers(2, 200))
def test_a_drive_is_smooth_and_keeps_its_bounds(seed: int, lateral: float, heading: float, steps: int) -> None:
    style = DriveStyle(8.0, lateral, heading)
    driven = drive(Straight(), steps, style, np.random.default_rng(seed))
    assert all(is_rotation(T[:3, :3], 1e-9) for T in driven.T_world_rig)
    assert np.abs(driven.T_world_rig[:, 1, 3]).max() <= lateral + 1e-9
    moved = np.diff(driven.along)
    assert np.all(moved > 0)
    assert np.all(moved < 2 * 0.8)
    assert driven.along[-1] - driven.along[0] == pytest.approx((steps - 1) * 0.8)
    assert driven.along[0] >= 0
    assert driven.along[-1] <= route_length(steps, style)
    yaw = np.degrees(np.arctan2(driven.T_world_rig[:, 1, 0], driven.T_world_rig[:, 0, 0]))
    sideways = np.degrees(np.arctan(0.2 * lateral * 2 * np.pi * (1 / 27 + 1 / 61)))
    assert np.abs(yaw).max() <= heading + sideways + 0.5


def test_cameras_look_where_their_mounts_say_with_the_sky_above() -> None:
    for rig in RIGS.values():
        for name, (camera, T_rig_cam) in rig.cameras(512, 512).items():
            mount = rig.mounts[name]
            yaw, down = np.radians([mount.yaw_deg, mount.down_deg])
            level = np.array([np.cos(yaw), np.sin(yaw), 0.0])
            seen = np.array([mount.forward_m, mount.left_m, mount.up_m]) + 30 * level - [0, 0, 30 * np.tan(down)]
            up = np.array([0.0, 0.0, 4.0])
            points = np.stack([seen, seen + up, seen + 4.0 * np.array([np.sin(yaw), -np.cos(yaw), 0.0])])
            (middle, above, right), valid = camera.project(apply(invert(T_rig_cam), points))
            assert valid.all()
            np.testing.assert_allclose(middle, [255.5, 255.5], atol=1e-9)
            assert above[1] < 250
            assert right[0] > 260
    stereo = RIGS["wide-stereo"].mounts
    T_right_left = invert(stereo["right"].T_rig_cam) @ stereo["left"].T_rig_cam
    np.testing.assert_allclose(T_right_left[:3, 3], [-0.54, 0, 0], atol=1e-12)
    assert len(set(RIGS["six"].mounts.values())) == 6


@pytest.mark.parametrize("mean", [0.84, 1.6, 4.0])
def test_distances_of_pairs_follow_the_distribution_that_was_asked_for(mean: float) -> None:
    style = DriveStyle(heading_deg=15.0)
    frames = []
    for k in range(2):
        driven = drive(Straight(), 400, style, np.random.default_rng(k))
        times = tuple(range(400))
        frames.append(PosedFrames(times, driven.T_world_rig, frozenset(times)))
    reference, query = frames
    spread = DistanceSpread(mean, 10.0, 30.0)
    pairs = drawn_pairs(reference, query, spread, np.random.default_rng(2), same_traversal=False)
    distances = [p.distance_m for p in pairs if p.distance_m is not None]
    assert len(pairs) > 350
    assert np.mean(distances) == pytest.approx(mean, rel=0.15)
    assert max(distances) <= 10.0
    assert max(p.angle_deg or 0 for p in pairs) <= 30.0
    assert all(p.sigma_translation_m == 0 for p in pairs)


def test_moving_cars_keep_to_their_lanes_and_out_of_our_way() -> None:
    driven = drive(Straight(), 200, DriveStyle(), np.random.default_rng(0))
    cars = on_the_road(Straight(), driven, 2.0, 3.2, np.random.default_rng(1))
    count = [len(present) for present in cars]
    assert min(count) >= 10
    ours = {(variant, bool(T[0, 0] > 0)) for present in cars for T, variant, _ in present}
    assert {forward for _, forward in ours} == {True, False}
    for T_world_rig, present in zip(driven.T_world_rig, cars, strict=True):
        for T_world_car, *_ in present:
            assert T_world_car[1, 3] == (0.0 if T_world_car[0, 0] > 0 else 3.2)
            x, y, _ = T_world_car[:3, 3] - T_world_rig[:3, 3]
            assert abs(y) > 2 or abs(x) > 10
    overtaken = on_the_road(Straight(), driven, 2.0, -3.2, np.random.default_rng(1))
    assert min(len(present) for present in overtaken) >= 8
    assert {(T[0, 0] > 0, T[1, 3]) for present in overtaken for T, *_ in present} == {(True, -3.2)}
    first, second = ({v: T for T, v, _ in present} for present in cars[:2])
    steps = [np.linalg.norm(first[v][:3, 3] - second[v][:3, 3]) for v in first.keys() & second.keys()]
    assert max(steps) < 2.0


def test_bicycles_ride_at_the_right_hand_edge_of_their_lanes() -> None:
    driven = drive(Straight(), 50, DriveStyle(), np.random.default_rng(0))
    riders = on_the_road(Straight(), driven, 1.0, 3.2, np.random.default_rng(1), Kind.RIDER)
    assert {thing.kind for present in riders for thing in present} == {Kind.RIDER}
    places = {(bool(T[0, 0] > 0), round(float(T[1, 3]), 6)) for present in riders for T, *_ in present}
    assert places == {(True, -1.15), (False, 3.2 + 1.15)}


@pytest.mark.thorough
def test_people_walk_on_pavements_elsewhere_in_each_drive_and_as_many_as_the_factor_says() -> None:
    footpaths = scenes.district(PLACE).footpaths
    pose = scenes.district(PLACE).network.drive(100.0, 0).pose(40.0)
    still = np.broadcast_to(pose, (30, 4, 4))

    def seen(people: float, seed: int) -> list[dict[int, Array]]:
        steps = passers(footpaths, still, people, np.random.default_rng(seed))
        return [{thing.variant: thing.T_world_thing for thing in present} for present in steps]

    assert sum(map(len, seen(0.0, 1))) == 0
    few, many = (np.mean([len(seen(people, seed)[0]) for seed in range(20)]) for people in (4.0, 16.0))
    assert 3.0 < many / few < 5.0
    first, second = seen(10.0, 1)[0], seen(10.0, 2)[0]
    assert not first.keys() & second.keys()
    lines = [np.concatenate([path.poses(np.arange(0, path.length, 0.2))[:, :2, 3]]) for path in footpaths]
    walked = seen(10.0, 1)
    for before, after in pairwise(walked):
        for name in before.keys() & after.keys():
            # At 1.7 m/s, and with a small step aside where the line round a corner bends.
            assert np.linalg.norm(after[name][:3, 3] - before[name][:3, 3]) < 0.4
            assert min(np.linalg.norm(line - after[name][:2, 3], axis=1).min() for line in lines) < 1.1
            assert after[name][2, 3] in (0.0, pytest.approx(KERB_M))
    moved = [np.linalg.norm(walked[-1][k][:2, 3] - walked[0][k][:2, 3]) for k in walked[0].keys() & walked[-1].keys()]
    assert min(moved) == 0.0
    assert max(moved) > 2.0  # in 2.9 s


@pytest.mark.thorough
def test_the_smoke_preset_is_a_sound_dataset_with_labelled_conditions(town: Dataset) -> None:
    assert town.traversal_names == [REFERENCE, QUERY]
    assert town.traversal(QUERY).condition == condition_named("WetNoon").label
    assert set(town.splits) == {"test"}
    assert {s.name for s in town.pair_sets("test")} == {ACROSS, f"{REFERENCE}__{REFERENCE}__front"}
    outcome = relocbench("validate", town.root)
    assert outcome.status == 0, outcome.err
    times = town.traversal(QUERY).timestamps("front")
    assert np.diff(times).tolist() == [100_000_000] * 3


@pytest.mark.thorough
def test_pairs_agree_with_the_poses_to_their_last_digits(town: Dataset) -> None:
    for pair_set in town.pair_sets():
        reference, query = town.traversal(pair_set.reference), town.traversal(pair_set.query)
        for pair in pair_set.pairs:
            T_world_ref = reference.T_world_cam("front", pair.ref_timestamp_ns)
            T_world_query = query.T_world_cam("front", pair.query_timestamp_ns)
            assert pair.T_query_ref is not None
            rest = invert(T_world_query) @ T_world_ref @ invert(pair.T_query_ref)
            assert np.linalg.norm(rest[:3, 3]) < 2e-8  # both are written to a nanometre and a billionth
            assert rotation_angle(rest[:3, :3]) < 2e-8


def nearest_hit(mesh: Mesh, origin: np.ndarray, direction: np.ndarray) -> float:
    """Distance to the first triangle by Moeller and Trumbore (1997) over all of them, in double precision."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    e1, e2 = b - a, c - a
    p = np.cross(direction, e2)
    determinant = np.einsum("ij,ij->i", e1, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = origin - a
        u = np.einsum("ij,ij->i", s, p) / determinant
        q = np.cross(s, e1)
        v = q @ direction / determinant
        t = np.einsum("ij,ij->i", e2, q) / determinant
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6)
    return float(np.min(t[hit], initial=np.inf))


@pytest.mark.thorough
def test_depth_is_that_of_an_independent_ray_cast(empty: Dataset, wet: Mesh) -> None:
    traversal = empty.traversal(QUERY)
    time_ns = traversal.timestamps("front")[1]
    depth, camera = traversal.depth("front", time_ns), traversal.camera("front")
    assert depth is not None
    T_world_cam = traversal.T_world_cam("front", time_ns)
    rng = np.random.default_rng(0)
    v, u = np.nonzero(depth > 0)
    wrong = 0
    for row in rng.choice(len(u), 24, replace=False):
        ray = camera.unproject(np.array([u[row], v[row]], dtype=float))[0]
        expected = nearest_hit(wet, T_world_cam[:3, 3], T_world_cam[:3, :3] @ ray)
        wrong += abs(depth[v[row], u[row]] - expected) > 1 / 256
    assert wrong == 0


@pytest.mark.thorough
def test_correspondences_hold_forward_and_backward_on_static_surfaces(town: Dataset) -> None:
    pair_set = town.pair_set(ACROSS)
    factors = condition_named("WetNoon").factors
    scene = scenes.static_scene(PLACE, factors)
    for pair in pair_set.pairs:
        rows = read_correspondences(town.layout.correspondence_file(ACROSS), pair.key)
        assert pair.T_query_ref is not None
        assert len(rows) >= 100
        assert np.mean(rows.visible) > 0.5
        seen = rows.uv_query[rows.visible]
        camera = town.traversal(QUERY).camera("front")
        T_world_query = town.traversal(QUERY).T_world_cam("front", pair.query_timestamp_ns)
        origins, directions, lengths = scenes.pixel_rays(camera, T_world_query, seen)
        depth = scene.hits(origins, directions).range / lengths
        back, _, valid = warp(np.column_stack([seen, depth]), camera, camera, invert(pair.T_query_ref))
        error = np.linalg.norm(back - rows.uv_ref[rows.visible], axis=1)
        # A ray to the very edge of a surface may miss it in single precision.
        assert np.mean(valid & (error < 0.05)) > 0.995
        forward, _, _ = warp(np.column_stack([rows.uv_ref, rows.depth_ref]), camera, camera, pair.T_query_ref)
        assert np.abs(forward - rows.uv_query).max() < 1e-3


@pytest.mark.thorough
def test_what_is_called_hidden_is_hidden(empty: Dataset, wet: Mesh) -> None:
    """Visibility against a loop over all triangles, for points that the query sees and points that it does not."""
    pair = empty.pair_set(ACROSS).pairs[0]
    rows = read_correspondences(empty.layout.correspondence_file(ACROSS), pair.key)
    reference, query = empty.traversal(REFERENCE), empty.traversal(QUERY)
    T_world_ref = reference.T_world_cam("front", pair.ref_timestamp_ns)
    centre = query.T_world_cam("front", pair.query_timestamp_ns)[:3, 3]
    rays, _ = reference.camera("front").unproject(rows.uv_ref)
    points = apply(T_world_ref, rays * rows.depth_ref[:, None])
    some = np.concatenate([np.nonzero(rows.visible)[0][:10], np.nonzero(~rows.visible)[0][:10]])
    for row in some:
        offset = points[row] - centre
        far = float(np.linalg.norm(offset))
        reached = nearest_hit(wet, centre, offset / far)
        assert (abs(reached - far) < 0.01 + 1e-3 * far) == rows.visible[row]


@pytest.mark.thorough
def test_conditions_share_what_stands_still(town: Dataset) -> None:
    """Where nothing is marked as changed, the query's surfaces are those of the reference's condition."""
    mesh = compose(scenes.district(PLACE), condition_named("Neutral").factors)
    traversal, camera = town.traversal(QUERY), town.traversal(QUERY).camera("front")
    time_ns = traversal.timestamps("front")[0]
    changed = images.read_image(extra_path(town.root, QUERY, "changed", "front", time_ns)) > 0
    semantic = images.read_image(extra_path(town.root, QUERY, "semantic", "front", time_ns))
    depth = traversal.depth("front", time_ns)
    assert depth is not None
    assert not np.any(changed & np.isin(semantic, (Semantic.SKY,)) & (depth > 0))
    assert 0 < np.mean(changed) < 0.5
    T_world_cam = traversal.T_world_cam("front", time_ns)
    v, u = np.nonzero(~changed & (depth > 0))
    for row in np.random.default_rng(0).choice(len(u), 12, replace=False):
        ray = camera.unproject(np.array([u[row], v[row]], dtype=float))[0]
        expected = nearest_hit(mesh, T_world_cam[:3, 3], T_world_cam[:3, :3] @ ray)
        assert depth[v[row], u[row]] == pytest.approx(expected, abs=0.02 + 1e-3 * expected)
    reference_time = town.traversal(REFERENCE).timestamps("front")[0]
    here, semantic = (
        images.read_image(extra_path(town.root, REFERENCE, kind, "front", reference_time))
        for kind in ("changed", "semantic")
    )
    assert np.array_equal(here > 0, moves(semantic))


@pytest.mark.thorough
def test_extras_are_exact_and_outside_of_the_fingerprint(
    town: Dataset, resumed: Dataset, wet: Mesh, tmp_path: Path
) -> None:
    time_ns = town.traversal(QUERY).timestamps("front")[0]
    r, g, b = np.moveaxis(
        images.read_image(extra_path(town.root, QUERY, "instance", "front", time_ns)).astype(np.uint32), -1, 0
    )
    instance = r + 256 * g + 65536 * b
    semantic = images.read_image(extra_path(town.root, QUERY, "semantic", "front", time_ns))
    assert (np.isin(instance, wet.instance) | moves(semantic)).all()
    assert len(np.unique(instance)) > 3
    assert resumed.fingerprint == town.fingerprint
    assert not (resumed.root / "extras").exists()
    # Asked for later: the pictures that are there already are not rendered again.
    out = shutil.copytree(resumed.root, tmp_path / "later")
    shutil.copytree(town.root / "extras", out / "extras")
    later, before = (extra_path(root, QUERY, "semantic", "front", time_ns) for root in (out, town.root))
    later.unlink()
    assert build(out, extras=("semantic",)).fingerprint == town.fingerprint
    assert later.read_bytes() == before.read_bytes()


@pytest.mark.thorough
def test_a_frame_is_the_same_when_rendered_on_its_own(town: Dataset, wet: Mesh, tmp_path: Path) -> None:
    """By a renderer that rendered nothing before: the files of image and depth, byte for byte."""
    traversal, layout = town.traversal(QUERY), town.traversal(QUERY).layout
    first, _, third, _ = traversal.timestamps("front")
    number = int(first // 10**12 - 1)
    conditions = conditions_of(("Neutral", "WetNoon"), {}, None, 2)
    _, plan = make_plans(AskedDrives(("test",), conditions, 1, 0), 4, DriveStyle(), extent_m=190.0, reporter=Silent())
    still = Renderer(wet, condition_named("WetNoon").factors, scenes.district(PLACE).lamps, PLACE.seed)
    alone = still.with_moving(moving_mesh(plan.moving[2]))
    T_world_cam = traversal.T_world_cam("front", third)
    frame = alone.render(traversal.camera("front"), T_world_cam, scenes.frame_seed(0, number, 2, 0))
    images.write_image(tmp_path / "image.png", frame.rgb)
    images.write_depth(tmp_path / "depth.png", frame.depth)
    assert (tmp_path / "image.png").read_bytes() == layout.image("front", third).read_bytes()
    assert (tmp_path / "depth.png").read_bytes() == layout.depth("front", third).read_bytes()


@pytest.mark.thorough
def test_a_build_renders_one_missing_frame_alone_to_the_same_bytes(town: Dataset, tmp_path: Path) -> None:
    copy = Dataset(shutil.copytree(town.root, tmp_path / "copy"))
    layout = copy.traversal(QUERY).layout
    first, *_, last = copy.traversal(QUERY).timestamps("front")
    wanted = [layout.image("front", last), layout.depth("front", last)]
    before = [path.read_bytes() for path in wanted]
    untouched = layout.image("front", first).stat().st_mtime_ns
    for path in wanted:
        path.unlink()
    assert build(copy.root).fingerprint == town.fingerprint
    assert [path.read_bytes() for path in wanted] == before
    assert layout.image("front", first).stat().st_mtime_ns == untouched


@pytest.mark.thorough
def test_neither_a_kill_nor_workers_change_the_bytes(town: Dataset, resumed: Dataset) -> None:
    """One process rendered the first images until it was killed, and two workers did the rest."""
    assert resumed.fingerprint == town.fingerprint


@pytest.mark.thorough
def test_what_moves_is_rendered_marked_as_changed_and_never_matched(tmp_path: Path) -> None:
    dataset = build(tmp_path / "out", traffic=3.0, people=30.0, conditions=("Neutral",), correspondences=2000, steps=3)
    query = dataset.traversal_names[0]
    found: set[int] = set()
    for time_ns in dataset.traversal(query).timestamps("front"):
        semantic = images.read_image(extra_path(dataset.root, query, "semantic", "front", time_ns))
        changed = images.read_image(extra_path(dataset.root, query, "changed", "front", time_ns)) > 0
        moving = moves(semantic)
        found |= set(semantic[moving].tolist())
        assert changed[moving].mean() > 0.99
        for pair in dataset.pair_sets()[0].pairs:
            if pair.ref_timestamp_ns == time_ns:
                rows = read_correspondences(dataset.layout.correspondence_file(dataset.pair_sets()[0].name), pair.key)
                u, v = rows.uv_ref.astype(int).T
                assert not moving[v, u].any()
    assert found >= {Semantic.MOVING_CAR, Semantic.PERSON}


def test_pair_sets_are_those_that_were_asked_for() -> None:
    conditions = conditions_of(("Neutral", "Rain"), {}, None, 2)

    def count(traversals: int, reference: References = "first", pair_rule: str | None = None) -> int:
        asked = AskedDrives(("test",), conditions, traversals, 0)
        plans = make_plans(asked, 3, DriveStyle(), extent_m=190.0, reporter=Silent())
        return len(evaluated_drives(plans, references=reference, traversals=traversals, pair_rule=pair_rule))

    assert count(1) == 2
    assert count(1, reference="all") == 4
    assert count(1, reference="others") == 2
    assert count(2) == 3
    assert count(2, reference="all") == count(2, reference="others") == 12
    assert count(2, reference="all", pair_rule="step") == 4
    assert count(1, pair_rule="nearest") == 1


@pytest.mark.thorough
def test_a_sweep_takes_the_place_of_conditions(tmp_path: Path) -> None:
    dataset = build(tmp_path / "out", sweep="leaves", sweep_steps=2, steps=2, size="32x32", extras=())
    assert dataset.traversal_names == ["test-leaves-0-0", "test-leaves-1-0"]
    factors = dataset.file.made_by["factors"]
    differing = {k for k, v in factors["leaves-0"].items() if v != factors["leaves-1"][k]}
    assert differing == {"foliage"}


def test_mistakes_are_named(tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out")
    command = ("build-dataset", "synthetic", "--preset", "smoke")
    for words, name in (
        ((*command, "--conditions", "Hail"), "Hail"),
        ((*command, "--size", "big"), "--size"),
        ((*command, "--sweep", "mud"), "mud"),
        (("build-dataset", "synthetic", "--preset", "big"), "--preset"),
        (("preview",), "--sweep"),
    ):
        assert_names(relocbench(*words, *out).complaint, "", None, name)
    assert not (tmp_path / "out").exists()


def test_a_preview_that_cannot_be_written_is_not_rendered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("relocbench.datasets.synthetic.jobs.contact_sheet.contact_sheet", None)
    told = relocbench("preview", "-c", "Sunny", "--out", tmp_path)
    assert (told.status, told.complaint) == (2, f"relocbench: {tmp_path}: Is a directory")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough
@pytest.mark.usefixtures("small_preview")
def test_a_preview_has_a_picture_for_each_condition(tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.png"
    outcome = relocbench("preview", "-c", "Sunny,Snow", "--size", "96x72", "--out", sheet, "--quiet")
    assert outcome.status == 0, outcome.err
    picture = images.read_image(sheet)
    assert picture.shape == (72, 2 * 96 + 4, 3)
    left, right = picture[:, :96].astype(float), picture[:, 100:].astype(float)
    assert np.abs(left - right).mean() > 5


def test_drives_of_one_route_differ() -> None:
    one, two = (drive(Straight(), 50, DriveStyle(), np.random.default_rng(k)) for k in range(2))
    assert isinstance(one, Drive)
    assert np.abs(one.T_world_rig[:, 1, 3] - two.T_world_rig[:, 1, 3]).max() > 0.05
    assert np.abs(one.along - two.along).max() > 0.05


@pytest.mark.thorough
def test_pairs_of_different_places_change_nothing_else(tmp_path: Path) -> None:
    size = ("--size", "32", "--steps", 8, "--speed", 40, "--conditions", "Sunny", "--correspondences", 10, "-j", 1)
    apart = ("--elsewhere", 4, "--elsewhere-distance", 12)
    for name, words in (("plain", ()), ("with", apart)):
        outcome = relocbench("build-dataset", "synthetic", *size, *words, "--out", tmp_path / name, "-q")
        assert outcome.status == 0, outcome.err
    plain, made = Dataset(tmp_path / "plain"), Dataset(tmp_path / "with")
    assert (plain.file.format_version, made.file.format_version) == (1, 2)
    assert "elsewhere" not in plain.file.made_by["options"]
    (name,) = made.pair_set_names
    assert len(made.pair_set(name).negative_pairs) == 4
    assert all((p.distance_m or 0) >= 12 for p in made.pair_set(name).negative_pairs)
    files = {p.relative_to(plain.root): p.read_bytes() for p in plain.root.rglob("*") if p.is_file()}
    changed = {str(path) for path, content in files.items() if (made.root / path).read_bytes() != content}
    assert changed == {"build.yaml", "dataset.yaml", "manifest.csv", f"pairs/{name}.csv", f"pairs/{name}.txt"}
    table = (
        made.layout.pair_table(name).read_text().splitlines(),
        plain.layout.pair_table(name).read_text().splitlines(),
    )
    assert [line for line in table[0] if ",elsewhere," not in line] == table[1]
    assert relocbench("validate", made.root).status == 0
    outcome = relocbench("build-dataset", "synthetic", *size, "--elsewhere", 4, "--out", tmp_path / "short", "-q")
    assert outcome.status == 2
    assert_names(outcome.err, "", None, "--elsewhere", 4, 0)

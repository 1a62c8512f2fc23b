"""The procedural town: its geometry, its drives and what changes with season and cars."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from refusals import refused

from relocbench.arrays import Array, Floats, Indices, Mask
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.renderer.lettering import PAGES
from relocbench.datasets.synthetic.town.cars import CAR_TYPES, car_shape, solid_shape
from relocbench.datasets.synthetic.town.furniture import bench, bin_shape, bollard, fountain
from relocbench.datasets.synthetic.town.houses.buildings import house_shape
from relocbench.datasets.synthetic.town.houses.house import DEPTH_M, draw_house
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic
from relocbench.datasets.synthetic.town.moving import Kind, Moving
from relocbench.datasets.synthetic.town.network import make_network
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, ear_clip, join, quads, triangle_shape, tube
from relocbench.datasets.synthetic.town.streets import KERB_M
from relocbench.datasets.synthetic.town.town import District, Periodic, compose, make_district
from relocbench.datasets.synthetic.town.vegetation import TREE_TYPES, hedge_shapes, tree_shapes
from relocbench.errors import ConfigError

ARRAYS = ("vertices", "triangles", "uv", "material", "semantic", "instance", "variant", "rank")
ROAD = {Material.ASPHALT, Material.LANE_MARKING}


@pytest.fixture(scope="module")
def district() -> District:
    return scenes.district(scenes.DistrictSpec(0, "test", 250.0))


@pytest.fixture(scope="module")
def crowded(district: District) -> Mesh:
    """Without leaves, with a car in every bay."""
    return compose(district, Factors(foliage=0.0, parked_share=1.0))


class Rays:
    """Casts rays at a mesh."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.scene = o3d.t.geometry.RaycastingScene()
        self.scene.add_triangles(
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.vertices)),
            o3d.core.Tensor.from_numpy(np.ascontiguousarray(mesh.triangles)),
        )

    def cast(self, origins: Any, directions: Any) -> tuple[Floats, Indices]:
        """Distance (inf where nothing is hit) and triangle of each ray."""
        both = np.concatenate(np.broadcast_arrays(origins, directions), axis=-1).astype(np.float32)
        answer = self.scene.cast_rays(o3d.core.Tensor.from_numpy(both))
        return answer["t_hit"].numpy(), answer["primitive_ids"].numpy().astype(np.int64)


@pytest.fixture(scope="module")
def rays(crowded: Mesh) -> Rays:
    return Rays(crowded)


def normals(vertices: NDArray[Any], triangles: NDArray[Any]) -> Array:
    corners = vertices[triangles].astype(np.float64)
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def volume(shape: Shape) -> float:
    """Enclosed by a closed surface whose triangles face outward (divergence theorem)."""
    corners = shape.vertices[shape.triangles]
    return float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def open_edges(shape: Shape) -> int:
    """Edges that no neighbour runs along in the opposite direction, after joining equal points."""
    _, point = np.unique(np.round(shape.vertices, 6), axis=0, return_inverse=True)
    rows = point.ravel()[shape.triangles]
    rows = rows[(rows[:, 0] != rows[:, 1]) & (rows[:, 1] != rows[:, 2]) & (rows[:, 2] != rows[:, 0])]
    edges: dict[tuple[int, int], int] = {}
    for a, b in np.concatenate([rows[:, [0, 1]], rows[:, [1, 2]], rows[:, [2, 0]]]).tolist():
        edges[(a, b)] = edges.get((a, b), 0) + 1
    return sum(max(0, n - edges.get((b, a), 0)) for (a, b), n in edges.items())


def poses_along(district: District, length: float, seed: int, step: float) -> Array:
    path = district.network.drive(length, seed)
    return np.stack([path.pose(float(s)) for s in np.arange(0, path.length, step)])


def prism(outline: list[list[float]], y0: float, y1: float, material: int) -> Shape:
    """An outline (P, 2) in the x-z plane, counter-clockwise seen from -y, drawn out from y0 to y1 > y0."""
    polygon = np.asarray(outline, dtype=float)
    count = len(polygon)
    near = np.insert(polygon, 1, y0, axis=1)
    far = np.insert(polygon, 1, y1, axis=1)
    faces = ear_clip(polygon)
    after = np.roll(np.arange(count), -1)
    rim = np.stack([near, far, far[after], near[after]], axis=1)
    ends = triangle_shape(np.concatenate([near, far]), np.concatenate([faces, faces[:, ::-1] + count]), material)
    return join([quads(rim, material), ends])


def test_bars_boxes_and_prisms_are_closed_and_face_outward() -> None:
    bar = tube([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.3, 0.0, 2.0]], [0.5, 0.4, 0.1], 12, Material.METAL)
    outline = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 0.2], [0.0, 1.0]]
    solid = prism(outline, -1.0, 2.0, Material.WOOD)
    assert [open_edges(s) for s in (bar, solid, boxes([0, 0, 0], [1, 2, 3], Material.WOOD))] == [0, 0, 0]
    assert volume(boxes([0, 0, 0], [1, 2, 3], Material.WOOD)) == pytest.approx(6)
    assert volume(solid) == pytest.approx(3 * (2 - 0.8))  # the square less the notch of base 2 and depth 0.8
    assert volume(bar) > 0


def test_ear_clipping_covers_a_polygon_once() -> None:
    polygon = np.array([[0, 0], [4, 0], [4, 3], [2, 1], [0, 3.0]])
    corners = polygon[ear_clip(polygon)]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(12 - 4)


@pytest.mark.parametrize("kind", range(CAR_TYPES))
def test_a_car_is_closed_but_for_flat_parts_that_are_stuck_on_and_of_a_cars_size(kind: int) -> None:
    car = car_shape(kind)
    assert open_edges(solid_shape(kind)) == 0
    assert len(car) < 1800
    assert 4.0 < volume(solid_shape(kind)) < 14.0
    low, high = car.vertices.min(0), car.vertices.max(0)
    assert low[2] == pytest.approx(0.0, abs=1e-3)
    assert 3.4 < high[0] - low[0] < 5.2
    assert 1.6 < high[1] - low[1] < 2.4
    shown = {Material.CAR_PAINT, Material.CAR_GLASS, Material.RUBBER, Material.LAMP}
    assert shown | {Material.TAIL_LAMP, Material.NUMBER_PLATE, Material.LIGHT_METAL} <= set(car.material.tolist())


@pytest.mark.parametrize("kind", range(TREE_TYPES))
def test_wood_is_closed_but_for_flat_twigs_and_leaf_ranks_are_spread_evenly(kind: int) -> None:
    assert open_edges(tree_shapes(kind, coarse=True)[0]) == 0
    wood, leaves = tree_shapes(kind)
    uses = np.bincount(wood.triangles.ravel())
    twigs = (uses[wood.triangles] == 1).all(axis=1)
    assert open_edges(wood) == 3 * np.count_nonzero(twigs) > 0
    assert volume(wood) > 0.1
    assert 0 < leaves.rank.min() < leaves.rank.max() < 1
    assert np.allclose(np.quantile(leaves.rank, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.01)


def test_half_of_the_leaves_are_some_bare_some_thin_and_some_full_trees(district: District) -> None:
    """Each tree sheds within a quarter of autumn, and evergreens never."""
    of_trees = district.foliage.semantic == Semantic.TREE
    _, tree, leaves = np.unique(district.foliage.instance[of_trees], return_inverse=True, return_counts=True)
    left = np.bincount(tree, district.foliage.rank[of_trees] < 0.5) / leaves
    assert left.mean() == pytest.approx(0.5, abs=0.05)
    assert (left == 0).mean() > 0.2
    assert (left == 1).mean() > 0.2
    assert ((left > 0.2) & (left < 0.8)).any()
    winter = compose(district, Factors(foliage=0.0))
    assert np.isin(Material.HEDGE, winter.material[winter.semantic == Semantic.TREE])


def test_a_hedge_and_turned_furniture_are_closed() -> None:
    for solid in (hedge_shapes(4.0, 1.2, 3)[0], fountain(), bollard(), bench(), bin_shape()):
        assert open_edges(solid) == 0
        assert volume(solid) > 0


@pytest.mark.parametrize("style", ["terrace", "town", "villa", "modern"])
def test_a_house_encloses_about_its_walls_times_its_ground_with_faces_outward(style: str) -> None:
    rng = np.random.default_rng(5)
    for _ in range(4):
        house = draw_house(rng, style)
        walls = 9.0 * DEPTH_M * house.wall_m
        assert 0.95 * walls < volume(house_shape(house, 9.0)) < 1.6 * walls


@pytest.mark.thorough
def test_a_district_has_the_promised_size_and_everything_a_street_has(district: District) -> None:
    moving = [Moving(np.eye(4), seed, kind) for kind in Kind for seed in range(20)]
    whole = compose(district, Factors(months=24.0), moving)
    assert 500_000 < len(district.static) + len(district.foliage) < 1_800_000
    assert set(Material) == set(whole.material.tolist())
    assert set(Semantic) - {Semantic.SKY, Semantic.NONE} == set(whole.semantic.tolist())
    assert len(district.bays) > 60
    assert len(district.lamps) > 40
    assert np.isfinite(whole.vertices).all()
    assert np.isfinite(whole.uv).all()


@pytest.mark.thorough
@pytest.mark.parametrize("months", [0.0, 24.0])
def test_every_object_has_one_number_and_one_class(district: District, months: float) -> None:
    whole = compose(district, Factors(months=months))
    pairs = np.unique(np.stack([whole.instance, whole.semantic]), axis=1)
    objects = pairs[0, pairs[0] > 0]
    assert len(objects) == len(np.unique(objects))
    ground = set(whole.semantic[whole.instance == 0].tolist())
    assert ground == {Semantic.ROAD, Semantic.PAVEMENT, Semantic.MARKING, Semantic.TERRAIN}


def test_surface_coordinates_are_in_metres(district: District) -> None:
    mesh = district.static
    area = 0.5 * np.linalg.norm(normals(mesh.vertices, mesh.triangles), axis=1)
    a, b = mesh.uv[:, 1] - mesh.uv[:, 0], mesh.uv[:, 2] - mesh.uv[:, 0]
    uv_area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    flat = np.isin(mesh.semantic, [Semantic.BUILDING, Semantic.SIGN])  # those of streets are along their bends
    round_bars = mesh.material == Material.METAL
    of_signs = np.isin(mesh.material, list(PAGES))
    chosen = flat & ~round_bars & ~of_signs & (mesh.material != Material.ROOF_TILES) & (area > 1e-3)
    assert np.allclose(uv_area[chosen], area[chosen], rtol=0.02, atol=1e-3)


@pytest.mark.thorough
def test_the_same_seed_gives_the_same_bytes(district: District) -> None:
    again = make_district(0)
    for part in ("static", "foliage"):
        for name in ARRAYS:
            assert getattr(getattr(district, part), name).tobytes() == getattr(getattr(again, part), name).tobytes()
    assert district.bays.tobytes() == again.bays.tobytes()
    assert district.lamps.tobytes() == again.lamps.tobytes()


def test_no_street_of_a_seed_and_split_occurs_in_another() -> None:
    """Streets are compared by their lengths, which neither turning nor shifting hides."""
    lengths = []
    for split in range(3):
        for seed in range(8):
            network = make_network(np.random.default_rng([seed, split, 0]), 250.0)
            ends = np.array([e for e in network.street if e[0] < e[1]])
            lengths.append(np.linalg.norm(network.nodes[ends[:, 0]] - network.nodes[ends[:, 1]], axis=1))
    together = np.sort(np.concatenate(lengths))
    assert np.diff(together).min() > 1e-6


def test_bad_requests_are_told(district: District) -> None:
    with refused(ConfigError, "", None, "evaluation", "train", "validation", "test"):
        make_district(0, "evaluation")
    with refused(ConfigError, "", None, 180, "100.0"):
        make_district(0, "test", 100.0)
    with refused(ConfigError, "", None, "-1"):
        make_district(-1)
    with refused(ConfigError, "", None, "0.0 m"):
        district.network.drive(0.0, 0)
    with refused(ConfigError, "", None, "50.0 m", "51.0 m"):
        district.network.drive(50.0, 0).pose(51.0)


@pytest.mark.thorough
def test_there_is_ground_below_every_place_as_far_as_one_sees(rays: Rays) -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(-1, 1, (4000, 3)) * np.repeat([[130.0], [1500.0]], 2000, axis=0)
    places[:, 2] = 100.0
    distance, hit = rays.cast(places, [0, 0, -1.0])
    assert np.isfinite(distance).all()
    solid = hit[rays.mesh.material[hit] != Material.HEDGE]  # needles turn any way
    assert len(solid) > 3000
    assert (normals(rays.mesh.vertices, rays.mesh.triangles[solid])[:, 2] > 0).mean() > 0.999


def test_a_driver_sees_houses_and_kerbs_from_outside_and_no_gap_below_the_horizon(
    district: District, rays: Rays
) -> None:
    rng = np.random.default_rng(2)
    for pose in poses_along(district, 600.0, 3, 40.0):
        d = rng.normal(0, 1, (3000, 3)) * [1, 1, 0.35]
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        distance, hit = rays.cast(pose[:3, 3] + [0, 0, 1.6], d)
        assert np.isfinite(distance[d[:, 2] < -0.01]).all()
        seen = np.isfinite(distance)
        facing = np.einsum("ri,ri->r", normals(rays.mesh.vertices, rays.mesh.triangles[hit[seen]]), d[seen]) < 0
        assert facing.mean() > 0.995
        walls = np.isin(rays.mesh.semantic[hit[seen]], [Semantic.BUILDING, Semantic.PAVEMENT, Semantic.PARKED_CAR])
        assert facing[walls].mean() > 0.998


def test_houses_close_the_ends_of_streets(district: District, rays: Rays) -> None:
    """Looking level along the road at eye height, hardly ever does one look out of the town."""
    poses = poses_along(district, 900.0, 4, 5.0)
    distance, _ = rays.cast(poses[:, :3, 3] + [0, 0, 1.6], poses[:, :3, 0] + [0, 0, 0.02])
    assert (distance < 260.0).mean() > 0.97


def test_land_rises_behind_the_town_but_hides_the_sun_from_no_street(district: District) -> None:
    """The lowest sun of a named condition by day is 7 degrees high."""
    static = district.static
    land = static.vertices[static.triangles[static.semantic == Semantic.TERRAIN]].reshape(-1, 3)
    hills = land[np.linalg.norm(land[:, :2], axis=1) > 500]
    elevation = []
    for pose in poses_along(district, 600.0, 3, 40.0):
        offset = hills - pose[:3, 3]
        elevation.append(np.degrees(np.arctan2(offset[:, 2], np.linalg.norm(offset[:, :2], axis=1))))
    highest = np.max(elevation, axis=1)
    assert (highest > 0.6).all()
    assert (highest < 7.0).all()
    beyond = np.linalg.norm(district.network.nodes, axis=1).max() + 40
    woods = district.foliage.vertices[district.foliage.triangles[district.foliage.semantic == Semantic.TERRAIN]]
    assert len(woods) > 5000
    assert np.linalg.norm(woods[..., :2], axis=2).min() > beyond


@pytest.mark.thorough
def test_houses_of_the_street_that_repeats_are_alike_and_others_differ(district: District) -> None:
    """By the shape and look of their fronts, in the house's own frame."""
    alike: dict[tuple[bytes, bytes], int] = {}
    for _, plot in district.inventory.houses:
        shape = house_shape(plot.house, plot.width, plot.left, plot.right)
        key = np.round(shape.vertices, 4).tobytes(), (shape.variant ^ plot.house.variant).tobytes()
        alike[key] = alike.get(key, 0) + 1
    counts = sorted(alike.values(), reverse=True)
    houses = sum(front.houses for front in district.periodic.fronts)
    fewest = max(front.houses for front in district.periodic.fronts)
    assert fewest <= counts[0] <= houses
    assert counts[len(district.periodic.fronts)] < 3


@pytest.mark.parametrize("seed", range(3))
def test_a_drive_stays_on_the_road_in_its_lane(district: District, rays: Rays, seed: int) -> None:
    poses = poses_along(district, 900.0, seed, 0.5)
    for wheel in ([1.3, 0.75], [1.3, -0.75], [-1.3, 0.75], [-1.3, -0.75], [0, 0]):
        foot = poses[:, :3, 3] + poses[:, :3, 0] * wheel[0] + poses[:, :3, 1] * wheel[1]
        distance, hit = rays.cast(foot + np.array([0, 0, 0.2]), [0, 0, -1.0])
        assert set(rays.mesh.material[hit].tolist()) <= ROAD
        assert np.abs(distance - 0.2).max() < 0.006


def test_a_drive_is_as_long_as_asked_smooth_and_repeatable(district: District) -> None:
    path, again = (district.network.drive(1200.0, 7) for _ in range(2))
    assert path.points.tobytes() == again.points.tobytes()
    assert path.length == pytest.approx(1200.0, abs=0.3)
    assert not np.array_equal(path.points[:400], district.network.drive(1200.0, 8).points[:400])
    curvature = np.diff(path.heading) / path.step
    assert np.abs(curvature).max() < 1 / 5.0
    assert np.abs(np.diff(curvature) / path.step).max() < 0.2
    steps = np.linalg.norm(np.diff(path.points, axis=0), axis=1)
    assert np.allclose(steps, path.step, rtol=0.02)


@pytest.mark.parametrize("length", [40.0, 333.0, 4000.0])
def test_drives_of_any_length_stay_smooth_to_the_end(district: District, length: float) -> None:
    for seed in range(4):
        path = district.network.drive(length, seed)
        assert np.abs(np.diff(path.heading)).max() < path.step / 5.0
        assert np.linalg.norm(np.diff(path.points, axis=0), axis=1).min() > 0.9 * path.step


def test_lateral_and_heading_offsets_move_the_vehicle_to_its_left() -> None:
    network = make_network(np.random.default_rng(0), 250.0)
    path = network.drive(200.0, 0)
    here, there = path.pose(50.0), path.pose(50.0, lateral_m=1.5, yaw_rad=0.2)
    moved = np.linalg.inv(here) @ there
    assert np.allclose(moved[:3, 3], [0, 1.5, 0], atol=1e-9)
    assert np.arctan2(moved[1, 0], moved[0, 0]) == pytest.approx(0.2)
    assert np.allclose(here[:3, :3] @ here[:3, :3].T, np.eye(3))


def test_a_drive_keeps_to_the_right(district: District) -> None:
    """On a straight street the centre line is 1.6 m to the left."""
    path = district.network.drive(900.0, 1)
    nodes, edges = district.network.nodes, [e for e in district.network.street if e[0] < e[1]]
    left = 0
    for s in np.arange(5.0, path.length, 10.0):
        pose = path.pose(float(s))
        for u, v in edges:
            d = (nodes[v] - nodes[u]) / np.linalg.norm(nodes[v] - nodes[u])
            to_line = pose[:2, 3] - nodes[u]
            along, across = to_line @ d, abs(d[0] * to_line[1] - d[1] * to_line[0])
            inside = 15 < along < np.linalg.norm(nodes[v] - nodes[u]) - 15
            if inside and across < 4 and abs(abs(pose[:2, 0] @ d) - 1) < 1e-6:
                sideways = (nodes[u] + along * d - pose[:2, 3]) @ pose[:2, 1]
                assert sideways == pytest.approx(1.6, abs=1e-3)
                left += 1
    assert left > 10


def outline_is_free(rays: Rays, poses: Array, length: float, width: float) -> Mask:
    """Whether rays round the outline of a vehicle and through it, at three heights, hit nothing."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1], [-1, -1]]) * [length / 2, width / 2]
    free = np.ones(len(poses), dtype=bool)
    for height in (0.35, 0.9, 1.5):
        points = np.column_stack([corners, np.full(len(corners), height)])
        world = np.einsum("nij,cj->nci", poses[:, :3, :3], points) + poses[:, None, :3, 3]
        step = np.diff(world, axis=1)
        reach = np.linalg.norm(step, axis=2)
        distance, _ = rays.cast(world[:, :-1].reshape(-1, 3), (step / reach[..., None]).reshape(-1, 3))
        free &= (distance.reshape(reach.shape) > reach).all(axis=1)
    return free


@pytest.mark.parametrize("seed", range(3))
def test_a_driving_car_touches_neither_houses_nor_parked_cars_nor_posts(
    district: District, rays: Rays, seed: int
) -> None:
    assert outline_is_free(rays, poses_along(district, 1200.0, seed, 1.0), 4.8, 2.1).all()


def test_bays_are_on_the_road_and_free(district: District) -> None:
    rays = Rays(compose(district, Factors(foliage=0.0, parked_share=0.0)))
    assert outline_is_free(rays, district.bays, 5.6, 2.0).all()
    for x, y in ((0, 0), (2.8, 1), (2.8, -1), (-2.8, 1), (-2.8, -1)):
        place = district.bays[:, :3, 3] + district.bays[:, :3, 0] * x + district.bays[:, :3, 1] * y
        _, hit = rays.cast(place + np.array([0, 0, 0.3]), [0, 0, -1.0])
        assert set(rays.mesh.material[hit].tolist()) <= ROAD


def test_lamps_hang_over_the_street_side_of_their_posts(district: District, rays: Rays) -> None:
    distance, hit = rays.cast(district.lamps + np.array([0, 0, 0.03]), [0, 0, 1.0])
    assert (distance < 0.2).all()
    assert np.isin(rays.mesh.material[hit], [Material.LAMP, Material.METAL]).all()
    assert np.allclose(district.lamps[:, 2], KERB_M + 5.62)


def test_the_season_takes_leaves_and_nothing_else(district: District) -> None:
    summer, thin, winter = (compose(district, Factors(foliage=f, parked_share=0.0)) for f in (1.0, 0.5, 0.0))
    assert len(winter) == len(district.static)
    assert len(summer) == len(district.static) + len(district.foliage)
    assert len(thin) == pytest.approx((len(summer) + len(winter)) / 2, rel=0.02)
    assert not np.isin(winter.material, [Material.LEAF]).any()
    assert (winter.material == Material.BARK).any()
    for mesh in (summer, thin, winter):
        for name in ARRAYS[1:]:
            assert np.array_equal(getattr(mesh, name)[: len(district.static)], getattr(district.static, name))


def parked(mesh: Mesh) -> set[int]:
    return set(mesh.instance[mesh.semantic == Semantic.PARKED_CAR].tolist())


def test_parked_cars_follow_share_and_seed_and_leave_the_rest_alone(district: District) -> None:
    few, many, others = (
        compose(district, Factors(parked_share=share, parked_seed=seed, foliage=0.0))
        for share, seed in ((0.3, 0), (0.7, 0), (0.7, 1))
    )
    assert parked(few) < parked(many)
    assert len(parked(few)) == round(0.3 * len(district.bays))
    assert not parked(many) & parked(others)
    assert not parked(many) & set(district.static.instance.tolist())
    for name in ARRAYS[1:]:
        assert np.array_equal(getattr(others, name)[: len(district.static)], getattr(district.static, name))


def test_parked_cars_stand_in_their_bays(district: District, crowded: Mesh) -> None:
    cars = crowded.select(crowded.semantic == Semantic.PARKED_CAR)
    for bay, name in enumerate(np.unique(cars.instance).tolist()):
        points = cars.vertices[np.unique(cars.triangles[cars.instance == name])]
        local = (np.append(points, np.ones((len(points), 1)), axis=1) @ np.linalg.inv(district.bays[bay]).T)[:, :3]
        assert np.abs(local[:, 0]).max() < 2.9
        assert np.abs(local[:, 1]).max() < 1.3


def test_moving_cars_are_added_where_they_are(district: District) -> None:
    pose = district.network.drive(100.0, 0).pose(40.0)
    mesh = compose(district, Factors(parked_share=0.0, foliage=0.0), [Moving(pose, 5), Moving(pose, 6)])
    moving = mesh.semantic == Semantic.MOVING_CAR
    assert set(mesh.instance[moving].tolist()) == {2**31 + 5, 2**31 + 6}
    assert set(mesh.variant[mesh.material == Material.CAR_PAINT].tolist()) == {5, 6}
    points = mesh.vertices[mesh.triangles[moving]].reshape(-1, 3)
    assert np.linalg.norm((points - pose[:3, 3])[:, :2], axis=1).max() < 3.0


def facade(rays: Rays, periodic: Periodic, front: int, shift: float) -> Sequence[NDArray[Any]]:
    """Depth, material and look of a front, seen straight on from 0.9 m before it."""
    row = periodic.fronts[front]
    d = (row.end - row.start) / np.linalg.norm(row.end - row.start)
    out = np.array([d[1], -d[0]])
    along, height = np.meshgrid(np.arange(0.037, row.period_m, 0.11), np.arange(0.31, 5.2, 0.13))
    foot = row.start + (along.ravel() + shift)[:, None] * d + 0.9 * out
    eye = np.column_stack([foot, height.ravel() + KERB_M])
    distance, hit = rays.cast(eye, [*-out, 0.0])
    return distance, rays.mesh.material[hit], rays.mesh.variant[hit]


def test_the_periodic_stretch_repeats_and_other_streets_do_not(district: District, rays: Rays) -> None:
    assert sum(f.houses for f in district.periodic.fronts) >= 8
    for k, row in enumerate(district.periodic.fronts):
        assert np.linalg.norm(row.end - row.start) == pytest.approx(row.houses * row.period_m)
        first = facade(rays, district.periodic, k, 0.0)
        for house in range(1, row.houses):
            other = facade(rays, district.periodic, k, house * row.period_m)
            same = np.abs(first[0] - other[0]) < 1e-3
            assert same.mean() > 0.995  # a ray on the very edge of a frame may fall to either side
            assert (first[1] == other[1])[same].mean() > 0.995
            assert (first[2] == other[2])[same].mean() > 0.995
        halfway = facade(rays, district.periodic, k, row.period_m / 2)
        assert (np.abs(first[0] - halfway[0]) < 1e-3).mean() < 0.9


def test_the_drive_tells_where_it_follows_the_periodic_street(district: District) -> None:
    path = district.network.drive(2500.0, 0)
    stretches = [(start, end) for start, end, name in path.streets if name == district.periodic.street]
    assert stretches
    names = [name for _, _, name in path.streets]
    assert all(a != b for a, b in pairwise(names))
    assert path.streets[0][0] == 0.0
    assert path.streets[-1][1] == pytest.approx(path.length)
    rows = np.array([[f.start, f.end] for f in district.periodic.fronts]).reshape(-1, 2)
    for start, end in stretches:
        if end - start > 35.0:
            middle = path.pose((start + end) / 2)[:2, 3]
            assert np.linalg.norm(rows - middle, axis=1).min() < 45.0

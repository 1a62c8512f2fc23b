"""A street over months: what changes stays changed, stands where nobody drives, and is known to the truth."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from refusals import assert_names

from relocbench.arrays import Array, Mask
from relocbench.datasets.importers.rendered import dataset as synthetic
from relocbench.datasets.synthetic.conditions.condition import SEASONS, Factors, sweep
from relocbench.datasets.synthetic.conditions.presets import conditions_of, previewed
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.exact_correspondences import View
from relocbench.datasets.synthetic.renderer.render import Frame
from relocbench.datasets.synthetic.town.ageing import COURSES, Change, Course
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.network import LANE_M
from relocbench.datasets.synthetic.town.polylines import edge_frame
from relocbench.datasets.synthetic.town.streets import KERB_M
from relocbench.datasets.synthetic.town.town import District, compose
from relocbench.execution import Run
from relocbench.geometry import Camera
from relocbench.progress import Silent

PLACE = scenes.DistrictSpec(0, "test", 250.0)
CAMERA = Camera("pinhole", 96, 72, 60.0, 60.0, 47.5, 35.5)
NEW, OLD = (Factors(months=m, foliage=0.0, parked_share=0.0) for m in (0.0, 24.0))

CAR = "CAR_GLASS CAR_PAINT LAMP LIGHT_METAL NUMBER_PLATE PLASTIC RUBBER TAIL_LAMP"
EFFECTS = {
    Change.PARKED_ANEW: (CAR, CAR),
    Change.REPAINTED: ("BRICK CONCRETE PLASTER STONE", "PAINTED_WALL"),
    Change.OTHER_SHOP: ("AWNING SHOP_SIGN SHOP_WINDOW WOOD", "AWNING SHOP_SIGN SHOP_WINDOW WOOD"),
    Change.OTHER_DOOR: ("DOOR", "DOOR"),
    Change.SCAFFOLDED: ("", "METAL SHEET WOOD"),
    Change.BINS_CAME: ("", "PLASTIC RUBBER"),
    Change.BIN_MOVED: ("PLASTIC RUBBER", "PLASTIC RUBBER"),
    Change.DUG_UP: (CAR, "RUBBER SIGNAL_RED SIGNAL_WHITE SOIL"),
    Change.CONTAINER_CAME: (CAR, "CONTAINER METAL SOIL"),
    Change.RELAID: ("", "FRESH_ASPHALT"),
    Change.TRIMMED: ("BARK LEAF", ""),
    Change.FELLED: ("BARK LEAF", ""),
}
"""materials of what each change by itself takes from a street and of what it brings"""


@pytest.fixture(scope="module")
def district() -> District:
    return scenes.district(PLACE)


@pytest.fixture(scope="module")
def new(district: District) -> set[bytes]:
    """The pieces of the street as it was built, with its parked cars and few leaves."""
    return pieces(compose(district, Factors(foliage=0.1)))


@pytest.fixture(scope="module")
def came(district: District) -> Mesh:
    """Everything that has come after two years."""
    return merge(district.inventory.came(24.0))


def pieces(mesh: Mesh) -> set[bytes]:
    """The corners, names and colours of all triangles."""
    corners = mesh.vertices[mesh.triangles].reshape(len(mesh), -1).view(np.uint8).reshape(len(mesh), -1)
    looks = np.stack([mesh.instance, mesh.variant, mesh.material], axis=1).astype(np.uint32)
    return {row.tobytes() for row in np.hstack([corners, looks.view(np.uint8)])}


def materials(some: set[bytes]) -> str:
    """The names of the materials of some pieces."""
    return " ".join(sorted({Material(int.from_bytes(piece[-4:], sys.byteorder)).name for piece in some}))


@pytest.mark.thorough
def test_a_new_street_is_what_was_built_and_nothing_else(district: District) -> None:
    mesh = compose(district, Factors(parked_share=0.0))
    assert pieces(mesh) == pieces(district.static) | pieces(district.foliage)
    assert "months" not in Factors().model_dump()
    assert "months" not in synthetic.Options().recorded()
    assert synthetic.Options(months=3).recorded()["months"] == 3


@pytest.mark.thorough
@pytest.mark.parametrize(("earlier", "later"), [(0.5, 6.0), (6.0, 12.0), (12.0, 24.0)])
def test_what_has_changed_stays_changed(district: District, earlier: float, later: float) -> None:
    inventory = district.inventory
    before, after = (pieces(merge(inventory.came(m))) for m in (earlier, later))
    assert before < after
    new = pieces(district.static)
    young, old = (pieces(inventory.aged(district.static, m)) for m in (earlier, later))
    assert young - new, "nothing was repainted"
    assert old & new < young & new < new, "what was as at first later was so earlier, too"
    assert young - new <= old - new, "what was repainted is as it was painted"
    assert not np.any(inventory.parked_anew(earlier) & ~inventory.parked_anew(later))
    assert not np.any(inventory.out_of_use(earlier) & ~inventory.out_of_use(later))


@pytest.mark.thorough
@pytest.mark.parametrize("change", Change)
def test_shares_follow_their_law(district: District, change: Change) -> None:
    course = COURSES[change]
    for months in (0.0, 1.0, 6.0, 24.0):
        expected = course.limit * (1 - np.exp(-months / course.time))
        share = district.inventory.happened(change, 40_000, months).mean()
        assert share == pytest.approx(expected, abs=0.01)


@pytest.mark.thorough
@pytest.mark.parametrize("change", Change)
def test_each_change_by_itself_changes_the_street(
    district: District, new: set[bytes], change: Change, monkeypatch: pytest.MonkeyPatch
) -> None:
    for other in set(Change) - {change}:
        monkeypatch.setitem(COURSES, other, Course(0.0, 1.0))
    old = pieces(compose(district, Factors(months=24.0, foliage=0.1)))
    assert (materials(new - old), materials(old - new)) == EFFECTS[change]


@pytest.mark.thorough
def test_nothing_that_came_stands_in_a_lane(district: District, came: Mesh) -> None:
    points = came.vertices[came.triangles[came.semantic != Semantic.ROAD]].reshape(-1, 3)
    network = district.network
    for u, v in network.street:
        d, aside, length = edge_frame(network.nodes[u], network.nodes[v])
        offset = points[:, :2] - network.nodes[u]
        along, across = offset @ d, np.abs(offset @ aside)
        assert not np.any((along > 12) & (along < length - 12) & (across < LANE_M))


@pytest.mark.thorough
def test_nothing_floats(came: Mesh) -> None:
    for name in np.unique(came.instance[came.instance > 0]):
        lowest = came.vertices[came.triangles[came.instance == name], 2].min()
        assert min(abs(lowest), abs(lowest - KERB_M)) < 0.02, f"object {name} is {lowest} m above the road"


def facing(place: Array, target: Array) -> Array:
    """``T_world_cam`` of a camera at a place (3,) that looks at a target (3,)."""
    z = (target - place) / np.linalg.norm(target - place)
    x = np.cross(z, [0, 0, 1.0]) / np.linalg.norm(np.cross(z, [0, 0, 1.0]))
    T = np.eye(4)
    T[:3] = np.column_stack([x, np.cross(z, x), z, place])
    return T


def seen(factors: Factors, T_world_cam: Array) -> tuple[Array, Frame, Mask]:
    """World points (H, W, 3) of a view, its frame without colours, and the mask of its walls."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(float)
    origins, directions, lengths = scenes.pixel_rays(CAMERA, T_world_cam, pixels)
    hits = scenes.static_scene(PLACE, factors).hits(origins, directions)
    hit = np.isfinite(hits.range)
    distance = np.where(hit, hits.range, 0.0)
    shape = CAMERA.height, CAMERA.width
    depth = (distance / lengths).astype(np.float32).reshape(shape)
    blank = np.zeros((*shape, 3))
    frame = Frame(
        blank.astype(np.uint8),
        depth,
        blank.astype(np.float32),
        hits.instance.reshape(shape),
        blank[..., 0].astype(np.uint8),
    )
    walls = (hits.material == Material.PAINTED_WALL).reshape(shape)
    return (origins + distance[:, None] * directions).reshape(*shape, 3), frame, walls


@pytest.mark.thorough
def test_a_repainted_wall_is_visible_and_marked_as_changed(district: District) -> None:
    inventory, checked = district.inventory, 0
    numbers, rows = inventory._numbers
    repainted = inventory.happened(Change.REPAINTED, len(numbers), 24.0)[rows]
    for k in np.flatnonzero(repainted)[:4]:
        plot = inventory.houses[k][1]
        middle = (plot.T_world_house @ [plot.width / 2, 0, 4.0, 1])[:3]
        T_world_cam = facing((plot.T_world_house @ [plot.width / 2 + 2, -7.0, 1.8, 1])[:3], middle)
        points, frame, walls = seen(OLD, T_world_cam)
        before, earlier, _ = seen(NEW, T_world_cam)
        same = walls & (np.abs(frame.depth - earlier.depth) < 1e-4)
        if np.count_nonzero(same) < 50:
            continue
        query = View(PLACE, OLD, CAMERA, T_world_cam)
        assert query.sees(before[same]).mean() > 0.99
        changed = scenes.changed_since(PLACE, NEW, OLD, frame, CAMERA, T_world_cam)
        assert changed[same].all()
        assert not scenes.changed_since(PLACE, OLD, OLD, frame, CAMERA, T_world_cam).any()
        assert np.isfinite(points).all()
        checked += 1
    assert checked >= 2


@pytest.mark.thorough
def test_points_on_a_felled_tree_are_not_visible(district: District) -> None:
    trees, checked = district.inventory.trees, 0
    felled = district.inventory.happened(Change.FELLED, len(trees.names), 24.0)
    for k in np.flatnonzero(felled):
        foot = trees.transforms[k, :3, 3]
        T_world_cam = facing(foot + np.array([4.0, 2.0, 1.5]), foot + np.array([0, 0, 2.0]))
        before, frame, _ = seen(NEW, T_world_cam)
        of_tree = frame.instance == trees.names[k]
        if not of_tree.any():
            continue
        assert View(PLACE, NEW, CAMERA, T_world_cam).sees(before[of_tree]).mean() > 0.9
        assert not View(PLACE, OLD, CAMERA, T_world_cam).sees(before[of_tree]).any()
        _, later, _ = seen(OLD, T_world_cam)
        changed = scenes.changed_since(PLACE, NEW, OLD, later, CAMERA, T_world_cam)
        assert changed[of_tree].all()
        checked += 1
    assert checked >= 2


@pytest.mark.thorough
def test_a_scaffold_hides_the_wall_behind_it(district: District, came: Mesh) -> None:
    """The truth casts its rays into the street of each traversal."""
    numbers, rows = district.inventory._numbers
    scaffolded = district.inventory.happened(Change.SCAFFOLDED, len(numbers), 24.0)[rows]
    checked = 0
    for k in np.flatnonzero(scaffolded)[:6]:
        plot = district.inventory.houses[k][1]
        place, target = (
            (plot.T_world_house @ p)[:3] for p in ([plot.width / 2, -7.0, 1.8, 1], [plot.width / 2, 0, 4.0, 1])
        )
        points, frame, _ = seen(OLD, facing(place, target))
        on_scaffold = np.isin(frame.instance, came.instance[came.semantic == Semantic.WORKS]) & (points[..., 2] > 2)
        before, earlier, _ = seen(NEW, facing(place, target))
        behind = on_scaffold & (earlier.depth > 0) & (np.linalg.norm(before - points, axis=-1) > 0.05)
        assert not View(PLACE, OLD, CAMERA, facing(place, target)).sees(before[behind]).any()
        checked += int(np.count_nonzero(behind) > 100)
    assert checked >= 2


@pytest.mark.thorough
def test_cars_are_parked_anew_and_never_in_works(district: District) -> None:
    def parked(months: float) -> Mesh:
        mesh = compose(district, Factors(months=months, parked_share=1.0, foliage=0.0))
        return mesh.select(mesh.semantic == Semantic.PARKED_CAR)

    new, old = parked(0.0), parked(24.0)
    taken = district.inventory.out_of_use(24.0)
    assert taken.any()
    assert not np.intersect1d(new.instance, old.instance).size, "after two years every car is another one"
    centres = district.bays[taken, :3, 3]
    places = old.vertices[np.unique(old.triangles)]
    for centre, pose in zip(centres, district.bays[taken], strict=True):
        near = places[np.linalg.norm(places - centre, axis=1) < 4.0]
        local = (near - centre) @ pose[:3, :3]
        assert not np.any((np.abs(local[:, 0]) < 2.0) & (np.abs(local[:, 1]) < 1.0))


def test_months_change_all_conditions_but_the_first() -> None:
    months = [c.factors.months for c in conditions_of(("Sunny", "Rain", "Snow"), {}, None, 2, None, 6.0).values()]
    assert months == [0.0, 6.0, 6.0]
    swept = [c.factors.months for c in conditions_of((), {}, "months", 5).values()]
    assert swept == [0.0, 6.0, 12.0, 18.0, 24.0]


def test_the_season_goes_through_the_year() -> None:
    """With as many steps as there are seasons these are met; what is swept changes in between and nothing else does."""
    assert list(previewed((), everything=False, swept="season", steps=len(SEASONS))) == list(SEASONS)
    steps = sweep("season", 2 * len(SEASONS) - 1)
    swept = SEASONS["spring"].keys()
    for values, factors in zip(SEASONS.values(), steps[::2], strict=True):
        assert {key: getattr(factors, key) for key in swept} == pytest.approx(values)
    for before, between, after in zip(steps[:-2:2], steps[1::2], steps[2::2], strict=True):
        for key in swept:
            assert getattr(between, key) == pytest.approx((getattr(before, key) + getattr(after, key)) / 2)
    rest = [factors.model_dump(exclude=set(swept)) for factors in steps]
    assert all(values == rest[0] for values in rest)
    labels = list(previewed((), everything=False, swept="season", steps=3))
    assert labels == ["spring", "autumn", "winter"]


def test_months_without_effect_are_refused(tmp_path: Path) -> None:
    command, out = ("build-dataset", "synthetic"), ("--out", tmp_path / "out")
    for words in (
        ("--months", 6, "--sweep", "light"),
        ("--months", 6, "--conditions", "Sunny"),
        ("--months", 0),
        ("--months", 25),
    ):
        told = relocbench(*command, *words, *out)
        assert told.status == 2
        assert_names(told.complaint, "", None, "months")
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_workers_do_not_change_the_bytes_of_an_old_street(tmp_path: Path) -> None:
    options = synthetic.Options.model_validate({"preset": "smoke", "months": 12, "extras": ("changed",)})
    one, two = (synthetic.build([], options, tmp_path / str(n), Silent(), Run(n)) for n in (1, 2))
    assert one.fingerprint == two.fingerprint
    for path in sorted((one.root / "extras").rglob("*.png")):
        assert path.read_bytes() == (two.root / path.relative_to(one.root)).read_bytes()

"""``relocbench inspect --ground-truth``: the page, what is drawn where, and what a wrong pose looks like in numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import street_clouds
from command_line import relocbench
from refusals import refused
from simulated_graph import NO_EVIDENCE
from small_dataset import ACROSS, START_NS, STEP_NS, make_small_dataset
from typer.testing import CliRunner

from relocbench.cli.app import app
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import read_image
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.groundtruth.blocks.blocks import Block, Nodes, Surface
from relocbench.datasets.groundtruth.blocks.store import BlockStore, write_block
from relocbench.datasets.groundtruth.pairs.reasons import by_kind, common
from relocbench.datasets.groundtruth.pose_graph.files import PlacedDrive, read_graph, write_graph
from relocbench.datasets.groundtruth.registration.files import write_registrations
from relocbench.datasets.groundtruth.report.inspected import chosen_spots, inspected_sets, relative_pose
from relocbench.datasets.groundtruth.report.overlay_picture import Cloud, detail_places
from relocbench.datasets.groundtruth.report.pictures import write_ground_truth
from relocbench.datasets.groundtruth.report.residual_picture import measure_residuals
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.errors import DatasetError
from relocbench.geometry import invert, make_transform, se3_exp
from relocbench.progress import Silent

STREET = street_clouds.irregular(1)
NODES = 8
FIRST_M = 60.0
NAMES = ("summer", "winter")


def drive(k: int, shift_m: float = 0.0, trusted: bool = True) -> PlacedDrive:
    """Nodes every two metres of the street; the query's verdicts and ways as a graph would leave them."""
    x = FIRST_M + 2.0 * np.arange(NODES) + 0.3 * k
    T = make_transform(np.broadcast_to(np.eye(3), (NODES, 3, 3)), np.column_stack([x, 0 * x + 0.5 * k, 0 * x + 1.5]))
    T[:, 1, 3] += shift_m
    times = START_NS + 10**15 * k + STEP_NS * np.arange(NODES)
    ways = np.zeros((NODES, 2)) if trusted else np.full((NODES, 2), np.inf)
    verdict = "" if trusted else "overlap 12 %: of the query's walls"
    return PlacedDrive(NAMES[k], times, T, ways, dict.fromkeys(range(0, NODES, 2), verdict) if k else {})


def block(k: int, true: np.ndarray) -> Block:
    x = float(true[0, 3])
    measured = street_clouds.measure(STREET, 10 * k + round(x), x - 1.0, x + 1.0)
    T_node_street = invert(true)
    R, t = T_node_street[:3, :3], T_node_street[:3, 3]
    points, normals, origins = (
        (measured[name] @ R.T + (0 if name == "normals" else t)).astype(np.float32)
        for name in ("points", "normals", "origins")
    )
    surface = measured["surface"].astype(np.uint8)
    return Block(points, normals, origins, surface, np.ones(len(points), dtype=np.float32))


def make_field_dataset(root: Path, *, shift_m: float = 0.0, trusted: bool = True, rejected: int = 2) -> Dataset:
    """A small dataset with the products of lidar beside it; ``shift_m`` is an error of the graph to the side."""
    made = make_small_dataset(root, rejected=rejected)
    folder = root / "groundtruth"
    drives = [drive(0), drive(1, shift_m, trusted)]
    for k in (0, 1):
        for node, true in enumerate(drive(k).T_world_node):
            path = BlockStore(folder / "blocks" / NAMES[k]).path(node)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_block(path, block(k, true))
    for kind in ("graph", "registrations"):
        (folder / kind).mkdir()
    write_graph(folder / "graph" / "summer__winter.csv", *drives)
    T = invert(drive(0).T_world_node[2]) @ drive(1).T_world_node[2]
    reason = "" if trusted else "overlap 12 %: of the query's walls"
    found = [Registration(2, 2, T, np.eye(6), replace(NO_EVIDENCE), reason)]
    nodes = [Nodes(d.times_ns, d.T_world_node, d.travelled_m) for d in drives]
    write_registrations(folder / "registrations" / "summer__winter.csv", found, *nodes)
    return made


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_field_dataset(tmp_path_factory.mktemp("field") / "D")


@pytest.fixture(scope="module")
def drawn(made: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page, with one place besides the least certain one."""
    return write_ground_truth(made, made.pair_sets(), tmp_path_factory.mktemp("page"), 2, 0, Silent())


class Page(HTMLParser):
    """Pictures, links and text of a page; fails where tags are not closed in turn."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.files: list[str] = []
        self.cells: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        self.files += [value for name, value in attrs if name == "src" and value]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "td":
            self.cells.append(data)


@pytest.mark.thorough
def test_the_page_shows_every_picture_that_was_drawn(made: Dataset, drawn: Path) -> None:
    page = Page(drawn.read_text(encoding="utf-8"))
    there = sorted(str(p.relative_to(drawn.parent)) for p in drawn.parent.rglob("*.png"))
    assert sorted(page.files) == there
    # The least certain pair, the last one, and the one kind of rejection, which has no pose to draw in images.
    names = ["keyframe_01", "keyframe_02", "map", "overlay_01", "overlay_02", "overlay_03"]
    assert there == sorted([*(f"{ACROSS}/{name}.png" for name in names), "residuals.png"])
    for name in there:
        assert read_image(drawn.parent / name).std() > 10
    assert page.cells[page.cells.index("too few points agree") + 1] == "2"
    accepted = str(len(made.pair_set(ACROSS).pairs))
    at = page.cells.index(accepted)
    assert page.cells[at : at + 2] == [accepted, "2"]


@pytest.mark.thorough
def test_the_page_has_what_is_known_of_the_calibration(drawn: Path, tmp_path: Path) -> None:
    assert 'id="calibration"' not in drawn.read_text(encoding="utf-8")
    found = make_field_dataset(tmp_path / "D")
    (tmp_path / "D" / "groundtruth" / "calibration.yaml").write_text(
        "causes: [time of winter]\nrounds: 2\nlidars:\n"
        "  summer/front: {late_ms: 0.0, late_sigma_ms: 1.04, position_m: [0, 0, 0], position_sigma_m: [0.01, 0.01,\n"
        "    0.02], rotation_deg: [0, 0, 0], rotation_sigma_deg: [0.04, 0.03, 0.04], open: [position, time]}\n"
        "  winter/front: {late_ms: 50.21, late_sigma_ms: 1.17, position_m: [-0.002, 0.03, 0],\n"
        "    position_sigma_m: [0.01, 0.01, 0.02], rotation_deg: [0.14, 0.0, -0.03],\n"
        "    rotation_sigma_deg: [0.04, 0.03, 0.04]}\n"
        "blocks: {summer: blocks/summer, winter: blocks/winter}\nregistrations: {winter: registrations}\n"
    )
    text = write_ground_truth(found, found.pair_sets(), tmp_path / "page", 1, 0, Silent()).read_text(encoding="utf-8")
    page = Page(text)
    assert "In error: time of winter. The recordings were corrected 2 times." in text
    assert page.cells[page.cells.index("summer/front") :][:2] == ["summer/front", "0.0 ± 1.0"]
    assert "position, time" in page.cells
    assert "<td><b>50.2 ± 1.2</b></td><td>-0.2 ± 1.0<br><b>3.0 ± 1.0</b><br>0.0 ± 2.0</td>" in text
    assert "<td><b>0.14 ± 0.04</b><br>0.00 ± 0.03<br>-0.03 ± 0.04</td><td>–</td>" in text


@pytest.mark.thorough
def test_the_same_dataset_draws_the_same_bytes(made: Dataset, drawn: Path, tmp_path: Path) -> None:
    again = write_ground_truth(made, [made.pair_set(ACROSS)], tmp_path, 2, 0, Silent())
    files = [p for p in drawn.parent.rglob("*.*") if p.is_file()]
    assert len(files) == 8
    for path in files:
        assert path.read_bytes() == (again.parent / path.relative_to(drawn.parent)).read_bytes()


@pytest.mark.thorough
def test_residuals_are_the_noise_of_the_points_where_the_graph_is_right(made: Dataset) -> None:
    found = inspected_sets(made, [made.pair_set(ACROSS)])[0]
    measured = measure_residuals(found)
    assert measured.places == NODES // 2
    # A centimetre of noise on points and as much on the planes' points.
    assert measured.sigmas_m == pytest.approx((0.0141, 0.0141), rel=0.15)


def test_residuals_show_a_graph_that_is_wrong(tmp_path: Path) -> None:
    wrong = make_field_dataset(tmp_path / "D", shift_m=0.12)
    measured = measure_residuals(inspected_sets(wrong, [wrong.pair_set(ACROSS)])[0])
    assert min(measured.sigmas_m) > 0.03


def test_details_are_where_both_drives_see_walls_of_two_directions() -> None:
    T = make_transform(np.eye(3), np.array([FIRST_M, 0.0, 1.5]))
    ref, query = (Cloud.of(street_clouds.submap(STREET, seed, T), np.eye(4)) for seed in (1, 2))
    # A tree in front, whose points face anywhere.
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(400, 3)) * (1, 1, 0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tree = rng.uniform([-1, 5, 0], [1, 7, 4], size=(400, 3))
    ref, query = (
        Cloud(
            np.concatenate([cloud.points, tree]),
            np.concatenate([cloud.normals, normals]),
            np.concatenate([cloud.surface, np.full(400, Surface.STRUCTURE, dtype=np.uint8)]),
        )
        for cloud in (ref, query)
    )
    places = detail_places(ref, query, np.zeros(2))
    assert len(places) == 2
    assert np.linalg.norm(places[0] - places[1]) > 3.0
    ends = np.concatenate([STREET.starts[0], STREET.starts[1]]) - FIRST_M
    for place in places:
        assert np.min(np.abs(ends - place[0])) < 0.8
        assert 8.0 < abs(place[1]) < 14.0
    street = street_clouds.irregular(1, deepest=0.0)
    ref, query = (Cloud.of(street_clouds.submap(street, k, T), np.eye(4)) for k in (1, 2))
    assert detail_places(ref, query, np.zeros(2)) == []


@pytest.mark.thorough
def test_a_pair_that_the_graph_does_not_tie_is_shown_by_what_was_refused(tmp_path: Path) -> None:
    lost = make_field_dataset(tmp_path / "D", trusted=False)
    found = inspected_sets(lost, [lost.pair_set(ACROSS)])[0]
    times = found.reference.times_ns, found.query.times_ns
    near = relative_pose(found, Pair(int(times[0][3]), int(times[1][3]), None, accepted=False, reason="not registered"))
    assert (near.ref, near.query) == (2, 2)
    assert near.T_ref_query is not None
    assert "overlap 12 %" in near.source
    far = relative_pose(found, Pair(int(times[0][7]), int(times[1][7]), None, accepted=False, reason="not registered"))
    assert (far.ref, far.query, far.T_ref_query) == (7, 7, None)
    page = write_ground_truth(lost, [lost.pair_set(ACROSS)], tmp_path / "page", 1, 0, Silent())
    assert "overlap 12 %: of the query&#x27;s walls" in page.read_text(encoding="utf-8")


def test_places_are_the_least_certain_some_evenly_and_one_of_each_rejection() -> None:
    good = [Pair(k, k, np.eye(4), sigma_translation_m=0.01 + 0.001 * (k == 5)) for k in range(9)]
    bad = [Pair(k, k, None, accepted=False, reason=f"no keyframe within 5 m: nearest {k} m") for k in range(20, 25)]
    odd = [Pair(30, 30, None, accepted=False, reason="no odometry at the time of the query")]
    spots = chosen_spots([*good, *odd, *bad], 3)
    assert [s.pair.query_timestamp_ns for s in spots] == [5, 0, 4, 8, 22, 30]
    assert spots[4].why == "one of 5 rejected: no keyframe within 5 m: nearest … m"


def test_reasons_that_differ_by_numbers_alone_are_one_kind() -> None:
    found = by_kind(["sigma 0.07 m exceeds 0.05 m", "lost", "sigma 0.1 m exceeds 0.05 m"])
    assert {kind: len(same) for kind, same in found.items()} == {"sigma … m exceeds … m": 2, "lost": 1}
    assert common(found["sigma … m exceeds … m"]) == "sigma … m exceeds 0.05 m"


def test_a_graph_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "g.csv"
    odd = replace(drive(1), T_world_node=drive(1).T_world_node @ se3_exp(np.array([0.1, 0.2, 0.3, 0.4, -0.2, 0.9])))
    write_graph(path, drive(0), odd)
    ref, query = read_graph(path, *NAMES)
    np.testing.assert_allclose(query.T_world_node, odd.T_world_node, atol=1e-12)
    np.testing.assert_array_equal(ref.times_ns, drive(0).times_ns)
    assert query.verdicts == odd.verdicts
    assert not ref.verdicts
    lines = path.read_text().splitlines()
    lines[3] = lines[3].replace("summer,2", "summer,7")
    path.write_text("\n".join(lines))
    with refused(DatasetError, "g.csv", 4, "node", 7, 2):
        read_graph(path, *NAMES)


@pytest.mark.thorough
def test_the_command_writes_the_page_and_leaves_json_as_it_is(made: Dataset, tmp_path: Path) -> None:
    runner = CliRunner()
    options = ["--ground-truth", str(tmp_path / "page"), "--pairs", "1", "-q"]
    told = runner.invoke(app, ["inspect", str(made.root), *options])
    assert told.exit_code == 0
    assert "index.html" in told.stdout
    assert (tmp_path / "page" / "index.html").exists()
    plain = runner.invoke(app, ["inspect", str(made.root), "--json"])
    both = runner.invoke(app, ["inspect", str(made.root), "--json", *options])
    one, other = json.loads(both.stdout), json.loads(plain.stdout)
    assert one.pop("ground_truth") == str(tmp_path / "page" / "index.html")
    assert (other.pop("ground_truth"), one["counts"].pop("pages"), other["counts"].pop("pages")) == (None, 1, 0)
    assert one == other


def test_a_dataset_without_lidar_is_refused_in_one_line(tmp_path: Path) -> None:
    bare = make_small_dataset(tmp_path / "D")
    with refused(DatasetError, bare.root):
        inspected_sets(bare, bare.pair_sets())
    found = relocbench("inspect", bare.root, "--ground-truth", tmp_path / "page", "-q")
    assert found.status == 2
    assert str(bare.root) in found.complaint
    assert not (tmp_path / "page").exists()

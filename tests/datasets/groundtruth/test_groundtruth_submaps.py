"""Blocks and sliding submaps: exact surfaces, free space, gaps, standing still, determinism and the cost of a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import pytest
from lidar_street import RIG_HEIGHT_M, START_NS, WALL_M, Box, Street, StreetLidar, drive_street
from numpy.typing import NDArray
from refusals import Notes, assert_names, refused

from relocbench.arrays import Array, Floats, Indices
from relocbench.datasets.groundtruth.blocks import store as store_module
from relocbench.datasets.groundtruth.blocks.blocks import Block, Nodes, Surface
from relocbench.datasets.groundtruth.blocks.deskewing import BeamReader
from relocbench.datasets.groundtruth.blocks.making import BlockOptions, make_blocks, reader_of, wheel_height
from relocbench.datasets.groundtruth.blocks.nodes import arc_length_along, make_nodes
from relocbench.datasets.groundtruth.blocks.store import BlockStore, build_blocks, read_block, write_block
from relocbench.datasets.groundtruth.blocks.surfaces import smallest_eigenvector
from relocbench.datasets.groundtruth.submaps.submaps import Submap, SubmapWindow
from relocbench.datasets.groundtruth.voxels.claims import VoxelClaims
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels, thin
from relocbench.datasets.groundtruth.voxels.voxels import voxel_keys
from relocbench.datasets.sensors.derived_lidar import DerivedLidar
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream, Scan, Trajectory
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.geometry import apply, invert, make_transform, se3_exp, so3_exp

_COARSE_M = 0.33
"""no surface of the street lies between two such voxels"""


def blocks_of(recording: FieldRecording, nodes: Nodes, wanted: range | None = None) -> dict[int, Block]:
    arc_length, options = arc_length_along(recording), BlockOptions()
    height = wheel_height(recording, arc_length, nodes, options)
    return dict(
        make_blocks(reader_of(recording, arc_length, options), nodes, wanted or range(len(nodes)), height, options)
    )


def in_street(block: Block, nodes: Nodes, node: int) -> tuple[Array, Array]:
    """Points and normals (N, 3) in the street's frame."""
    T = nodes.T_odom_node[node]
    return apply(T, block.points.astype(np.float64)), block.normals @ T[:3, :3].T


def same(a: Block | Submap, b: Block | Submap) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))


@pytest.fixture(scope="module")
def street() -> FieldRecording:
    return drive_street(Street())


@pytest.fixture(scope="module")
def built(street: FieldRecording, tmp_path_factory: pytest.TempPathFactory) -> tuple[Nodes, BlockStore]:
    nodes = make_nodes(street)
    return nodes, build_blocks(street, nodes, tmp_path_factory.mktemp("blocks"))


# --- nodes


def test_nodes_lie_at_equal_arc_lengths(street: FieldRecording) -> None:
    nodes = make_nodes(street, 2.0)
    assert len(nodes) == 19  # 40 m, less what the lidars do not cover at both ends
    np.testing.assert_allclose(np.diff(nodes.travelled_m), 2.0, atol=1e-9)
    x = nodes.T_odom_node[:, 0, 3]
    np.testing.assert_allclose(np.diff(x), 2.0, atol=2e-3)  # the street's middle is not quite straight
    begin, end = nodes.begins_and_ends()
    assert np.array_equal(begin[1:], end[:-1])
    assert np.all((begin < nodes.times_ns) & (nodes.times_ns < end))


@pytest.mark.thorough
def test_standing_still_makes_no_nodes_and_reads_no_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though odometry wobbles by 2 mm."""
    going = drive_street(Street(wobble=0.002))
    stopping = drive_street(Street(wobble=0.002, stop_s=120.0))
    through, stopped = make_nodes(going), make_nodes(stopping)
    assert len(through) == len(stopped)
    np.testing.assert_allclose(stopped.T_odom_node[:, 0, 3], through.T_odom_node[:, 0, 3], atol=0.3)
    read: list[int] = []
    scan_of = StreetLidar.read

    def counted(lidar: StreetLidar, index: int) -> Scan:
        read.append(index)
        return scan_of(lidar, index)

    monkeypatch.setattr(StreetLidar, "read", counted)
    reads = []
    for recording, nodes in ((going, through), (stopping, stopped)):
        reader = BeamReader(recording, arc_length_along(recording), 1.0, 60.0, 0.02)
        for k in range(len(nodes)):
            begin, end = nodes.begins_and_ends()
            reader.between(int(begin[k]), int(end[k]), nodes.T_odom_node[k])
        reads.append(len(read))
        read.clear()
    assert reads[1] <= reads[0] + 40  # 12,000 scans were taken while the car stood
    assert reads[0] <= sum(len(lidar.times_ns) for lidar in going.lidars)  # none was read twice


def test_gap_of_the_odometry_parts_the_drive() -> None:
    recording = drive_street(Street(gap_s=1.0))
    nodes = make_nodes(recording)
    segments = nodes.segments()
    assert set(segments.tolist()) == {0, 1}
    begin, end = nodes.begins_and_ends()
    for k in range(len(nodes)):
        inside = begin[k] + (end[k] - begin[k]) * np.arange(51) // 50
        assert recording.odometry.covers(inside).all()
    last, first = np.flatnonzero(segments == 0)[-1], np.flatnonzero(segments == 1)[0]
    assert begin[first] - end[last] >= 1_000_000_000
    assert np.all(np.diff(nodes.travelled_m) > 0)


def test_break_of_the_odometry_parts_the_drive(street: FieldRecording) -> None:
    broken = replace(street, odometry=replace(street.odometry, breaks=(80,)))
    nodes = make_nodes(broken)
    begin, end = nodes.begins_and_ends()
    before, after = street.odometry.times_ns[[79, 80]]
    assert len(set(nodes.segments().tolist())) == 2
    assert not np.any((begin < after) & (end > before))


@pytest.mark.thorough
def test_submap_stays_within_its_segment(tmp_path: Path) -> None:
    recording = drive_street(Street(gap_s=1.0, period_ns=60_000_000))
    nodes = make_nodes(recording)
    window = SubmapWindow(nodes, build_blocks(recording, nodes, tmp_path))
    first = int(np.flatnonzero(nodes.segments() == 1)[0])
    assert window.at(first).block.min() == first
    assert window.at(first - 1).block.max() == first - 1


def test_drive_without_way_or_lidar_is_refused(street: FieldRecording) -> None:
    standing = Trajectory(street.odometry.times_ns, np.repeat(street.odometry.T_odom_rig[:1], 161, axis=0))
    with refused(DatasetError, street.folder, None, "2.0 m"):
        make_nodes(replace(street, odometry=standing))
    with refused(DatasetError, street.folder, None, "lidar scans"):
        make_nodes(replace(street, lidars=()))
    late = Trajectory(street.odometry.times_ns + 10**12, street.odometry.T_odom_rig)
    with refused(DatasetError, street.folder, None, "odometry"):
        make_nodes(replace(street, odometry=late))
    with refused(ConfigError, "", None, "0.0 m"):
        make_nodes(street, 0.0)


# --- beams


@pytest.mark.thorough
def test_each_beam_is_placed_by_its_own_time(street: FieldRecording) -> None:
    rng = np.random.default_rng(0)
    rotation = so3_exp(np.cumsum(0.05 * rng.normal(size=(161, 3)), axis=0))
    turned = make_transform(rotation, street.odometry.T_odom_rig[:, :3, 3])
    rough = replace(street, odometry=Trajectory(street.odometry.times_ns, turned))
    begin, end = START_NS + 1_000_000_000, START_NS + 1_300_000_000
    T_odom_node = se3_exp(rng.normal(size=6))
    beams = BeamReader(rough, arc_length_along(rough), 1.0, 60.0, 1e-9).between(begin, end, T_odom_node)
    points, origins = [], []
    for lidar in rough.lidars:
        for index in range(len(lidar.times_ns)):
            scan = lidar.read(index)
            far = np.linalg.norm(scan.points, axis=1) >= 1.0
            use = (scan.times_ns >= begin) & (scan.times_ns < end) & far
            T = invert(T_odom_node) @ rough.odometry.at(scan.times_ns[use]) @ lidar.T_rig_lidar
            points.append(apply(T, scan.points[use][:, None])[:, 0])
            origins.append(T[:, :3, 3])
    np.testing.assert_allclose(beams.points, np.concatenate(points), atol=1e-8)
    np.testing.assert_allclose(beams.origins, np.concatenate(origins), atol=1e-8)


# --- thinning


def test_thinning_keeps_one_measured_point_a_voxel_near_its_mean() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, size=(5000, 3))
    keep = thin(points, 0.25)
    keys = voxel_keys(points, 0.25)
    assert sorted(keys[keep]) == sorted(set(keys.tolist()))
    for row in keep[:50]:
        mates = points[keys == keys[row]]
        distance = np.linalg.norm(mates - mates.mean(axis=0), axis=1)
        assert np.linalg.norm(points[row] - mates.mean(axis=0)) <= distance.min() + 1e-5


def test_thinning_again_changes_nothing() -> None:
    points = np.random.default_rng(1).normal(size=(5000, 3))
    once = points[thin(points, 0.2)]
    np.testing.assert_array_equal(once[thin(once, 0.2)], once)


def test_thinning_does_not_depend_on_the_order_of_points() -> None:
    rng = np.random.default_rng(2)
    points = np.concatenate([rng.normal(size=(4000, 3)), np.full((3, 3), 0.05)])
    # two points at equal distances from their mean
    points = np.concatenate([points, [[9.01, 9.02, 9.03], [9.03, 9.02, 9.01]]])
    first = points[thin(points, 0.3)]
    for _ in range(5):
        mixed = points[rng.permutation(len(points))]
        np.testing.assert_array_equal(mixed[thin(mixed, 0.3)], first)


def test_thinned_drives_in_opposite_directions_do_not_lie_apart() -> None:
    """A wall across the road, 6 mm of noise, two points a voxel. Which of the two is met first depends on the way that
    one drives, and so does on which side of the wall it lies; a draw does not."""
    rng = np.random.default_rng(3)
    cells = np.stack(np.meshgrid(np.arange(60), np.arange(60), indexing="ij"), -1).reshape(-1, 2)
    yz = np.repeat(cells, 2, axis=0) + rng.uniform(0.1, 0.9, size=(2 * len(cells), 2))
    wall = np.column_stack([10.05 + 0.006 * rng.normal(size=len(yz)), 0.1 * yz])
    T_back = make_transform(so3_exp([0.0, 0.0, np.pi]), [20.1, 0.0, 0.0])

    def apart(thinned: Callable[[Array, float], NDArray[np.integer]]) -> float:
        """By how much the walls of both drives differ along the road, in the frame of the first."""
        walls = []
        for T in (np.eye(4), T_back):
            points = apply(T, wall)
            points = points[np.argsort(points[:, 0])]
            walls.append(float(apply(invert(T), points[thinned(points, 0.1)])[:, 0].mean()))
        return abs(walls[0] - walls[1])

    assert apart(first_in_voxels) > 0.004
    assert apart(thin) < 0.0005


def test_thinning_nothing_gives_nothing() -> None:
    assert len(thin(np.zeros((0, 3)), 0.1)) == 0


# --- surfaces


def test_smallest_eigenvector_agrees_with_lapack() -> None:
    rng = np.random.default_rng(3)
    for scale in (1.0, 1e-3, 1e3):
        for _ in range(100):
            a = scale * rng.normal(size=(3, 3))
            m = a @ a.T
            low, middle, high, *vector = smallest_eigenvector((m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]))
            values, vectors = np.linalg.eigh(m)
            np.testing.assert_allclose([low, middle, high], values, rtol=1e-9, atol=1e-12 * values[2])
            assert abs(np.dot(vector, vectors[:, 0])) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.thorough
def test_planes_of_the_street_are_exact(street: FieldRecording, built: tuple[Nodes, BlockStore]) -> None:
    nodes, store = built
    judged = 0
    for k in range(2, len(nodes) - 2):
        block = store.get(k)
        points, normals = in_street(block, nodes, k)
        wall = np.abs(np.abs(points[:, 1]) - WALL_M) < 1e-3
        road = np.abs(points[:, 2]) < 1e-3
        assert np.all(wall | road)  # float32 and the interpolation of poses are all that errs
        inner = ~(wall & (points[:, 2] < 0.9)) & ~(road & (np.abs(points[:, 1]) > WALL_M - 0.9))
        assert np.all(block.surface[inner & wall] == Surface.STRUCTURE)
        assert np.all(block.surface[inner & road] == Surface.GROUND)
        np.testing.assert_allclose(normals[inner & road] @ [0.0, 0.0, 1.0], 1.0, atol=1e-5)
        inward = -np.sign(points[inner & wall, 1])
        np.testing.assert_allclose(normals[inner & wall, 1] * inward, 1.0, atol=1e-5)
        judged += int(inner.sum())
    assert judged > 20_000


@pytest.mark.thorough
def test_height_of_the_road_under_the_rig_is_found(street: FieldRecording, built: tuple[Nodes, BlockStore]) -> None:
    nodes, _ = built
    found = wheel_height(street, arc_length_along(street), nodes, BlockOptions())
    assert found == pytest.approx(-RIG_HEIGHT_M, abs=2e-3)


@pytest.mark.thorough
def test_normals_have_no_seam_at_the_borders_of_blocks() -> None:
    recording = drive_street(Street(length_m=30.0, sigma=0.01))
    nodes = make_nodes(recording)
    blocks = blocks_of(recording, nodes)
    wrong, edge = [], []
    for k in range(3, len(nodes) - 3):
        points, normals = in_street(blocks[k], nodes, k)
        wall = (np.abs(np.abs(points[:, 1]) - WALL_M) < 0.05) & (points[:, 2] > 1.0)
        wrong.append(np.degrees(np.arccos(np.clip(np.abs(normals[wall, 1]), 0, 1))))
        along = blocks[k].points[wall, 0]
        edge.append((along < along.min() + 0.2) | (along > along.max() - 0.2))
    tilt, at_border = np.concatenate(wrong), np.concatenate(edge)
    assert at_border.sum() > 500
    assert np.median(tilt[at_border]) < 1.2 * np.median(tilt[~at_border])


# --- free space


def box_points(recording: FieldRecording, box: Box) -> tuple[Floats, Floats]:
    """Steadiness of points between the walls on the box's side, and of all others."""
    nodes = make_nodes(recording)
    on, off = [], []
    for k, block in blocks_of(recording, nodes).items():
        points, _ = in_street(block, nodes, k)
        mine = (points[:, 1] > box.low[1] - 0.1) & (points[:, 1] < box.high[1] + 0.1) & (points[:, 2] > 0.1)
        mine &= points[:, 2] < box.high[2] + 0.1
        on.append(block.steady[mine])
        off.append(block.steady[~mine])
    return np.concatenate(on), np.concatenate(off)


@pytest.mark.thorough
@pytest.mark.parametrize("speed", [-8.0, 10.0])
def test_what_drove_on_is_unsteady_and_all_else_steady(speed: float) -> None:
    box = Box(20.0, speed) if speed < 0 else Box(-10.0, speed)
    moved, rest = box_points(drive_street(Street(boxes=(box,), sigma=0.01)), box)
    assert len(moved) > 100
    assert np.mean(moved < 0.3) > 0.8
    assert np.mean(rest > 0.9) > 0.999


@pytest.mark.thorough
def test_parked_box_is_steady() -> None:
    box = Box(20.0)
    parked, rest = box_points(drive_street(Street(boxes=(box,), sigma=0.01)), box)
    assert len(parked) > 300
    assert np.mean(parked > 0.5) > 0.98
    assert np.mean(rest > 0.9) > 0.999


@pytest.mark.thorough
def test_one_lidar_across_the_road_cannot_tell_what_moved() -> None:
    box = Box(20.0, -8.0)
    moved, _ = box_points(drive_street(Street(boxes=(box,), lidars=(1.5,))), box)
    assert len(moved) > 30
    assert np.mean(moved < 0.3) < 0.2  # said in the module: it sees each place once


# --- building


@pytest.mark.thorough
def test_block_does_not_depend_on_those_made_with_it(street: FieldRecording, built: tuple[Nodes, BlockStore]) -> None:
    nodes, store = built
    alone = blocks_of(street, nodes, range(7, 8))
    assert same(alone[7], store.get(7))


@pytest.mark.thorough
def test_workers_and_resumption_give_the_same_bytes(street: FieldRecording, tmp_path: Path) -> None:
    longer = drive_street(Street(length_m=72.0, period_ns=60_000_000))
    nodes = make_nodes(longer)  # two units
    one, two = tmp_path / "one", tmp_path / "two"
    build_blocks(longer, nodes, one, Run(1))
    build_blocks(longer, nodes, two, Run(2))
    files = sorted(p.name for p in one.iterdir())
    assert files == sorted(p.name for p in two.iterdir())
    assert len(files) == len(nodes) + 1
    expected = {name: (one / name).read_bytes() for name in files}
    assert expected == {name: (two / name).read_bytes() for name in files}

    (two / "000003.npz").unlink()
    (two / "000030.npz").write_bytes(expected["000030.npz"][:1000])
    (two / "000034.npz").write_bytes(expected["000034.npz"][:-30])
    (two / ".000003.0badf00d.part.npz").write_bytes(b"half")
    untouched = (two / "000004.npz").stat().st_mtime_ns
    build_blocks(longer, nodes, two, Run(1))
    assert expected == {name: (two / name).read_bytes() for name in sorted(p.name for p in two.iterdir())}
    assert (two / "000004.npz").stat().st_mtime_ns == untouched


@pytest.mark.thorough
def test_blocks_made_otherwise_are_not_mixed(street: FieldRecording, tmp_path: Path) -> None:
    nodes = make_nodes(street)
    build_blocks(street, nodes, tmp_path)
    with refused(DatasetError, "blocks.yaml", None, "drive", "options"):
        build_blocks(street, nodes, tmp_path, options=BlockOptions(voxel_m=0.2))
    with refused(DatasetError, "blocks.yaml", None, "drive", "options"):
        build_blocks(street, make_nodes(street, 3.0), tmp_path)


@pytest.mark.thorough
def test_empty_scans_make_empty_blocks(tmp_path: Path) -> None:
    recording = drive_street(Street(blind=True))
    nodes = make_nodes(recording)
    store = build_blocks(recording, nodes, tmp_path)
    assert all(len(store.get(k)) == 0 for k in range(len(nodes)))
    assert len(SubmapWindow(nodes, store).at(5)) == 0


@dataclass(frozen=True, eq=False)
class _Hiccup(DerivedLidar):
    """A lidar whose driver sends one scan again in place of the next."""

    index: int

    def read(self, index: int) -> Scan:
        scan = self.stream.read(index)
        return Scan(self.stream.read(index - 1).points, scan.times_ns) if index == self.index else scan


def test_scan_that_repeats_the_one_before_is_left_out(tmp_path: Path) -> None:
    street = drive_street(Street(length_m=10.0))
    one = street.lidars[0]
    assert isinstance(one, StreetLidar)
    lidars: tuple[LidarStream, ...] = (replace(one, times=np.delete(one.times, 40)), _Hiccup(one, 40))
    said, stores = Notes(), []
    for number, lidar in enumerate(lidars):
        recording = replace(street, lidars=(lidar,))
        stores.append(build_blocks(recording, make_nodes(recording), tmp_path / str(number), reporter=said))
    assert all(same(stores[0].get(k), stores[1].get(k)) for k in range(4))
    (note,) = said.notes
    assert_names(note, "", None, street.name, one.name, 1, int(one.times[40]))


def test_damaged_block_is_named(built: tuple[Nodes, BlockStore], tmp_path: Path) -> None:
    _, store = built
    path = tmp_path / "000000.npz"
    write_block(path, store.get(4))
    assert same(read_block(path), store.get(4))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with refused(DatasetError, "000000.npz", None, "complete"):
        BlockStore(tmp_path).get(0)
    with refused(DatasetError, "000001.npz", None, "missing"):
        BlockStore(tmp_path).get(1)


# --- submaps


def test_claims_are_those_of_all_blocks_at_once() -> None:
    rng = np.random.default_rng(5)
    claims = VoxelClaims()
    inside: dict[int, tuple[Indices, Floats]] = {}
    for turn in range(120):
        if inside and rng.random() < 0.45:
            gone = list(inside)[int(rng.integers(len(inside)))]
            del inside[gone]
            claims.leave(gone)
        else:
            keys = rng.integers(0, 2000, size=int(rng.integers(0, 900)))
            ranks = rng.integers(0, 6, size=len(keys)).astype(np.float32)
            inside[turn] = keys, ranks
            claims.enter(turn, keys, ranks)
        best: dict[int, tuple[float, int]] = {}
        for block, (keys, ranks) in inside.items():
            for key, rank in zip(keys.tolist(), ranks.tolist(), strict=True):
                best[key] = min(best.get(key, (np.inf, 0)), (rank, block))
        for block, (keys, _) in inside.items():
            assert claims.winning(block).tolist() == [best[key][1] == block for key in keys.tolist()]


@pytest.mark.parametrize("voxel_m", [0.0, 0.1, 0.5])
def test_sliding_gives_what_starting_afresh_gives(built: tuple[Nodes, BlockStore], voxel_m: float) -> None:
    nodes, store = built
    window = SubmapWindow(nodes, store, 8.0, voxel_m=voxel_m)
    for node in [*range(len(nodes)), 5, 4, 12, 0]:
        afresh = SubmapWindow(nodes, store, 8.0, voxel_m=voxel_m).at(node)
        assert same(window.at(node), afresh)
        assert len(afresh) > 1000


def test_submap_is_its_blocks_in_the_frame_of_the_node(built: tuple[Nodes, BlockStore]) -> None:
    nodes, store = built
    submap = SubmapWindow(nodes, store, 8.0, voxel_m=0.0).at(9)
    assert (submap.block.min(), submap.block.max()) == (5, 13)
    for k in range(5, 14):
        T_node_block = invert(nodes.T_odom_node[9]) @ nodes.T_odom_node[k]
        mine, block = submap.block == k, store.get(k)
        np.testing.assert_allclose(submap.points[mine], apply(T_node_block, block.points.astype(float)), atol=1e-5)
        np.testing.assert_allclose(submap.origins[mine], apply(T_node_block, block.origins.astype(float)), atol=1e-5)
        np.testing.assert_allclose(submap.normals[mine], block.normals @ T_node_block[:3, :3].T, atol=1e-5)
        np.testing.assert_array_equal(submap.surface[mine], block.surface)


def test_submap_keeps_the_nearest_view_of_each_voxel(built: tuple[Nodes, BlockStore]) -> None:
    nodes, store = built
    everything = SubmapWindow(nodes, store, 8.0, voxel_m=0.0).at(9)
    thinned = SubmapWindow(nodes, store, 8.0, voxel_m=_COARSE_M).at(9)
    assert len(thinned) < 0.9 * len(everything)
    T_odom_node = nodes.T_odom_node[9]
    nearest: dict[int, float] = {}
    for key, reach in zip(_keys(everything, T_odom_node), _ranges(everything), strict=True):
        nearest[key] = min(nearest.get(key, np.inf), reach)
    keys = _keys(thinned, T_odom_node)
    # Points within rounding of a voxel's side may count to either.
    missing = set(nearest) - set(keys)
    assert len(missing) < 0.002 * len(nearest)
    best: dict[int, float] = {}
    for key, reach in zip(keys, _ranges(thinned), strict=True):
        best[key] = min(best.get(key, np.inf), reach)
    assert np.mean([abs(best[key] - nearest[key]) < 1e-4 for key in best]) > 0.998


def _keys(submap: Submap, T_odom_node: Array) -> list[int]:
    return list(voxel_keys(apply(T_odom_node, submap.points.astype(np.float64)), _COARSE_M).tolist())


def _ranges(submap: Submap) -> list[float]:
    return list(np.linalg.norm(submap.points - submap.origins, axis=1).tolist())


def test_better_poses_lay_the_blocks_elsewhere(built: tuple[Nodes, BlockStore]) -> None:
    nodes, store = built
    bent = nodes.T_odom_node.copy()
    bent[:, 2, 3] += 0.01 * np.arange(len(nodes))
    submap = SubmapWindow(replace(nodes, T_odom_node=bent), store, 8.0, voxel_m=0.0).at(9)
    plain = SubmapWindow(nodes, store, 8.0, voxel_m=0.0).at(9)
    np.testing.assert_allclose(submap.points[:, 2] - plain.points[:, 2], 0.01 * (submap.block - 9.0), atol=1e-4)


def count_reads(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The block files that are read from now on."""
    read: list[Path] = []

    def counted(path: Path) -> Block:
        read.append(path)
        return read_block(path)

    monkeypatch.setattr(store_module, "read_block", counted)
    return read


def count_claims(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """(points, claims) of each block that enters or leaves a submap from now on."""
    moved: list[tuple[int, int]] = []
    sizes: dict[int, tuple[int, int]] = {}
    enter, leave = VoxelClaims.enter, VoxelClaims.leave

    def counted_enter(claims: VoxelClaims, block: int, keys: Indices, ranks: Floats) -> None:
        sizes[block] = len(keys), len(np.unique(keys))
        moved.append(sizes[block])
        enter(claims, block, keys, ranks)

    def counted_leave(claims: VoxelClaims, block: int) -> None:
        moved.append(sizes.pop(block))
        leave(claims, block)

    monkeypatch.setattr(VoxelClaims, "enter", counted_enter)
    monkeypatch.setattr(VoxelClaims, "leave", counted_leave)
    return moved


@pytest.mark.thorough
def test_step_costs_the_same_however_long_the_drive(
    built: tuple[Nodes, BlockStore], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Work is counted, not timed: points that enter or leave, claims on voxels, and files that are read."""
    # A drive of 60 blocks out of copies of one block each 2 m; a submap has 31.
    store = BlockStore(tmp_path / "long")
    block, count = built[1].get(9), 60
    poses = np.repeat(np.eye(4)[None], count, axis=0)
    poses[:, 0, 3] = 2.0 * np.arange(count)
    for k in range(count):
        write_block(store.path(k), block)
    drive = Nodes(START_NS + np.arange(count) * 10**9, poses, 2.0 * np.arange(count, dtype=float))
    window = SubmapWindow(drive, store)
    read, moved = count_reads(monkeypatch), count_claims(monkeypatch)
    work, claims = [], []
    for node in range(count):
        submap = window.at(node)
        work.append(sum(points for points, _ in moved))
        claims.append(sum(changed for _, changed in moved))
        assert node == 0 or len(read) <= 1
        moved.clear()
        read.clear()
        assert len(submap) <= 31 * len(block)
    assert set(work[20:40]) == {2 * len(block)}  # one block enters, one leaves
    assert max(claims[20:40]) <= 2 * len(block)


def test_store_keeps_the_last_blocks_used(built: tuple[Nodes, BlockStore], monkeypatch: pytest.MonkeyPatch) -> None:
    _, whole = built
    store, read = BlockStore(whole.folder, capacity=2), count_reads(monkeypatch)
    for node in (0, 1, 0, 2, 0, 1):
        store.get(node)
    assert len(read) == 4  # 1 was dropped for 2


def test_node_that_is_not_there_is_refused(built: tuple[Nodes, BlockStore]) -> None:
    nodes, store = built
    with pytest.raises(IndexError, match="99"):
        SubmapWindow(nodes, store).at(99)

"""Where a query is, seen from any keyframe: by pairs and the reference traversal's poses alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_radii import write_radii
from pipelines_for_tests import truth
from refusals import refused
from small_dataset import ACROSS, CAMERA, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import PredictionError
from relocbench.evaluation.relocalization.basin import Basins, given_basin, read_basins
from relocbench.evaluation.relocalization.truth import MapTruth, distance_and_angle, inside


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=6, size=(32, 24))


def truth_of(dataset: Dataset) -> MapTruth:
    pair_set = dataset.pair_set(ACROSS)
    queries = sorted({p.query_timestamp_ns for p in pair_set.pairs})
    return MapTruth(dataset, pair_set, queries, dataset.traversal("summer").keyframe_timestamps(CAMERA))


def test_every_keyframe_of_a_posed_traversal_can_be_judged(dataset: Dataset) -> None:
    known = truth_of(dataset)
    for query in range(6):
        expected = np.stack([truth(ref, query) for ref in range(6)])
        assert known.relative(query) == pytest.approx(expected, abs=1e-9)
    pair = dataset.pair_set(ACROSS).pairs[0]
    assert pair.T_query_ref is not None
    assert np.array_equal(known.relative(0)[0], pair.T_query_ref)  # a pair's own pose as it stands
    assert known.spread == pytest.approx(np.zeros(5), abs=1e-9)
    assert known.reach == pytest.approx((np.hypot(0.12, 0.15), 2.0))


def test_the_pairs_decide_not_the_poses_of_the_query_traversal(tmp_path: Path) -> None:
    fault = np.eye(4)
    fault[:3, 3] = 30.0, 0.0, 1.0
    made = make_small_dataset(tmp_path / "d", frames=4, size=(32, 24), pose_fault=fault)
    known = truth_of(made)
    for query in range(4):
        assert known.relative(query) == pytest.approx(np.stack([fault @ truth(r, query) for r in range(4)]), abs=1e-9)


def test_without_poses_only_paired_keyframes_can_be_judged(tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "d", frames=5, size=(32, 24))
    poses = made.layout.traversal("summer").poses
    lines = poses.read_text().splitlines(keepends=True)
    poses.write_text(lines[0])
    known = truth_of(Dataset(made.root))
    for query in range(5):
        judged = np.flatnonzero(np.isfinite(known.relative(query)).all(axis=(1, 2))).tolist()
        assert judged == ([0] if query == 0 else [query - 1, query])
    assert known.spread.size == 0
    poses.write_text("".join(lines[:3]))  # of keyframes 0 and 1: whoever is paired with one of them sees both
    known = truth_of(Dataset(made.root))
    all_judged = [np.flatnonzero(np.isfinite(known.relative(q)).all(axis=(1, 2))).tolist() for q in range(5)]
    assert all_judged == [[0, 1], [0, 1], [0, 1, 2], [2, 3], [3, 4]]


def test_pairs_that_disagree_are_told(tmp_path: Path) -> None:
    """The drive's own poses stretch: its keyframes are 0.2 m apart by them, and 0.15 m by the pairs."""
    made = make_small_dataset(tmp_path / "d", frames=4, size=(32, 24))
    poses = made.layout.traversal("summer").poses
    head, *rows = poses.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    for index, cell in enumerate(cells):
        cell[3] = repr(0.2 * index)
    poses.write_text("\n".join([head, *map(",".join, cells)]) + "\n")
    known = truth_of(Dataset(made.root))
    assert known.spread == pytest.approx(np.full(3, 0.05), abs=1e-9)
    # Query 2 is paired with keyframes 1 and 2. Keyframe 3 is seen through 2, keyframe 0 through 1.
    forward, T_query_ref = np.eye(4), known.relative(2)
    forward[2, 3] = 0.2
    assert T_query_ref[3] == pytest.approx(truth(2, 2) @ forward, abs=1e-9)
    assert T_query_ref[0] == pytest.approx(truth(1, 2) @ np.linalg.inv(forward), abs=1e-9)
    assert T_query_ref[1] == pytest.approx(truth(1, 2), abs=1e-9)


def test_the_oracle_takes_the_nearest_that_look_the_same_way(dataset: Dataset) -> None:
    known = truth_of(dataset)
    assert known.oracle(3, 3)[0] == 3
    assert set(known.oracle(3, 3)) == {2, 3, 4}
    assert known.oracle(0, 9) == [0, 1, 2, 3, 4, 5]
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])
    turned[2, 3] = 0.225
    known._T_world_ref[2] = turned  # nearer to query 1 than keyframe 0 is, but it looks back
    assert known.oracle(1, 3) == [1, 0, 2]


def test_distance_angle_and_limits() -> None:
    poses = np.stack([truth(0, 0), truth(0, 2), np.full((4, 4), np.nan)])
    metres, degrees = distance_and_angle(poses)
    assert metres[:2] == pytest.approx([0.12, np.hypot(0.12, 0.30)])
    assert degrees[:2] == pytest.approx([2.0, 2.0])
    assert inside(metres, degrees, (0.12, 2.0)).tolist() == [True, False, False]
    assert inside(metres, degrees, (9.0, 1.9)).tolist() == [False, False, False]


def test_basins_are_given_measured_or_the_reach(tmp_path: Path) -> None:
    assert given_basin(None, None) is None
    assert given_basin(2.0, None) == (2.0, 180.0)
    table = tmp_path / "radii.csv"
    write_radii(
        table,
        ("dso", "pixels", "across conditions", 3.0),
        ("dso", "translation", "across conditions", 1.5),
        ("dso", "rotation", "across conditions", 6),
        ("dso", "translation", "sun → rain", 0.5),
        ("dso", "rotation", "sun → rain", 3),
        ("weak", "translation", "across conditions", "0.000000"),
        ("weak", "rotation", "across conditions", 2),
    )
    basins = Basins(None, read_basins(tmp_path))
    assert basins.of("dso", "sun", "rain", (9.0, 9.0)).limits == (0.5, 3.0)
    assert basins.of("dso", "sun", "fog", (9.0, 9.0)).limits == (1.5, 6.0)
    assert basins.of("dso", "sun", "sun", (9.0, 8.0)) == basins.of("orb-pnp", "sun", "fog", (9.0, 8.0))
    assert basins.of("weak", "sun", "fog", (9.0, 8.0)).source == "pairs"
    assert [basins.knows(name) for name in ("dso", "orb-pnp", "weak")] == [True, False, False]
    assert Basins((1.0, 2.0)).of("dso", "a", "b", (9.0, 9.0)).limits == (1.0, 2.0)
    write_radii(table, ("dso", "translation", "a", "wide"))
    with refused(PredictionError, "radii.csv", 2, "radius", "wide"):
        read_basins(table)
    table.write_text("method,offset\n")
    with refused(PredictionError, "radii.csv", 1, "radius"):
        read_basins(tmp_path)

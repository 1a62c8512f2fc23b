"""What the page of a set draws besides tables: maps, months, sweeps, matching and basins."""

from __future__ import annotations

import base64
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from answered_dataset import add_answers
from command_line import relocbench
from made_results import WINTER, MadeResults, made
from refusals import refused
from small_dataset import ACROSS, WITHIN, make_small_dataset

from relocbench.arrays import Array, Floats, Indices
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS, Factors, sweep
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import PairSetRecord, dataset_results, write_dataset_record
from relocbench.evaluation.probe.records import RADII, SHARES, read_probe
from relocbench.evaluation.tables.matching import OFFSETS_PX, MatchingRow
from relocbench.files import dump_yaml, write_table, write_text
from relocbench.geometry import invert, make_transform, so3_exp
from relocbench.leaderboard.html.looks import further_looks, looks
from relocbench.leaderboard.html.payloads import errors_payload, set_payload
from relocbench.leaderboard.html.set_page.maps import Maps, plan_of
from relocbench.leaderboard.html.set_page.measured import matching_payload, months_apart
from relocbench.leaderboard.html.set_page.sweeps import axis_of, sweep_of
from relocbench.leaderboard.tracking.model import DatasetBoard

UP_IS_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""rotation of a camera that looks along y in a world whose z points up"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("small") / "dataset")


def _poses(rotation: Array, positions: Any) -> Array:
    return np.array([make_transform(rotation, position) for position in positions])


def _floats(array: dict[str, str]) -> Floats:
    return np.frombuffer(base64.b64decode(array[":f4"]), dtype="<f4")


@pytest.mark.parametrize(
    ("rotation", "names", "up"),
    [
        (np.eye(3), ("x", "z"), (0, -1, 0)),  # the world of a first camera, whose y points down
        (UP_IS_Z, ("x", "y"), (0, 0, 1)),
        (so3_exp([0.05, 0.1, 0.1]) @ UP_IS_Z, ("x", "y"), (0, 0, 1)),
        (np.diag([1.0, -1.0, -1.0]), ("x", "-z"), (0, 1, 0)),
        (so3_exp([0.8, 0.0, 0.0]) @ UP_IS_Z, ("", ""), tuple(so3_exp([0.8, 0.0, 0.0]) @ [0, 0, 1])),
    ],
)
def test_a_map_is_seen_from_above_and_not_mirrored(
    rotation: Array, names: tuple[str, str], up: tuple[float, ...]
) -> None:
    plan = plan_of(_poses(rotation, [[0, 0, 0], [1, 2, 3]]))
    assert plan.names == names
    np.testing.assert_allclose(np.cross(*plan.axes), up, atol=1e-12)
    np.testing.assert_allclose(plan.axes @ plan.axes.T, np.eye(2), atol=1e-12)


def test_cameras_that_look_down_are_mapped_by_where_they_move() -> None:
    turns = [so3_exp([0.0, 0.0, yaw]) @ np.diag([1.0, -1.0, -1.0]) for yaw in np.linspace(0, 2 * np.pi, 8)[:-1]]
    poses = np.array([make_transform(turn, [3.0 * i, i**2, 50.0]) for i, turn in enumerate(turns)])
    assert plan_of(poses).names == ("x", "y")


def test_coordinates_of_a_country_keep_their_centimetres() -> None:
    plan = plan_of(_poses(UP_IS_Z, [[4_433_211.11, 5_399_999.99, 500.0]]))
    assert plan.origin.tolist() == [4_433_000.0, 5_400_000.0]
    np.testing.assert_allclose(plan.of(np.array([[4_433_211.11, 5_399_999.99, 0.0]])), [[211.11, -0.01]], atol=1e-6)


def test_queries_of_one_world_stand_at_their_own_poses(dataset: Dataset) -> None:
    maps = Maps(dataset, [ACROSS, WITHIN])
    (world,) = maps.worlds()
    assert (world["name"], world["axes"], sorted(world["routes"])) == ("summer", ["x", "z"], ["summer", "winter"])
    keys = [pair.key for pair in dataset.pair_set(ACROSS).pairs]
    places = maps.places(ACROSS, [*keys, (1, 2)])
    expected = np.array([dataset.traversal("winter").T_world_cam("cam0", query)[:3, 3] for _, query in keys])
    assert (places["world"], places["own"]) == (0, None)
    np.testing.assert_allclose(_floats(places["x"])[:-1], expected[:, 0], atol=1e-6)
    np.testing.assert_allclose(_floats(places["y"])[:-1], expected[:, 2], atol=1e-6)
    assert np.isnan(_floats(places["x"])[-1])  # a pair that the dataset does not have


def test_drives_without_a_common_world_are_not_drawn_in_one(tmp_path: Path) -> None:
    fault = make_transform(np.eye(3), [5.0, 0.0, 0.0])
    dataset = make_small_dataset(tmp_path / "D", pose_fault=fault)
    maps = Maps(dataset, [ACROSS])
    assert [(world["name"], list(world["routes"])) for world in maps.worlds()] == [
        ("summer", ["summer"]),
        ("winter", ["winter"]),
    ]
    pair = dataset.pair_set(ACROSS).pairs[0]
    places = maps.places(ACROSS, [pair.key])
    assert pair.T_query_ref is not None
    beside = dataset.traversal("summer").T_world_cam("cam0", pair.ref_timestamp_ns) @ invert(pair.T_query_ref)
    own = dataset.traversal("winter").T_world_cam("cam0", pair.query_timestamp_ns)
    assert (places["world"], places["own"]["world"]) == (0, 1)
    assert _floats(places["x"])[0] == pytest.approx(beside[0, 3], abs=1e-5)
    assert _floats(places["own"]["x"])[0] == pytest.approx(own[0, 3], abs=1e-5)
    assert abs(_floats(places["x"])[0] - _floats(places["own"]["x"])[0]) > 4


def _record(reference: str, query: str, *conditions: str) -> PairSetRecord:
    at, of = conditions or ("unknown", "unknown")
    drives = {"reference": reference, "query": query, "camera": "c"}
    return PairSetRecord(**drives, reference_condition=at, query_condition=of, pairs=1, rejected=0, has_truth=True)


DATES, SECONDS = np.array([[15 * 10**17, 16 * 10**17]]), np.array([[0, 10**9]])


@pytest.mark.parametrize(
    ("record", "keys", "by", "months"),
    [
        (_record("a", "a", "winter", "winter"), DATES, "drive", 0),
        (_record("a", "b"), DATES, "dates", None),
        (_record("a", "b", "snow, winter, dusk", "rain, autumn"), SECONDS, "seasons", 3),
        (_record("a", "b", "winter", "sunny, Summer"), SECONDS, "seasons", 6),
        (_record("a", "b", "winter", "a winterly day"), SECONDS, None, None),
    ],
)
def test_months_come_from_dates_then_seasons_or_are_not_recorded(
    record: PairSetRecord, keys: Indices, by: str | None, months: int | None
) -> None:
    assert months_apart(record, keys, None) == {"by": by, "months": months}


def test_seasons_of_the_dataset_at_hand_count_before_the_names_of_conditions(dataset: Dataset) -> None:
    record = _record("summer", "winter", "autumn", "autumn")
    assert months_apart(record, SECONDS, dataset) == {"by": "seasons", "months": 6}


def _swept(swept: str | None, factors: dict[str, Factors]) -> tuple[dict[str, PairSetRecord], Dataset]:
    made_by = {"options": {"sweep": swept}, "factors": {n: f.model_dump(mode="json") for n, f in factors.items()}}
    first, *_ = factors
    pair_sets = {f"set {name}": _record(f"test-{first}-0", f"test-{name}-1") for name in factors}
    return pair_sets, cast(Dataset, SimpleNamespace(file=SimpleNamespace(made_by=made_by)))


def test_the_steps_of_a_sweep_have_the_values_of_their_factor() -> None:
    factors = {f"light-{i}": f for i, f in enumerate(sweep("light", 5))}
    found = sweep_of(*_swept("light", factors))
    assert found is not None
    assert (found["name"], found["axis"], found["reference"]) == ("light", "sun elevation, °", 60)
    assert list(found["values"].values()) == [60, 47, 34, 21, 8]


def test_the_months_of_a_sweep_begin_with_none_and_seasons_have_no_axis_of_one_factor() -> None:
    found = sweep_of(*_swept("months", {f"months-{i}": f for i, f in enumerate(sweep("months", 4))}))
    assert found is not None
    assert (found["reference"], list(found["values"].values())) == (0, [0, 8, 16, 24])
    assert sweep_of(*_swept("season", {f"season-{i}": f for i, f in enumerate(sweep("season", 5))})) is None


def test_own_conditions_that_differ_in_one_factor_are_a_sweep_and_others_are_none() -> None:
    factors = {f"mist{i}": Factors(fog_density=0.01 * i) for i in range(3)}
    found = sweep_of(*_swept(None, factors))
    assert found is not None
    assert (found["name"], found["axis"]) == ("fog_density", "fog density")
    named = {name: CONDITIONS[name].factors for name in ("Sunny", "Overcast", "Snow")}
    assert sweep_of(*_swept(None, named)) is None
    assert sweep_of(_swept(None, factors)[0], None) is None
    assert sweep_of(*_swept("fog", dict(list(factors.items())[:2]))) is None  # two points are no curve


@pytest.mark.parametrize("tiers", [["easy", "medium", "extreme"], []])
def test_pairs_carry_their_tiers_where_these_are_known(tiers: list[str], tmp_path: Path) -> None:
    results = MadeResults(tmp_path, {WINTER: 3}, overlaps=[0.9, 0.3, 0.02][: len(tiers)])
    results.write_dataset()
    results.add("identity", {WINTER: made(0, 3, 0.1)})
    board = results.board()
    payload = errors_payload(board.datasets[0], WINTER)
    assert payload is not None
    places = base64.b64decode(payload["units"].get("tier", {}).get(":u1", ""))
    assert [payload["words"]["tier"][place] for place in places] == tiers
    assert any(column["key"] == "tier" for column in set_payload(board, board.datasets[0])["list"]) == bool(tiers)


def test_factors_have_words_and_units() -> None:
    assert [axis_of(key) for key in ("rain_mm_h", "imaging.exposure_ms", "wetness")] == [
        "rain, mm/h",
        "exposure, ms",
        "wetness",
    ]


def test_matching_is_told_by_the_offset_of_starts() -> None:
    def rows(found: int) -> tuple[MatchingRow, ...]:
        return tuple(
            MatchingRow(1, 2, "", offset, 10, 10, found, 9, 10 * (offset == 1), 10 * (offset <= 2))
            for offset in OFFSETS_PX
        )

    methods = [SimpleNamespace(label=label, matching={"a": rows(n)}) for label, n in (("good", 8), ("bad", 2))]
    methods.append(SimpleNamespace(label="none", matching={}))
    board = cast(DatasetBoard, SimpleNamespace(entry=SimpleNamespace(methods=methods, pair_sets=["a", "b"])))
    payload = matching_payload(board)
    assert list(payload["pair_sets"]) == ["a"]
    assert payload["pair_sets"]["a"]["methods"]["good"] == {"1px": [0.8] * 5, "3px": [0.9] * 5}
    assert sorted(payload["pair_sets"]["a"]["methods"]) == ["bad", "good"]
    assert payload["pair_sets"]["a"]["starts"]["1px"] == [1, 0, 0, 0, 0]


def _write_probe(folder: Path, share: str = "0.500000") -> None:
    write_text(folder / "probe.yaml", dump_yaml({"dataset": "small", "fingerprint": "ab", "options": {}}))
    head = ("m", "pixels", "", "across conditions", "match@1px", "px")
    points = [[*head, offset, 3, 10, share, "0.000000"] for offset in (0, 4)]
    write_table(folder / "probe.csv", SHARES.columns, points)
    half = [*head, 3, 0.0, 0, "", "", "nan", "", "", share, 3.5, 0, 3.0, 4.25, "", "", ""]
    write_table(folder / "radii.csv", RADII.columns, [half])


def test_a_probe_is_read_with_the_width_of_its_basin_and_checked(tmp_path: Path) -> None:
    _write_probe(tmp_path)
    (line,) = read_probe(tmp_path).lines
    assert [(p.offset, p.share, p.share_of_starts) for p in line.points] == [(0, 0.5, 0), (4, 0.5, 0)]
    assert line.radii is not None
    assert line.radii.half_text == "3.50 [3.00, 4.25] px"
    _write_probe(tmp_path, "1.5")
    with refused(PredictionError, "probe.csv", 2):
        read_probe(tmp_path)


def test_methods_that_were_only_probed_have_looks_of_their_own() -> None:
    known = [f"method-{i}" for i in range(7)]
    further = further_looks({"x", "y", "method-3"}, known)
    drawn = [(look["light"], look["dash"]) for look in [*looks(known).values(), *further.values()]]
    assert sorted(further) == ["x", "y"]
    assert len(set(drawn)) == len(drawn) == 9


def test_report_ranks_by_any_metric_and_refuses_those_of_tasks_that_are_not_there(
    dataset: Dataset, tmp_path: Path
) -> None:
    write_dataset_record(dataset_results(tmp_path / "results", dataset), dataset)
    add_answers(tmp_path / "results", dataset, "right", "right", lambda pair: pair.T_query_ref)
    where = tmp_path / "site"
    told = relocbench(
        "report",
        tmp_path / "results",
        "-o",
        where,
        "-q",
        "--pairs",
        0,
        "-d",
        dataset.root,
        "--metric",
        "recall@(1m,5deg)",
    )
    assert told.status == 0, told.err
    assert "Ranked by <code>recall@(1m,5deg)</code>" in (where / "index.html").read_text()
    assert list((where / "data" / "maps").glob("*/*.js"))
    told = relocbench("report", tmp_path / "results", "-o", where, "-q", "--retrieval-metric", "R@5")
    assert told.status == 2
    assert "--retrieval-metric ranks results of evaluate-retrieval" in told.complaint

"""Which pairs a rendered set keeps: those of a tier, some of many, not on the repeating street."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from relocbench.arrays import Array, Mask
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair, PairKey
from relocbench.datasets.importers.rendered.dataset import Options, build
from relocbench.datasets.pairs.correspondences import PairCorrespondences
from relocbench.datasets.pairs.measures import PairMeasures
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.jobs.selection import (
    REPEATING,
    Selection,
    clear_tiers,
    on_repeating_street,
    sorted_by_street,
)
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.geometry import make_transform, so3_exp
from relocbench.metrics.pose.tiers import TIERS
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("renderer_kept")


def pair(number: int, angle_deg: float = 1.0) -> Pair:
    return Pair(number, 100 + number, make_transform(so3_exp([0.0, np.radians(angle_deg), 0.0]), [0.0, 0.0, 1.0]))


def tier_of(angle_deg: float = 1.0, **measures: float) -> str:
    known = PairMeasures(**{"overlap": 0.9, "overlap_query": 0.9, "scale_change": 1.0, "depth_error": 0.0, **measures})
    index = clear_tiers([pair(0, angle_deg)], [known])[0]
    return "" if index < 0 else TIERS[index]


def test_a_pair_close_to_a_limit_is_in_no_tier_on_any_processor() -> None:
    assert tier_of() == "easy"
    assert tier_of(overlap=0.4) == tier_of(scale_change=1.3) == tier_of(10.0) == tier_of(depth_error=0.02) == "medium"
    assert tier_of(overlap=0.505) == tier_of(scale_change=1.151) == tier_of(5.05) == tier_of(depth_error=0.0149) == ""


def test_the_pairs_that_are_kept_are_spread_evenly() -> None:
    pairs = [pair(n) for n in range(10)]
    none = np.zeros((0, 2))
    of = PairMeasures(0.9, 0.9, 1.0, 0.0, None)
    nothing = none, none[:, 0], none, np.zeros(0, bool), np.zeros(0, np.int8)
    found = {p.key: PairCorrespondences(*nothing, of) for p in pairs}
    assert [p.ref_timestamp_ns for p in Selection("easy", 4).of(pairs, found)] == [0, 3, 6, 9]
    assert Selection("hard", 4).of(pairs, found) == []


@pytest.mark.parametrize("chosen", [{"tier": "easy"}, {"pairs": 3}])
def test_negative_pairs_are_refused_where_their_images_would_be_in_no_other_pair(chosen: dict[str, object]) -> None:
    with pytest.raises(ValidationError, match="elsewhere exchanges queries of all pairs"):
        Options.model_validate({**SMALL, "elsewhere": 2, "elsewhere_distance": 20.0, **chosen})


@pytest.mark.thorough
def test_the_repeating_street_is_where_its_houses_are() -> None:
    place = DistrictSpec(3, "validation", 190.0)
    district = scenes.district(place)
    middle = np.mean([(front.start + front.end) / 2 for front in district.periodic.fronts], axis=0)
    away = district.network.nodes[:, :2][np.argmax(np.linalg.norm(district.network.nodes[:, :2] - middle, axis=1))]
    poses = np.array([make_transform(np.eye(3), [*at, 1.5]) for at in (middle, away)])
    assert on_repeating_street(place, poses).tolist() == [True, False]
    pairs = [pair(0), pair(1)]
    there = {0: True, 1: False, 100: False, 101: False}
    assert [p.group for p in sorted_by_street(pairs, there, avoid=False)] == [REPEATING, ""]
    assert [p.ref_timestamp_ns for p in sorted_by_street(pairs, there, avoid=True)] == [1]


@pytest.mark.thorough
@pytest.mark.parametrize("pair_rule", [None, "nearest"])
def test_negative_pairs_are_made_of_the_pairs_that_the_street_leaves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pair_rule: str | None
) -> None:
    def beyond(_place: DistrictSpec, T_world_cam: Array) -> Mask:
        return np.arange(len(T_world_cam)) >= len(T_world_cam) // 2

    monkeypatch.setattr("relocbench.datasets.synthetic.jobs.pair_sets.on_repeating_street", beyond)
    chosen = {"distance": 1.0, "max_distance": 4.0} if pair_rule is None else {"max_distance": 4.0}
    negative = {"elsewhere": 4, "elsewhere_distance": 6.0, "repeating_street": "avoid", "correspondences": 0}
    asked = made(
        tmp_path / "some", **chosen, **negative, pair_rule=pair_rule, steps=24, size="48", speed=10.0
    ).pair_set("validation-Sunny-0__validation-Overcast-0__front")
    assert len(asked.negative_pairs) == 4
    places = [pair for pair in asked.pairs if not pair.is_negative]
    for one in asked.negative_pairs:
        assert one.ref_timestamp_ns in {pair.ref_timestamp_ns for pair in places}
        assert one.query_timestamp_ns in {pair.query_timestamp_ns for pair in places}


SMALL = {"preset": "smoke", "conditions": ("Sunny", "Overcast"), "steps": 12, "size": "96x72", "split": "validation"}


def tree_bytes(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def made(out: Path, **options: object) -> Dataset:
    return build([], Options(**{**SMALL, **options}), out, Silent(), Run(1))


@pytest.mark.thorough
def test_a_set_of_a_tier_holds_some_of_the_pairs_that_it_would_hold_anyway(tmp_path: Path) -> None:
    every_pair: dict[str, object] = {
        "conditions": ("Sunny",), "traversals": 2, "distance": 4.0, "max_distance": 12.0,
    }  # fmt: skip
    some = {**every_pair, "tier": "medium", "pairs": 3}
    every, medium = made(tmp_path / "all", **every_pair), made(tmp_path / "medium", **some)
    for name in medium.pair_set_names:
        by_key = {p.key: p for p in every.pair_set(name).pairs}
        kept = medium.pair_set(name).pairs
        assert 1 <= len(kept) <= 3
        for one in kept:
            assert (one.overlap, one.scale_change) == (by_key[one.key].overlap, by_key[one.key].scale_change)
    before = tree_bytes(medium.root)
    next((medium.root / "pairs").glob("*.txt")).unlink()
    made(tmp_path / "medium", **some)
    assert tree_bytes(medium.root) == before


@pytest.mark.thorough
def test_a_set_without_any_pair_of_the_tier_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Selection.of

    def none_of_the_map(self: Selection, pairs: Sequence[Pair], found: Mapping[PairKey, PairCorrespondences]) -> Any:
        of_one_drive = pairs[0].ref_timestamp_ns in {pair.query_timestamp_ns for pair in pairs}
        return [] if of_one_drive else real(self, pairs, found)

    monkeypatch.setattr(Selection, "of", none_of_the_map)
    dataset = made(tmp_path / "one", distance=1.0, max_distance=3.0, pairs=2)
    assert dataset.pair_set_names == ["validation-Sunny-0__validation-Overcast-0__front"]
    for folder in ("pairs", "correspondences"):
        assert {path.stem for path in (dataset.root / folder).iterdir()} == set(dataset.pair_set_names)
    before = tree_bytes(dataset.root)
    made(tmp_path / "one", distance=1.0, max_distance=3.0, pairs=2)
    assert tree_bytes(dataset.root) == before


@pytest.mark.thorough
def test_a_street_that_leaves_no_pair_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def everywhere(_place: DistrictSpec, T_world_cam: Array) -> Mask:
        return np.ones(len(T_world_cam), dtype=np.bool_)

    monkeypatch.setattr("relocbench.datasets.synthetic.jobs.pair_sets.on_repeating_street", everywhere)
    for cameras in ({}, {"cameras": "stereo", "camera_pairs": "across"}):
        with pytest.raises(DatasetError, match="all pairs stand on the repeating street"):
            made(tmp_path / "none", distance=1.0, max_distance=3.0, repeating_street="avoid", **cameras)


@pytest.mark.thorough
def test_a_tier_that_no_pair_is_of_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no pair of any set is extreme"):
        made(tmp_path / "none", distance=0.5, max_distance=1.0, max_angle=2.0, tier="extreme")

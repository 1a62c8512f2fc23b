"""Pairs of different places: pairs that exchange their queries over a distance."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from refusals import refused

from relocbench.arrays import Array
from relocbench.datasets.core.build_options import RuleOptions
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.importers.four_seasons.dataset import Options as FourSeasons
from relocbench.datasets.pairs.different_places import with_different_places
from relocbench.datasets.pairs.pairing import make_pairs
from relocbench.datasets.pairs.posed_frames import PosedFrames
from relocbench.errors import DatasetError
from relocbench.geometry import make_transform, so3_exp


def drive(xs: Array, first_time: int) -> PosedFrames:
    """Cameras along x with some yaw, all keyframes, one a nanosecond."""
    poses = np.array([make_transform(so3_exp([0, 0.01 * i, 0]), [x, 0, 0]) for i, x in enumerate(xs)])
    times = tuple(range(first_time, first_time + len(xs)))
    return PosedFrames(times, poses, frozenset(times))


def options(count: int, seed: int = 0) -> RuleOptions:
    return RuleOptions(elsewhere=count, elsewhere_distance=20.0, max_distance=4.0, max_angle=180, seed=seed)


def made(seed: int, count: int, length_m: float = 100.0) -> tuple[PosedFrames, PosedFrames, list[Pair], list[Pair]]:
    """Two drives along one road, their pairs of one place, and those of different places."""
    rng = np.random.default_rng(seed)
    ref, query = (np.sort(rng.uniform(0, length_m, 40)) for _ in range(2))
    frames = drive(ref, 100), drive(query, 900)
    common = {"same_traversal": False, "source": "test poses", "sigma_translation_m": 0.0, "sigma_rotation_deg": 0.0}
    plain = make_pairs(*frames, RuleOptions(max_distance=4.0, max_angle=180, seed=seed), **common)  # type: ignore[arg-type]
    pairs = make_pairs(*frames, options(count, seed), **common)  # type: ignore[arg-type]
    assert [(p.key, p.group) for p in pairs[: len(plain)]] == [(p.key, p.group) for p in plain], "the others stay"
    return *frames, plain, pairs[len(plain) :]


@pytest.mark.thorough
@given(st.integers(0, 2**32), st.integers(1, 40))
def test_they_are_far_apart_and_their_truth_is_known(seed: int, count: int) -> None:
    reference, query, plain, found = made(seed, count)
    assert len(found) == count
    assert len({p.key for p in (*plain, *found)}) == len(plain) + count
    for pair in found:
        assert pair.is_negative
        assert (pair.source, pair.sigma_translation_m, pair.overlap) == ("test poses", 0.0, None)
        T_world_ref = reference.T_world_cam[reference.timestamps.index(pair.ref_timestamp_ns)]
        T_world_query = query.T_world_cam[query.timestamps.index(pair.query_timestamp_ns)]
        assert pair.distance_m == pytest.approx(np.linalg.norm((T_world_ref - T_world_query)[:3, 3]))
        assert (pair.distance_m or 0) >= 20.0
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(T_world_query @ pair.T_query_ref, T_world_ref, atol=1e-9)


@pytest.mark.thorough
@given(st.integers(0, 2**32), st.integers(1, 15))
def test_how_often_images_are_asked_about_does_not_tell_the_kind_of_a_pair(seed: int, exchanges: int) -> None:
    *_, plain, found = made(seed, 2 * exchanges)
    refs = Counter(p.ref_timestamp_ns for p in (*plain, *found))
    queries = Counter(p.query_timestamp_ns for p in (*plain, *found))
    own = {p.query_timestamp_ns: p.key for p in plain}  # each query has one pair of its own
    theirs = [own[p.query_timestamp_ns] for p in found]

    def repeated(keys: list[tuple[int, int]]) -> tuple[list[int], list[int]]:
        return sorted(refs[ref] for ref, _ in keys), sorted(queries[query] for _, query in keys)

    assert repeated([p.key for p in found]) == repeated(theirs)


def test_they_follow_from_the_seed_and_more_of_them_begin_with_the_same() -> None:
    few, again, many, other = (made(3, 6)[3], made(3, 6)[3], made(3, 20)[3], made(4, 6)[3])
    assert [p.key for p in few] == [p.key for p in again] == [p.key for p in many][:6]
    assert [p.key for p in few] != [p.key for p in other]


def test_a_road_too_short_is_one_line_with_its_numbers(tmp_path: Path) -> None:
    frames = drive(np.arange(10.0), 0), drive(np.arange(10.0), 100)
    pairs = make_pairs(*frames, RuleOptions(), same_traversal=False, source="test")
    with refused(DatasetError, "", None, "--elsewhere", "8", "0", "20", "9") as bad:
        with_different_places(pairs, *frames, options(8), tmp_path)
    assert "\n" not in str(bad.value)


def test_options_that_make_no_sense_are_refused() -> None:
    with refused(ValidationError, "", None, "elsewhere_distance", "4", "max_distance", "5"):
        RuleOptions(elsewhere=3, elsewhere_distance=4.0)
    with refused(ValidationError, "", None, "elsewhere_distance has no effect"):
        RuleOptions(elsewhere_distance=40.0)
    with refused(ValidationError, "", None, "relocalization_files"):
        FourSeasons(elsewhere=3, relocalization_files=(Path("x"),))


def test_builds_without_them_are_recorded_as_before() -> None:
    assert "elsewhere" not in RuleOptions().recorded()
    assert "elsewhere_distance" not in RuleOptions().recorded()
    assert RuleOptions(elsewhere=2).recorded()["elsewhere_distance"] == 50.0

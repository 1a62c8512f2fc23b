"""Who is given a blind export learns nothing but by its images, while without a salt every pair is answered exactly."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cheating_exports import (
    answer_by_order,
    mean_error_m,
    orders_by_pairs,
    orders_of,
    rebuild_the_world,
    render_town,
    truth_of,
)
from forgery import change_yaml
from small_dataset import WITHIN, make_small_dataset
from submissions import SALT_TEXT, blind_export, salt, salt_file

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.pairs.posed_frames import PosedFrames, pair_of
from relocbench.datasets.synthetic.jobs.pairs import DistanceSpread, drawn_pairs
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.geometry import make_transform

pytestmark = pytest.mark.usefixtures("towns_kept")
SPACING_M = 0.15


@pytest.mark.thorough
@pytest.mark.parametrize("guesses", [1, 3])
def test_who_renders_the_towns_of_guessed_seeds_again_finds_none_that_is_asked(tmp_path: Path, guesses: int) -> None:
    render = cache(lambda seed: render_town(tmp_path / f"guess-{seed}", "32x32", seed))
    open_town, closed_town = render(0), render_town(tmp_path / "closed", "32x32", 0, salt_file(tmp_path))
    # A dataset of which nobody knows that it was rendered can be exported without a salt in its seed.
    change_yaml(open_town.root / "dataset.yaml", lambda file: file.update(made_by={"kind": "generic"}))
    for town, seeds in ((Dataset(open_town.root), [0]), (closed_town, [])):
        (pair_set,) = town.pair_sets()
        export = blind_export(town, tmp_path / f"blind-{len(seeds)}")
        found = rebuild_the_world(export, render, range(guesses))
        assert list(found) == seeds
        shown, truth = BlindKeys(town, salt()).pair_set(pair_set), truth_of(town, salt(), pair_set.name)
        for answers in found.values():
            assert mean_error_m({key: answers[shown, key] for key in truth}, truth) < 1e-6
    secrets = SALT_TEXT, str(salt().seed("validation", 0))
    texts = [path.read_text() for path in closed_town.root.rglob("*") if path.suffix in (".yaml", ".csv", ".txt")]
    assert not any(secret in text for text in texts for secret in secrets)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("street") / "ds", frames=8, size=(24, 18))


def errors_by_order(street: Dataset, export: Dataset) -> dict[str, float]:
    """Mean errors of who takes an order for that along the road, in either direction; the better one."""
    keys, truth = BlindKeys(street, salt()), truth_of(street, salt(), WITHIN)
    pairs = export.pair_set(keys.pair_set(street.pair_set(WITHIN))).evaluated
    return {
        what: min(mean_error_m(answer_by_order(pairs, order, pace), truth) for pace in (SPACING_M, -SPACING_M))
        for what, order in orders_of(export, keys.drives["summer"]).items()
    }


def test_no_order_of_an_export_is_that_along_the_road(street: Dataset, tmp_path: Path) -> None:
    export, truth = blind_export(street, tmp_path / "b"), truth_of(street, salt(), WITHIN)
    identity = mean_error_m(dict.fromkeys(truth, np.eye(4)), truth)
    assert min(errors_by_order(street, export).values()) > identity
    keys = BlindKeys(street, salt())
    for time in street.traversal("summer").timestamps("cam0"):
        (path,) = export.root.rglob(f"images/*/{keys.key('summer', 'cam0', time)}.png")
        os.utime(path, ns=(time, time))
    told = errors_by_order(street, export)
    assert told["time of writing"] < 1e-6 < identity, "an order that told the road would be found"


def test_the_order_that_follows_from_pairs_gains_nothing_where_their_distances_are_drawn() -> None:
    """Three drives of a straight road, and pairs of the rule that rendered datasets have by default."""
    steps, pace = 60, 0.8
    drives = [
        PosedFrames(
            tuple(range(100 * n, 100 * n + steps)),
            np.array([make_transform(np.eye(3), [0.2 * n, 0.0, pace * k]) for k in range(steps)]),
            frozenset(range(100 * n, 100 * n + steps)),
        )
        for n in range(3)
    ]
    drawn = [
        pair
        for n, drive in enumerate(drives)
        for pair in drawn_pairs(
            drives[0], drive, DistanceSpread(), np.random.default_rng([7, n]), same_traversal=n == 0
        )
    ]
    frames = np.arange(steps - 1)
    chain = [pair_of(drives[0], int(k), drives[0], int(k) + step) for step in (1, 2) for k in frames[: steps - step]]
    for pairs, spacing, gains in ((drawn, pace / 3, False), (chain, pace, True)):
        truth = {pair.key: pair.T_query_ref for pair in pairs if pair.T_query_ref is not None}
        told = 0.0
        for order in orders_by_pairs(pairs):
            own = {key: pose for key, pose in truth.items() if key[0] in order}
            asked = [pair for pair in pairs if pair.key in own]
            answers = (answer_by_order(asked, order, sign * spacing) for sign in (1, -1))  # the better way round
            told += len(own) / len(truth) * min(mean_error_m(one, own) for one in answers)
        identity = mean_error_m(dict.fromkeys(truth, np.eye(4)), truth)
        assert told < 0.2 * identity if gains else told > 0.95 * identity, (told, identity)

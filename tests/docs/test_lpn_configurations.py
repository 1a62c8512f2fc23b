"""The page of LPN's configurations: intervals from the ranks of each query, and what tells systems apart."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import lpn_configurations as page
import lpn_order as order
import numpy as np
import pytest
import torch
from made_places import NarrowResNet
from refusals import refused
from small_views import make_small_views

from baselines.lpn.configurations import configuration
from baselines.lpn.network import LpnNetwork
from baselines.lpn.weights import About, save_weights
from relocbench.datasets.cross_view import open_cross_view
from relocbench.errors import PredictionError
from relocbench.metrics import crossed_difference, mean_interval, paired_difference

PLACES, DRONES, DISTRACTORS = 12, 2, 2
D, S = page.DIRECTIONS


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve places whose images are so noisy that thumbnails confuse some."""
    root = tmp_path_factory.mktemp("data") / "views"
    return make_small_views(root, places=PLACES, drones=DRONES, distractors=DISTRACTORS, noise=70.0)


@pytest.fixture(scope="module")
def to_learn_from(places: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same images in train folders, which are only described."""
    root = tmp_path_factory.mktemp("data") / "train"
    for place in sorted((places / "test" / "query_drone").iterdir()):
        for view in ("drone", "satellite"):
            shutil.copytree(place, root / "train" / view / f"1{place.name}")
    return root


@pytest.fixture
def given(places: Path, tmp_path: Path) -> argparse.Namespace:
    return argparse.Namespace(scratch=str(tmp_path / "scratch"), quiet=True, settings=[], published=[])


def run(values: list[float], drone: list[float] | None = None) -> page.ByPlace:
    """A training whose three metrics have the same value at each place."""
    return {D: dict.fromkeys(page.METRICS, np.array(drone or values)), S: dict.fromkeys(page.METRICS, np.array(values))}


def row(name: str, *runs: page.ByPlace, seeds: tuple[int, ...] | None = None) -> page.Row:
    return page.Row(name, "", runs, tuple(range(len(runs))) if seeds is None else seeds)


def test_answers_are_one_value_for_each_place_and_have_the_means_of_the_scores(
    places: Path, given: argparse.Namespace
) -> None:
    test, methods = open_cross_view(places), {"thumbs": "colour-histogram", "random": "random"}
    results = page.ask(given, test, methods)
    found = page.answers(results, methods, test)
    for folder in results.methods():
        scores = folder.retrieval_scores().tasks
        for direction in page.DIRECTIONS:
            for metric in page.METRICS:
                values = found[folder.label][direction][metric]
                assert values.shape == (PLACES,)
                assert values.mean() == pytest.approx(scores[direction][metric])
    recall = found["thumbs"][D]["R@1"]
    assert {*np.round(recall, 9)} <= {0.0, 0.5, 1.0}  # two drone images a place
    assert 0 < recall.mean() < 1
    ours = page.Row("thumbs", "", (found["thumbs"],), ()).interval_by_places(D)
    scored = results.method("thumbs").retrieval_scores().tasks[D]
    assert ours is not None
    assert (ours.low, ours.high) == pytest.approx((scored["R@1_low"], scored["R@1_high"]))


def test_ranks_that_do_not_follow_from_the_retrieved_images_are_refused(
    places: Path, given: argparse.Namespace
) -> None:
    test = open_cross_view(places)
    results = page.ask(given, test, {"thumbs": "colour-histogram"})
    path = results.method("thumbs").answers(D)
    lines = path.read_text().splitlines()
    missed = next(i for i, line in enumerate(lines) if ",ok,1," in line and ",ok,1,1," not in line)
    cells = lines[missed].split(",")
    cells[4] = "1"
    path.write_text("\n".join([*lines[:missed], ",".join(cells), *lines[missed + 1 :]]) + "\n")
    with refused(PredictionError, path.name, None, "ranks", 1):
        page.answers(results, ["thumbs"], test)


def test_an_interval_by_places_is_that_of_the_mean_over_the_seeds() -> None:
    rng = np.random.default_rng(0)
    values = [rng.integers(0, 2, 40).astype(float) for _ in range(3)]
    found = row("lpn", *(run(list(v)) for v in values)).interval_by_places(S)
    assert found == mean_interval([np.mean(values, axis=0)], independent=True)
    assert row("few", run([1.0] * 9)).interval_by_places(S) is None


def test_only_systems_whose_difference_exceeds_places_and_seeds_are_told_apart() -> None:
    rng = np.random.default_rng(1)
    base = [np.full(60, 0.5) + rng.normal(0, 0.02, 60) for _ in range(3)]
    scatter = (-0.25, 0.3, 0.1)
    better = row("better", *(run(list(b + 0.2)) for b in base))
    unsure = row("unsure", *(run(list(b + s)) for b, s in zip(base, scatter, strict=True)))
    rows = [better, row("lpn", *(run(list(b)) for b in base)), unsure, row("random", run([0.0] * 60), seeds=())]
    ahead = page.differences_to_first(rows)
    assert list(ahead) == ["better", "unsure"]
    assert ahead["better"][D]["R@1"].significant
    assert not ahead["unsure"][D]["R@1"].significant
    by_places = paired_difference([np.mean([b + s for b, s in zip(base, scatter, strict=True)], axis=0)],
                                  [np.mean(base, axis=0)], independent=True)  # fmt: skip
    assert by_places.significant  # places alone would have told it apart
    expected = crossed_difference(better.by_seed_and_place(S, "AP"), rows[1].by_seed_and_place(S, "AP"))
    assert ahead["better"][S]["AP"] == expected
    summary = page.summary_of_differences(ahead)
    assert summary["better"][S]["AP"] == {
        "mean": 20.0,
        "low": pytest.approx(100 * expected.interval.low, abs=0.01) if expected.interval else None,
        "high": pytest.approx(100 * expected.interval.high, abs=0.01) if expected.interval else None,
        "significant": True,
    }
    assert page.differences_to_first([better, unsure]) == {}


def test_one_seed_tells_nothing_apart() -> None:
    ahead = page.differences_to_first([row("lpn", run([0.0] * 60)), row("better", run([1.0] * 60))])
    summary = page.summary_of_differences(ahead)["better"][D]["R@1"]
    assert summary == {"mean": 100.0, "low": None, "high": None, "significant": False}


@pytest.mark.thorough
def test_the_page_has_intervals_and_differences_and_follows_from_the_published_ranks(
    places: Path,
    to_learn_from: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """From drawn weights in the place of trained ones to the page, the table and the last line."""
    monkeypatch.setattr("baselines.lpn.backbone.resnet18", NarrowResNet)
    about = About("lpn", 64, "drawn, no ImageNet", ("drone", "satellite"), 0, {"data": '{"made": "0"}'})

    def drawn(given: argparse.Namespace) -> dict[tuple[str, int], Path]:
        return {(name, seed): saved(name, seed) for name in given.config for seed in given.seed}

    def saved(name: str, seed: int) -> Path:
        path = tmp_path / f"{name}-{seed}.safetensors"
        network = replace(configuration(name).network, backbone="resnet18", width=8)
        save_weights(path, LpnNetwork(3, network, torch.Generator().manual_seed(seed)).eval(), about)
        return path

    monkeypatch.setattr(page, "weights_of", drawn)
    monkeypatch.setattr(page, "FLOORS", ("random", "colour-histogram"))  # so small images have no features of ORB
    words: list[Any] = ["lpn_configurations.py", "--train", to_learn_from, "--test", places]
    words += ["--scratch", tmp_path / "scratch", "--out", tmp_path / "out", "--quiet"]
    words += ["--config", "global-average", "lpn", "--seed", 0, 1]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    assert page.main() == 0
    text = (tmp_path / "out" / "lpn_configurations.md").read_text()
    table = (tmp_path / "out" / "lpn_configurations.csv").read_text().splitlines()
    ours = [line.split(",")[3:] for line in table if line.startswith("lpn,")]
    assert len(ours) == 4
    assert ours[:2] != ours[2:]  # both directions with either seed
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert text.count("95 % by places |") == 2
    (line,) = (line for line in text.splitlines() if line.startswith("| global-average |") and "[" in line)
    difference = last["difference_to_lpn"]["views"]["global-average"][D]["R@1"]
    assert line.split("|")[2].strip().startswith(f"{difference['mean']:+.1f} [{difference['low']:+.1f}, ")
    assert {*last["percent"]["views"]} == {"global-average", "lpn", *page.FLOORS}
    assert set(last["difference_to_lpn"]["views"]) == {"global-average"}
    assert "with one error rate for all 4 of this table" in text
    for lines in (part for part in text.split("\n\n") if part.startswith("| system")):
        assert len({line.count("|") for line in lines.splitlines()}) == 1

    archive, out = tmp_path / "out" / page.ARCHIVE, tmp_path / "again"
    again = [*words, "--published", archive, "--scratch", tmp_path / "other", "--out", out]
    monkeypatch.delattr(page, "evaluate_retrievers")
    monkeypatch.setattr(sys, "argv", [str(word) for word in again])
    assert page.main() == 0
    for name in ("lpn_configurations.md", "lpn_configurations.csv"):
        assert (out / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


def test_the_page_compares_only_where_there_is_something_to_compare(places: Path, to_learn_from: Path) -> None:
    chance = dict.fromkeys(page.DIRECTIONS, 0.1)
    base, other = row("lpn", run([0.0] * 60)), row("other", run([1.0] * 60))
    asked = argparse.Namespace(train=[to_learn_from], settings=[], backbone_weights=None, seed=[0])
    for rows in ([base, other], [other]):
        text = page.page(rows, page.differences_to_first(rows), asked, open_cross_view(places), chance)
        told = "A single seed does not tell how much trainings scatter: no difference is significant." in text
        assert told == ("| other | +100.0 | +100.0 | +100.0 | +100.0 |" in text) == (base in rows)
        assert "degrees of freedom" not in text


def test_settings_are_of_all_systems_or_of_those_with_a_name() -> None:
    given = ["rate=1", "epochs.refined=2", "lpn-heatmap*.rate=3", "lpn-heatmap.network.heatmap.heat=mean"]
    given += ["network.width=8"]
    assert page.settings_of("lpn", given) == ["rate=1", "network.width=8"]
    assert page.settings_of("lpn-rpp", given) == ["rate=1", "epochs.refined=2", "network.width=8"]
    assert page.settings_of("lpn-heatmap-log", given) == ["rate=3", "network.width=8"]
    assert page.settings_of("lpn-heatmap", given) == ["rate=3", "network.heatmap.heat=mean", "network.width=8"]


def made_values(means: list[float], places: int = 200, seeds: int = 3, scatter: float = 0.0) -> dict[str, Any]:
    """(S, P) values of systems a, b, c, ... that differ by their means; trainings scatter by ``scatter``."""
    rng = np.random.default_rng(3)
    at_places = rng.normal(0, 0.1, places)
    return {
        name: mean + at_places + rng.normal(0, scatter, (seeds, 1)) + rng.normal(0, 0.02, (seeds, places))
        for name, mean in zip("abcdefgh", means, strict=False)
    }


@pytest.mark.thorough
def test_the_agreement_of_two_orders_and_its_interval() -> None:
    logged = {"a": 50.0, "b": 60.0, "c": 70.0, "d": 80.0}
    same = order.agreement(made_values([0.1, 0.2, 0.3, 0.4, 0.9]), logged)
    assert same is not None
    assert (same.systems, same.tau, same.low, same.high) == (4, 1, 1, 1)
    assert same.p == pytest.approx(2 / 24)  # of all orders, this and its reverse
    reverse = order.agreement(made_values([0.4, 0.3, 0.2, 0.1]), logged)
    assert reverse is not None
    assert reverse.tau == -1
    unsure = order.agreement(made_values([0.3, 0.3, 0.3, 0.3], scatter=0.1), logged)
    assert unsure is not None
    assert unsure.low < 0 < unsure.high
    assert unsure.low <= unsure.tau <= unsure.high
    assert order.agreement(made_values([0.1, 0.2]), logged) is None


def test_pairs_of_the_log_are_told_apart_in_its_order_or_the_opposite_or_not() -> None:
    values = made_values([0.1, 0.3, 0.2, 0.2004])
    found = order.pairs(values, {"a": 50.0, "b": 60.0, "c": 70.0, "d": 70.0})
    assert [(each.first, each.second) for each in found.same] == [("b", "a"), ("c", "a"), ("d", "a")]
    assert [(each.first, each.second, each.apart) for each in found.opposite] == [
        ("c", "b", 10.0),
        ("d", "b", 10.0),
    ]
    assert found.open == []  # c and d are equal in the log
    assert found.same[0].difference == crossed_difference(values["b"], values["a"])
    scattered = order.pairs(made_values([0.1, 0.12], scatter=0.2), {"a": 1.0, "b": 2.0})
    assert [len(each) for each in scattered] == [0, 0, 1]


def test_the_scatter_of_trainings_and_that_of_places_are_told_one_from_the_other() -> None:
    rng = np.random.default_rng(0)
    places = rng.normal(0, 0.3, 400)
    first = np.zeros((20, 400))
    by_places = order.scatter(places + first, first)
    assert by_places.places == pytest.approx(0.3 / 20, rel=0.1)
    assert by_places.seeds == pytest.approx(0)
    by_seeds = order.scatter(rng.normal(0, 0.1, (20, 1)) + first, first)
    assert by_seeds.places == pytest.approx(0)
    assert by_seeds.one_training == pytest.approx(0.1, rel=0.4)
    assert by_seeds.seeds == pytest.approx(by_seeds.one_training / np.sqrt(20))


def test_where_trainings_ended_is_read_from_their_logs(tmp_path: Path) -> None:
    for seed, loss in ((0, 2.0), (1, 4.0)):
        log = tmp_path / f"lpn-seed{seed}" / "log.csv"
        log.parent.mkdir()
        log.write_text(f"step,instance,right/drone,right/satellite\n20,9.0,0.1,0.1\n40,{loss},0.5,1.0\n")
    asked = argparse.Namespace(config=["lpn", "lpn-dmli", "lpn-rpp"], seed=[0, 1], scratch=str(tmp_path))
    assert page.ends_of(asked) == [("lpn", "40", "3.00", "75")]

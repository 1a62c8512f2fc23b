"""What limits GN-Net on a dataset: its search, where the truth fits better than its pose, or else its features."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import gn_net_limits
import numpy as np
import pytest
from gn_net_limits import Watched, from_near, limits, questions
from small_dataset import make_small_dataset

from baselines.alignment.shared.starts import Start
from baselines.gn_net.tracker import GnNetFromPrior
from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.geometry import make_transform


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("d") / "d", size=(192, 144), within=False, pairs=1)


def test_a_wrong_pose_is_the_fault_of_the_search_or_of_the_features(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker = Watched()
    reference, query, truth = next(questions(tracker, dataset))
    elsewhere = make_transform(np.eye(3), [1.0, 0.0, 0.0]) @ truth

    def counted(true: Array) -> set[str]:
        return {column for column, counts in limits(tracker, reference, query, true).items() if counts}

    assert counted(truth) == {"pairs", "right", "nearest", "nearest, with the truth"}
    assert counted(elsewhere) == {"pairs", "wrong", "truth is left"}
    answered, tracker.settings = tracker.settings, replace(tracker.settings, iterations=(1,))
    assert counted(elsewhere) == {"pairs", "wrong", "truth fits worse", "nearest, with the truth"}
    tracker.settings, tracker.matched_start = answered, False
    monkeypatch.setattr(tracker, "_starts", lambda *_: [Start(elsewhere, 0), Start(truth, 0)])
    assert "right" in counted(truth)
    tracker.min_points, points = 10**6, tracker.min_points
    assert {"wrong", "of these declined"} <= counted(truth)
    tracker.min_points = points
    monkeypatch.setattr(tracker, "_starts", lambda *_: [Start(elsewhere, 0)])
    assert {"wrong", "truth fits better", "nearest, with the truth"} <= counted(truth)
    assert "nearest" not in counted(truth)


def test_answers_from_a_prior_are_right_or_wrong_or_declined(dataset: Dataset) -> None:
    tracker = GnNetFromPrior()
    reference, query, truth = next(questions(tracker, dataset))
    elsewhere = make_transform(np.eye(3), [1.0, 0.0, 0.0]) @ truth
    for declined in (False, True):
        asked = replace(tracker, min_agreement=1.0) if declined else tracker
        right, wrong = (from_near(asked, reference, query, true, truth) for true in (truth, elsewhere))
        told = ["declined"] if declined else ["right", "sure and right"]
        assert [column for column, counts in right.items() if counts] == ["pairs", *told]
        told = ["declined"] if declined else ["wrong", "sure and wrong"]
        assert [column for column, counts in wrong.items() if counts] == ["pairs", *told]


def test_one_command_prints_both_tables(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["gn_net_limits.py", str(dataset.root), "--set", "matched_start=false"])
    gn_net_limits.main()
    page = capsys.readouterr().out
    assert "| small | 1 | 1 | 0 | 0 | 0 | 0 | 0 | 1 | 1 |\n" in page
    assert "| all, % | 100.0 | 100.0 | 0.0 | 0.0 | 100.0 | 0.0 |\n" in page
    assert json.loads(page.splitlines()[-1])["gn-net-from-prior"]["sure and right"] == 1

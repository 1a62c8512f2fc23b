"""Every configuration on a small rendered set, from its images to its row of metrics."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from made_places import TINY

from baselines.lpn.configurations import CONFIGURATIONS, FROM_ABOVE
from baselines.lpn.retriever import Lpn
from baselines.lpn.training.trainer import LpnTrainer
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.datasets.importers.rendered import cross_view
from relocbench.datasets.learning.training_places import training_places
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.execution import Run
from relocbench.progress import Silent
from relocbench.training import TrainingRun

pytestmark = pytest.mark.usefixtures("towns_kept")
DIRECTIONS = ("drone-satellite", "satellite-drone")


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> CrossViewSet:
    of_four = {"split": "all", "places": 4, "distractors": 1, "drone_views": 2}
    small = {"size": 64, "extent": 190.0, "conditions": ("Sunny",)}
    options = cross_view.Options.model_validate({**of_four, **small})
    return cross_view.build_places([], options, tmp_path_factory.mktemp("places") / "out", Silent(), Run(1))


@pytest.mark.thorough
def test_a_rendered_set_is_learnt_from_by_its_folder(rendered: CrossViewSet) -> None:
    places = training_places([rendered.root], Silent())
    assert places.views == ("drone", "satellite")
    assert places.places == rendered.training().places == 4
    assert [one.image.key for one in places.images] == [one.image.key for one in rendered.training().images]


@pytest.mark.thorough
@pytest.mark.usefixtures("without_curves")
@pytest.mark.parametrize("name", FROM_ABOVE)
def test_each_configuration_trains_and_is_evaluated(name: str, rendered: CrossViewSet, tmp_path: Path) -> None:
    stages = CONFIGURATIONS[name].stages
    options = {**TINY, "configuration": name, "epochs": {stage.name: 1 for stage in stages}}
    run = TrainingRun(tmp_path / "trained", "lpn", "relocbench train lpn", workers=0)
    report = LpnTrainer().train_places(rendered.training(), None, options, run)
    with (run.out / "log.csv").open(newline="") as stream:
        assert [row["stage"] for row in csv.DictReader(stream)] == [stage.name for stage in stages]
    assert report.steps == len(stages)
    assert {path.stem for path in run.out.glob("stage-*")} == {f"stage-{stage.name}" for stage in stages[:-1]}

    retriever = Lpn(weights=report.weights)
    assert retriever.info["configuration"] == name
    assert retriever.rerank_top == CONFIGURATIONS[name].rerank_top
    assert retriever.network.options.partition == CONFIGURATIONS[name].network.partition
    asked = RetrievalOptions(
        dataset=rendered.root,
        methods=("lpn",),
        set=(f"lpn.weights={report.weights}",),
        out=tmp_path / "results",
        pair_sets=DIRECTIONS,
        workers=0,  # of another process the network would be whole
    )
    found = evaluate_retrievers(asked, Silent())
    (folder,) = found.folders
    for direction in DIRECTIONS:
        values = found.scores(folder)[direction]
        for metric in ("R@1", "R@5", "AP"):
            value = values[metric]
            assert value is not None
            assert np.isfinite(value)

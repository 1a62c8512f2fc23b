"""LPN's training: it learns, and goes on after a kill to the same bytes."""

from __future__ import annotations

import csv
import json
import pickle
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from made_places import TINY, NarrowResNet, made_places
from refusals import Notes, refused
from torch import Tensor

from baselines.lpn.configurations import CONFIGURATIONS
from baselines.lpn.images import as_network_takes_them
from baselines.lpn.retriever import Lpn
from baselines.lpn.training.augmentation import augmented
from baselines.lpn.training.batches import PlaceBatches
from baselines.lpn.training.options import TrainOptions, usual_options
from baselines.lpn.training.schedule import Schedule
from baselines.lpn.training.trainer import LpnTrainer
from baselines.lpn.weights import load_weights
from baselines.options import options_from_dict
from relocbench.errors import ConfigError, MethodError
from relocbench.evaluation.retrieval.training_validation import PlaceValidation, hold_out
from relocbench.retrieval import PlaceData, PlaceImage
from relocbench.training import ConfiguredTrainer, PlaceTrainer, Trainer, TrainingReport, TrainingRun, ValidationScores

CUT_SHORT = "the power went"


def epochs(name: str, each: int = 1) -> dict[str, int]:
    return {stage.name: each for stage in CONFIGURATIONS[name].stages}


def train(
    out: Path,
    name: str = "lpn",
    validate: Any = None,
    data: PlaceData | None = None,
    reporter: Any = None,
    **other: Any,
) -> TrainingReport:
    run = TrainingRun(out, "lpn", "relocbench train lpn", workers=0, **({"reporter": reporter} if reporter else {}))
    options = {**TINY, "configuration": name, "epochs": epochs(name), **other}
    return LpnTrainer().train_places(data or made_places(), validate, options, run)


def cut_after(images: int) -> PlaceData:
    """Data whose reading breaks off after so many images."""
    left = [images]

    def broken(each: PlaceImage) -> PlaceImage:
        def read() -> Any:
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt(CUT_SHORT)
            return each.image.read()

        return replace(each, image=replace(each.image, read=read))

    whole = made_places()
    return replace(whole, images=tuple(broken(each) for each in whole.images))


def rows(path: Path) -> list[Mapping[str, str]]:
    with path.open(newline="") as stream:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(stream)]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """LPN after two steps."""
    return train(tmp_path_factory.mktemp("lpn"), steps_per_epoch=2).weights


# What is learnt


@pytest.mark.usefixtures("without_curves")
def test_only_the_part_classifier_moves_in_its_stage(tmp_path: Path) -> None:
    train(tmp_path, "lpn-rpp", epochs={"uniform": 1, "classifier": 2, "refined": 1})
    uniform, _ = load_weights(tmp_path / "stage-uniform.safetensors")
    classifier, about = load_weights(tmp_path / "stage-classifier.safetensors")
    assert about.configuration == "lpn-rpp (stage classifier)"
    before, after = uniform.state_dict(), classifier.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    assert set(after) - set(before) == {"branches.air.partition.classifier.weight"}


@pytest.mark.thorough
@pytest.mark.usefixtures("without_curves")
def test_it_learns_places_it_can_tell_apart(tmp_path: Path) -> None:
    """Where one training ends depends on the last digits of its sums, which processors round as they like. Of several
    seeds the loss falls to 0.2 to 0.5 of the first one, and 0.6 to 0.9 of the places are found; a guess finds 1/6."""
    data = made_places(6, 4)
    network = {**TINY["network"], "width": 32, "dropout": 0.0}
    first, last, found = [], [], []
    for seed in range(3):
        out = tmp_path / str(seed)
        train(out, data=data, steps_per_epoch=30, batch=4, rate=0.01, backbone_rate=0.01, network=network, seed=seed)
        losses = [float(row["instance"]) for row in rows(out / "log.csv")]
        first.append(losses[0])
        last.append(np.mean(losses[-5:]))
        found.append(
            PlaceValidation(data, ("drone", "satellite"))(Lpn(weights=out / "weights.safetensors")).together["R@1"]
        )
    assert sum(last) < 0.75 * sum(first)
    assert np.mean(found) > 2 / 6


# Going on


@pytest.mark.usefixtures("without_curves")
@pytest.mark.parametrize(
    ("name", "breaks"), [("lpn", (2, 6)), pytest.param("lpn-rpp", (6, 6), marks=pytest.mark.thorough)]
)
def test_going_on_after_a_kill_ends_with_the_same_bytes(tmp_path: Path, name: str, breaks: tuple[int, ...]) -> None:
    """A step reads four images: cut in step 1 and 2, or in step 2 and in step 3, the first of another stage."""
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    more: dict[str, Any] = {"epochs": epochs(name, 2), "checkpoint_every": 1}
    train(whole, name, **more)
    for images_read in breaks:
        with pytest.raises(KeyboardInterrupt, match=CUT_SHORT):
            train(cut, name, data=cut_after(images_read), **more)
    assert (cut / "checkpoint.pt").exists()
    assert not (cut / "MODEL_CARD.md").exists()
    train(cut, name, **more)
    for file in ("weights.safetensors", *(path.name for path in whole.glob("stage-*"))):
        assert (cut / file).read_bytes() == (whole / file).read_bytes()
    assert rows(cut / "log.csv") == rows(whole / "log.csv")


@pytest.mark.usefixtures("without_curves")
def test_a_finished_training_is_not_begun_again_and_another_one_is_refused(tmp_path: Path) -> None:
    first = train(tmp_path)
    before = first.weights.read_bytes()
    assert train(tmp_path, data=cut_after(0)) == first
    assert first.weights.read_bytes() == before
    with refused(MethodError, "", None, "options.seed", 0, 1):
        train(tmp_path, seed=1)


def test_a_batch_is_a_function_of_the_step_alone_in_any_process() -> None:
    data = made_places()
    asked = PlaceBatches(data, tiny_options(), 8)
    for step in (5, 2):
        elsewhere = pickle.loads(pickle.dumps(PlaceBatches(data, tiny_options(), 8)))
        for view, tensors in asked[step].items():
            assert all(torch.equal(a, b) for a, b in zip(tensors, elsewhere[step][view], strict=True))


# Validation


class Scores:
    """A validation whose score is told beforehand, call by call."""

    def __init__(self, *scores: float) -> None:
        self.left = list(scores)

    def __call__(self, retriever: Any) -> ValidationScores:
        values = {"R@1": self.left.pop(0)}
        return ValidationScores(values, {"drone-satellite": {**values, "chance R@1": 0.25}}, {"drone-satellite": 8})


@pytest.mark.thorough
def test_the_weights_that_validate_best_in_the_last_stage_are_kept(tmp_path: Path) -> None:
    report = train(tmp_path, "lpn-heatmap", Scores(0.9, 0.2, 0.4, 0.3), epochs={"uniform": 1, "heatmap": 3})
    assert (report.best_step, report.scores.together if report.scores else None) == (3, {"R@1": 0.4})
    network, about = load_weights(report.weights)
    assert network.options.partition == "heatmap"
    assert about.card["step"] == "3"
    assert [row["R@1"] for row in rows(tmp_path / "validation.csv") if row["views"] == "all"] == [
        "0.9",
        "0.2",
        "0.4",
        "0.3",
    ]
    assert (tmp_path / "curves.png").read_bytes()[:4] == b"\x89PNG"
    card = (tmp_path / "MODEL_CARD.md").read_text()
    assert "of step 3, the best in validation" in card
    assert "| drone-satellite | 8 | 40.0 % | 25.0 % |" in card


def test_held_out_places_are_in_one_part_alone() -> None:
    data = made_places(10, 2)
    learnt, held = hold_out(data, 0.2, seed=0)
    names = [{each.image.key.split("/")[1] for each in part.images} for part in (learnt, held)]
    assert (learnt.places, held.places) == (8, 2)
    assert not names[0] & names[1]
    assert len(names[0] | names[1]) == 10
    assert {each.place for each in held.images} == {0, 1}
    with refused(ConfigError, "", None, 2):
        hold_out(made_places(3), 0.1, seed=0)
    with refused(ConfigError, "", None, "street"):
        PlaceValidation(held, ("drone", "street"))


def test_a_trial_says_what_chance_scores_and_when_all_images_look_alike() -> None:
    class Alike:
        def describe(self, images: Any) -> Any:
            return np.ones((len(images), 4))

    scores = PlaceValidation(made_places(5, 2), ("drone", "satellite"))(Alike())
    assert scores.by_conditions["drone-satellite"]["chance R@1"] == pytest.approx(1 / 5)
    assert scores.by_conditions["drone-satellite"]["feature variance"] == 0
    assert "all images are described alike" in scores.messages[0]
    assert scores.pairs == {"drone-satellite": 10, "satellite-drone": 5}


# Starts


@pytest.mark.thorough
@pytest.mark.usefixtures("without_curves")
def test_a_configuration_starts_from_trained_rings(tmp_path: Path, trained: Path) -> None:
    told = Notes()
    report = train(tmp_path / "a", "lpn-heatmap", start=str(trained), reporter=told)
    assert report.steps == 1  # the stage of rings is left out
    assert "network 'lpn' of weights.safetensors (backbone: drawn, no ImageNet)" in "\n".join(told.notes)
    with refused(MethodError, "", None, 4, 5):
        train(tmp_path / "b", "lpn-heatmap", data=made_places(5), start=str(trained))
    with refused(MethodError, "", None, "partition"):
        train(tmp_path / "c", "lpn-branch5", start=str(trained))
    with refused(MethodError, "none.safetensors"):
        train(tmp_path / "d", start="none.safetensors")


@pytest.mark.thorough
def test_a_backbone_from_a_file_is_told_and_learns_at_the_recipes_rates(tmp_path: Path) -> None:
    torch.manual_seed(0)
    path = tmp_path / "resnet18.pth"
    torch.save(NarrowResNet().state_dict(), path)
    report = train(tmp_path / "out", backbone_weights=str(path))
    config = (tmp_path / "out" / "config.yaml").read_text()
    assert "backbone_rate: 0.0001\n" in config
    assert "\nrate: 0.001\n" in config
    assert Lpn(weights=report.weights).info["backbone_start"].startswith("file resnet18.pth, SHA-256 ")
    card = (tmp_path / "out" / "MODEL_CARD.md").read_text()
    assert "backbone not started from known ImageNet weights" in card
    assert "images of 64 instead of 256 pixels" in card


@pytest.mark.usefixtures("without_curves")
def test_the_backbone_of_another_training_can_be_taken(tmp_path: Path, trained: Path) -> None:
    told = Notes()
    report = train(tmp_path / "a", "global-average", backbone_weights=str(trained), rate=1e-9, backbone_rate=1e-9,
                   data=made_places(5), reporter=told)  # fmt: skip
    assert "backbone of 'lpn' after 2 steps on 4 places, file weights.safetensors, SHA-256 " in "\n".join(told.notes)
    assert "(first weights there: drawn, no ImageNet)" in "\n".join(told.notes)
    source, found = (load_weights(path)[0].branch("drone").backbone for path in (trained, report.weights))
    for name, tensor in source.named_parameters():
        assert torch.allclose(found.get_parameter(name), tensor, atol=1e-6), name
    deeper = {**TINY["network"], "backbone": "resnet50"}
    with refused(MethodError, trained):
        train(tmp_path / "b", backbone_weights=str(trained), network=deeper)


@pytest.mark.usefixtures("without_curves")
def test_half_precision_where_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []

    def watched(*given: Any) -> Tensor:
        seen.append(torch.is_autocast_enabled("cpu"))
        return as_network_takes_them(*given)

    monkeypatch.setattr("baselines.lpn.training.loop.as_network_takes_them", watched)
    losses = []
    for chosen in (None, False, True):
        train(tmp_path / str(chosen), mixed_precision=chosen)
        losses.append(float(rows(tmp_path / str(chosen) / "log.csv")[0]["loss"]))
    assert [seen[0], seen[len(seen) // 2], seen[-1]] == [False, False, True]
    assert losses[0] == losses[1] != losses[2]
    assert losses[2] == pytest.approx(losses[0], rel=0.05)


# Options, batches, schedule


def test_usual_options_are_the_configurations() -> None:
    trainer = LpnTrainer()
    assert isinstance(trainer, PlaceTrainer)
    assert isinstance(trainer, ConfiguredTrainer)
    assert not isinstance(trainer, Trainer)
    assert trainer.default_options() == trainer.options_of("lpn")
    for name, system in CONFIGURATIONS.items():
        options = options_from_dict(TrainOptions, trainer.options_of(name))
        assert (options.network, options.loss, options.paired) == (system.network, system.loss, system.paired)
        assert options.stages == system.stages
        json.dumps(trainer.options_of(name))
    with_weights = replace(usual_options("lpn-dwdr"), backbone_weights="x").with_rates()
    assert (with_weights.backbone_rate, with_weights.rate) == (3e-4, 3e-3)


@pytest.mark.parametrize(
    ("other", "names"),
    [
        ({"stepz": 3}, ("stepz",)),
        ({"views": ["drone", "street"]}, ("network.street", "none", "separate", "shared", "views")),
        ({"views": ["drone", "street"], "network": {"street": "shared"}}, ("street",)),
        ({"epochs": {"uniform": 1}}, ("epochs", "uniform", "lpn", "all")),
        ({"configuration": "lpn2"}, ("lpn2",)),
        ({"network": {"partition": "soft"}}, ("network.partition", "soft", "rings", "lpn")),
        ({"loss": {"decorrelation": {"weight": 0.1}}}, ("paired", "loss.decorrelation.weight")),
        ({"paired": True, "batch": 3}, ("batch", 3, "paired")),
        ({"rate": 0}, ("rate", "0.0")),
        ({"flip": 2}, ("flip", "2.0", 0, 1)),
        ({"loss": {"partition": {"tau": 0}}}, ("loss.partition.tau", "0.0")),
    ],
)
def test_options_that_make_no_sense_are_refused(
    tmp_path: Path, other: dict[str, Any], names: tuple[object, ...]
) -> None:
    options = {**TINY, **other, "network": {**TINY["network"], **other.get("network", {})}}
    with refused(ConfigError, "", None, *names):
        LpnTrainer().train_places(made_places(), None, options, TrainingRun(tmp_path, workers=0))
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("without_curves")
def test_views_that_are_left_out_and_places_without_overlap_are_told(tmp_path: Path) -> None:
    told = Notes()
    train(tmp_path, data=made_places(views=("drone", "satellite", "street")), reporter=told)
    assert "4 images of view 'street' are not learnt from" in told.notes[0]
    assert told.notes[1] == "4 places: 4 in drone, 4 in satellite, 4 in all of these views; a guess is right once in 4"
    assert "drawn, no ImageNet" in told.notes[2]


def tiny_options(**other: Any) -> TrainOptions:
    return options_from_dict(TrainOptions, {**TINY, "epochs": {"all": 1}, **other})


def test_every_image_of_a_view_is_seen_once_a_round() -> None:
    data = made_places(4, 3)
    batches = PlaceBatches(data, tiny_options(), 6)
    assert batches.steps_per_epoch == 1
    assert PlaceBatches(data, tiny_options(steps_per_epoch=0), 6).steps_per_epoch == 2  # four satellite images
    drones = [number for step in range(6) for number in batches._numbers(step)["drone"]]
    satellites = [number for step in range(6) for number in batches._numbers(step)["satellite"]]
    assert sorted(drones) == [n for n, each in enumerate(data.images) if each.image.view == "drone"]
    assert len(set(satellites[:4])) == len(set(satellites[4:8])) == 4
    assert {each.shape for each, _ in batches[0].values()} == {torch.Size([2, 3, 64, 64])}


def test_paired_batches_show_the_same_places_and_each_view_leads_half() -> None:
    data = made_places(6, 3)
    batches = PlaceBatches(data, tiny_options(paired=True, batch=4), 20)
    led_by_satellite = []
    for step in range(20):
        numbers = batches._numbers(step)
        assert [data.images[n].place for n in numbers["drone"]] == [data.images[n].place for n in numbers["satellite"]]
        assert torch.equal(batches[step]["drone"][1], batches[step]["satellite"][1])
        led_by_satellite += numbers["satellite"][:2]
    assert len(set(led_by_satellite[:6])) == 6  # a round of the satellite's images


def test_rates_fall_after_two_thirds_of_each_stage_and_rise_in_the_beginning() -> None:
    options = replace(usual_options("lpn-rpp"), epochs={"uniform": 120, "classifier": 60, "refined": 50}, warm_up=4)
    schedule = Schedule(options, 2)
    assert [(s.first, s.last) for s in schedule.stages] == [(0, 240), (240, 360), (360, 460)]
    assert [schedule.stage_at(step) for step in (0, 240, 241, 360, 460)] == [0, 0, 1, 1, 2]
    assert [schedule.factor(step) for step in (0, 1, 4, 159, 160, 239)] == [0.25, 0.5, 1, 1, 0.1, 0.1]
    assert [schedule.factor(step) for step in (240, 244, 319, 320)] == [0.25, 1, 1, 0.1]


def test_augmentation_turns_satellites_alone_and_keeps_bytes_for_a_seed() -> None:
    image = np.full((32, 32, 3), 200, np.uint8)
    options = tiny_options(satellite_turn_deg=45.0)

    def changed(view: str, seed: int) -> Any:
        return augmented(image, view, options, np.random.default_rng(seed))

    assert np.array_equal(changed("satellite", 1), changed("satellite", 1))
    assert (changed("drone", 1) == 200).all()
    assert (changed("satellite", 1) < 200).any()  # corners come in black
    gradient = np.tile(np.arange(32, dtype=np.uint8)[None, :, None], (32, 1, 3))
    seen = {tuple(augmented(gradient, "drone", options, np.random.default_rng(seed))[0, :, 0]) for seed in range(40)}
    assert len(seen) == 2 * (2 * 2 + 1)  # cuts across, each with its mirror image


def test_a_loss_that_is_not_finite_stops_with_what_was_wrong(tmp_path: Path) -> None:
    with refused(MethodError, "", None, "rates"):
        train(tmp_path, steps_per_epoch=6, rate=1e30, backbone_rate=1e30)

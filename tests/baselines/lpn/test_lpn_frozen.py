"""Trainings with a frozen backbone: what is frozen stays, and maps are those that the network makes."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from made_places import TINY, NarrowResNet, made_places
from refusals import refused
from safetensors import safe_open

from baselines.lpn.configurations import CONFIGURATIONS, FROM_ABOVE
from baselines.lpn.images import as_bytes, as_network_takes_them
from baselines.lpn.network import Branch, LpnNetwork
from baselines.lpn.retriever import Lpn
from baselines.lpn.training.augmentation import augmented
from baselines.lpn.training.batches import PlaceBatches
from baselines.lpn.training.cached_maps import MapsOfFrozen
from baselines.lpn.training.initial_weights import initial_network
from baselines.lpn.training.options import TrainOptions
from baselines.lpn.training.trainer import LpnTrainer
from baselines.lpn.weights import load_weights
from baselines.options import options_from_dict
from relocbench.errors import ConfigError, MethodError
from relocbench.progress import Silent
from relocbench.retrieval import PlaceData
from relocbench.training import TrainingReport, TrainingRun

pytestmark = pytest.mark.usefixtures("without_curves")
VERSIONS = {"drone": 2, "satellite": 3}
FROZEN = "branches.air.backbone.", ("conv1", "bn1", "layer1", "layer2", "layer3")


@pytest.fixture(scope="module")
def resnet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of a backbone whose statistics are not those of the beginning."""
    torch.manual_seed(0)
    network = NarrowResNet()
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.get_buffer("running_mean").normal_(0.0, 0.01)
            module.get_buffer("running_var").fill_(0.05)
    path = tmp_path_factory.mktemp("weights") / "resnet18.pth"
    torch.save(network.state_dict(), path)
    return path


def given(resnet: Path, name: str = "lpn", **other: Any) -> dict[str, Any]:
    epochs = {stage.name: 1 for stage in CONFIGURATIONS[name].stages}
    frozen = {"frozen": "layer3", "versions": VERSIONS, "backbone_weights": str(resnet)}
    return {**TINY, "configuration": name, "epochs": epochs, **frozen, **other}


def train(
    out: Path, resnet: Path, name: str = "lpn", data: PlaceData | None = None, workers: int = 0, **other: Any
) -> TrainingReport:
    run = TrainingRun(out, "lpn", "relocbench train lpn", workers=workers)
    return LpnTrainer().train_places(data or made_places(), None, given(resnet, name, **other), run)


def options_of(resnet: Path, **other: Any) -> TrainOptions:
    defaults = LpnTrainer().options_of("lpn")
    network = {**defaults["network"], **TINY["network"], **other.pop("network", {})}
    return options_from_dict(TrainOptions, {**defaults, **given(resnet, **other), "network": network}).with_rates()


def network_of(options: TrainOptions) -> LpnNetwork:
    return initial_network(options, options.stages[0], 0, 4)


@pytest.mark.parametrize("blocks", [0, 1])
def test_cached_maps_are_what_the_network_makes_of_the_augmented_images(
    tmp_path: Path, resnet: Path, blocks: int
) -> None:
    data, options = made_places(), options_of(resnet, frozen_blocks=blocks)
    network = network_of(options).train()
    maps = MapsOfFrozen(network, data, options, tmp_path, torch.device("cpu")).cached(Silent())
    assert all(module.training for module in network.modules())
    again = pickle.loads(pickle.dumps(maps))
    images = [each for each in data.images if each.image.view == "satellite"]
    square = augmented(images[2].image.read(), "satellite", options, np.random.default_rng([0, 2, 1]))
    branch = network.eval().branch("satellite")
    with torch.no_grad():
        x = as_network_takes_them(as_bytes([square]), torch.device("cpu"))
        expected = branch.map_after(x, blocks)
        assert torch.allclose(again.read("satellite", [(2, 1)]).float(), expected, rtol=2e-3, atol=1e-4)
        assert torch.equal(branch.last_map_from(expected, blocks), branch.last_map_from(branch.map_after(x, 0), 0))
    assert not torch.equal(again.read("satellite", [(2, 0)]), again.read("satellite", [(2, 1)]))


def test_a_batch_has_maps_of_its_own_images_for_every_order_of_images(tmp_path: Path, resnet: Path) -> None:
    """Without augmentation all versions of an image are one, so that a row tells which image it is of."""
    data = made_places(6)
    mixed = PlaceData(data.places, data.images[::-1], data.described)
    options = options_of(resnet, pad=0, flip=0, satellite_turn_deg=0, paired=True, batch=4)
    network = initial_network(options, options.stages[0], 0, 6)
    batches = PlaceBatches(mixed, options, 4)
    batches.maps = MapsOfFrozen(network, mixed, options, tmp_path, torch.device("cpu")).cached(Silent())
    plain = PlaceBatches(mixed, options, 4)
    for step in range(4):
        for view, (maps, places) in batches[step].items():
            pixels, same = plain[step][view]
            with torch.no_grad():
                expected = network.eval().branch(view).map_after(as_network_takes_them(pixels, torch.device("cpu")), 0)
            assert torch.equal(places, same)
            assert torch.allclose(maps.float(), expected, rtol=2e-3, atol=1e-3)


@pytest.mark.parametrize("name", [name for name in FROM_ABOVE if name != "lpn-dmli"])
def test_every_system_learns_behind_a_frozen_backbone_that_stays(tmp_path: Path, resnet: Path, name: str) -> None:
    train(tmp_path, resnet, name, frozen_blocks=1 if "attention" in name else 0, rate=0.01, backbone_rate=0.01)
    trained = load_weights(tmp_path / "weights.safetensors")[0].state_dict()
    first = torch.load(resnet, weights_only=True)
    prefix, parts = FROZEN
    kept = (*parts, "layer4") if "attention" in name else parts
    for tensor_name, tensor in first.items():
        if tensor_name.startswith(kept):
            assert torch.equal(trained[prefix + tensor_name], tensor), tensor_name
        elif tensor_name == "layer4.0.conv1.weight":
            assert not torch.equal(trained[prefix + tensor_name], tensor)
    card = (tmp_path / "MODEL_CARD.md").read_text()
    assert "backbone up to layer3" in card
    assert "2 of each drone image, 3 of each satellite image" in card


@pytest.mark.thorough
def test_the_same_bytes_whatever_reads_the_batches_and_wherever_the_maps_are(tmp_path: Path, resnet: Path) -> None:
    """The folder of the first training serves the second, another serves the third."""
    shared = str(tmp_path / "maps")
    a = train(tmp_path / "a", resnet, maps=shared, epochs={"all": 2})
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "maps").iterdir()}
    assert len(files) == 5
    b = train(tmp_path / "b", resnet, maps=shared, epochs={"all": 2}, workers=1)
    c = train(tmp_path / "c", resnet, epochs={"all": 2})
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "maps").iterdir()} == files
    assert {path.name for path in (tmp_path / "c" / "maps").iterdir()} == {path.name for path in files}
    assert a.weights.read_bytes() == b.weights.read_bytes() == c.weights.read_bytes()


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["lpn", "lpn-rpp"])
def test_going_on_after_a_kill_ends_with_the_same_bytes(
    tmp_path: Path, resnet: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    epochs = {stage.name: 2 for stage in CONFIGURATIONS[name].stages}
    whole = train(tmp_path / "whole", resnet, name, epochs=epochs)
    with monkeypatch.context() as patch:
        real = PlaceBatches.__getitem__

        def broken(self: PlaceBatches, step: int) -> Any:
            if step == 3 or (name == "lpn" and step == 1):
                raise KeyboardInterrupt
            return real(self, step)

        patch.setattr(PlaceBatches, "__getitem__", broken)
        with pytest.raises(KeyboardInterrupt):
            train(tmp_path / "cut", resnet, name, epochs=epochs)
    train(tmp_path / "cut", resnet, name, epochs=epochs)
    assert (tmp_path / "cut" / "weights.safetensors").read_bytes() == whole.weights.read_bytes()


@pytest.mark.thorough
def test_trainings_that_see_other_maps_do_not_share_files(tmp_path: Path, resnet: Path) -> None:
    def names(data: PlaceData | None = None, **other: Any) -> set[str]:
        options = options_of(resnet, **other)
        maps = MapsOfFrozen(network_of(options), data or made_places(), options, tmp_path, torch.device("cpu"))
        return {path.name for paths in maps.cached(Silent()).files.values() for path in paths}

    first = names()
    assert names(seed=1, rate=0.5) == first
    assert names(versions={"drone": 1, "satellite": 4}) & first
    for other in ({"pad": 3}, {"flip": 0.0}, {"size": 80}, {"frozen_blocks": 1}):
        assert not names(**other) & first
    assert not names(PlaceData(4, made_places().images, (("made", "1" * 12),))) & first


def test_mistakes_are_told_in_one_line(tmp_path: Path, resnet: Path) -> None:
    cases: tuple[tuple[dict[str, Any], tuple[object, ...]], ...] = (
        ({"maps_limit": 0.00001}, (2, "drone", 3, "satellite", "0.00 GB")),
        ({"backbone_weights": ""}, ("frozen", "layer3", "backbone_weights", "start")),
        ({"frozen": "nothing", "frozen_blocks": 1}, ("frozen_blocks", 1, 0)),
        ({"frozen_blocks": 2}, ("frozen_blocks", 2, 0, 1)),
        ({"versions": {"drone": 0}}, ("versions", 1)),
        ({"frozen": "layer2"}, ("frozen",)),
    )
    for other, names in cases:
        with refused(ConfigError, "", None, *names):
            train(tmp_path / "out", resnet, **other)
        assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())
    shared = tmp_path / "maps"
    train(tmp_path / "a", resnet, maps=str(shared))
    damaged = min(shared.iterdir())
    damaged.write_bytes(damaged.read_bytes()[:-10])
    with refused(MethodError, damaged):
        train(tmp_path / "b", resnet, maps=str(shared))
    with safe_open(tmp_path / "a" / "weights.safetensors", "pt") as file:
        assert list(file.keys())


def test_a_decorrelation_that_nothing_would_learn_from_is_refused(tmp_path: Path, resnet: Path) -> None:
    with refused(ConfigError, "", None, "frozen_blocks", 1, "loss.decorrelation.weight"):
        train(tmp_path / "out", resnet, "lpn-dwdr", frozen_blocks=1)


@pytest.mark.thorough
def test_retrievers_that_share_maps_answer_as_they_do_alone(
    tmp_path: Path, resnet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two systems behind one frozen backbone, and one whose backbone is another."""
    monkeypatch.setattr("baselines.lpn.shared_maps._kept", {})
    computed: list[int] = []
    real = Branch.map_after

    def counted(self: Branch, images: torch.Tensor, blocks: int) -> torch.Tensor:
        computed.append(len(images))
        return real(self, images, blocks)

    monkeypatch.setattr(Branch, "map_after", counted)
    images = [each.image for each in made_places().images]
    a = train(tmp_path / "a", resnet).weights
    b = train(tmp_path / "b", resnet, "global-average", seed=1).weights
    c = train(tmp_path / "c", resnet, frozen="nothing").weights
    alone = [Lpn(weights=path, batch=5).describe(images) for path in (a, b, c)]
    for number, (path, expected) in enumerate(zip((a, b, c), alone, strict=True)):
        computed.clear()
        shared = Lpn(weights=path, batch=5, shared_blocks=0)
        assert np.allclose(shared.describe(images), expected, atol=1e-5)
        assert sum(computed) == (0 if number == 1 else 2 * len(images))
    with refused(ConfigError, "", None, 0, 1):
        Lpn(weights=a, shared_blocks=2)

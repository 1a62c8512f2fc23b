"""The pose network's training: the same batches for all, the same bytes after a kill, one line for each mistake."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from made_views import TINY_POSE_NET, MadeViews, tiny_encoder
from refusals import refused

from baselines.gn_net.weights import load_weights as load_encoder
from baselines.lm_reloc.euler import pose_of
from baselines.lm_reloc.tracker import LmReloc
from baselines.lm_reloc.training.trainer import PoseNetTrainer
from baselines.lm_reloc.weights import load_weights, read_card
from relocbench.errors import ConfigError, MethodError
from relocbench.methods.trainers import chosen_options, trainer_named
from relocbench.tracking import Tracker
from relocbench.training import Trainer, TrainingReport, TrainingRun, ValidationScores

CUT_SHORT = "the power went"


@pytest.fixture(scope="module")
def encoder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_encoder(tmp_path_factory.mktemp("encoder"))


def train(out: Path, encoder: Path, data: Any = None, validate: Any = None, **changed: Any) -> TrainingReport:
    run = TrainingRun(out, "pose-net", "relocbench train pose-net", workers=0)
    options = {**TINY_POSE_NET, "encoder_weights": str(encoder), **changed}
    return PoseNetTrainer().train(data or MadeViews(), validate, options, run)


class Killed(MadeViews):
    """Breaks off when the pose of the pair number ``after`` is asked."""

    def __init__(self, after: int) -> None:
        super().__init__()
        self._left = after

    def posed(self, index: int) -> Any:
        self._left -= 1
        if self._left < 0:
            raise KeyboardInterrupt(CUT_SHORT)
        return super().posed(index)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(stream)]


def validated(tracker: Tracker) -> ValidationScores:
    assert isinstance(tracker, LmReloc)
    scores = {"t_auc@0.5m": 0.25}
    return ValidationScores(scores, {"dry -> dry": scores}, {"dry -> dry": 3})


@pytest.mark.thorough
@pytest.mark.parametrize("depth", [False, True])
def test_going_on_after_a_kill_ends_with_the_same_bytes(tmp_path: Path, encoder: Path, depth: bool) -> None:
    network = {**TINY_POSE_NET["network"], "depth": depth}
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    train(whole, encoder, validate=validated, network=network)
    with pytest.raises(KeyboardInterrupt, match=CUT_SHORT):
        train(cut, encoder, Killed(7), validated, network=network)  # in step 4, after the checkpoint of step 2
    assert (cut / "checkpoint.pt").exists()
    report = train(cut, encoder, validate=validated, network=network)
    assert report.steps == 6
    assert (cut / "weights.safetensors").read_bytes() == (whole / "weights.safetensors").read_bytes()
    assert rows(cut / "log.csv") == rows(whole / "log.csv")


@pytest.mark.thorough
def test_the_loss_falls_and_only_what_is_trained_changes(tmp_path: Path, encoder: Path) -> None:
    train(tmp_path, encoder, steps=60, log_every=20, checkpoint_every=60, learning_rate=1e-2, validate_every=60)
    losses = [float(row["loss"]) for row in rows(tmp_path / "log.csv")]
    assert losses[-1] < losses[0]
    net = load_weights(tmp_path / "weights.safetensors")
    for name, value in load_encoder(encoder).state_dict().items():
        assert torch.equal(net.encoder.state_dict()[name], value)


def test_batches_have_both_directions_and_their_depth(tmp_path: Path, encoder: Path) -> None:
    from baselines.lm_reloc.network import PoseNetwork
    from baselines.lm_reloc.training.batches import Batches
    from baselines.lm_reloc.training.options import TrainOptions
    from baselines.options import options_from_dict

    frozen = load_encoder(encoder)
    values = {**TINY_POSE_NET, "network": {**TINY_POSE_NET["network"], "depth": True}}
    values["network"]["encoder"] = json.loads(json.dumps(frozen.options.__dict__))
    options = options_from_dict(TrainOptions, values)
    batches = Batches(MadeViews(), options, PoseNetwork(options.network))
    batch, again = batches[3], Batches(MadeViews(), options, PoseNetwork(options.network))[3]
    assert all(torch.equal(a, b) for a, b in zip(batch, again, strict=True))
    assert batch.maps.shape == (2, 2, 8, 4, 4)
    assert batch.maps.dtype == torch.float16
    assert batch.depth[:, :, 1].any()
    for forth, back in batch.true.double().numpy():
        assert np.abs(pose_of(forth) @ pose_of(back) - np.eye(4)).max() < 1e-5
        assert np.abs(forth).max() > 0.01


def test_what_is_left_behind_tells_how_to_do_it_again(tmp_path: Path, encoder: Path) -> None:
    report = train(tmp_path, encoder, validate=validated)
    card = (tmp_path / "MODEL_CARD.md").read_text()
    assert "# pose-net" in card
    assert "| encoder | weights with SHA-256 `" in card
    assert "| dry -> dry | 3 | 25.0 % |" in card
    inside = read_card(report.weights)
    assert inside["name"] == "pose-net"
    assert f"`{inside['encoder']}`" in card
    assert (tmp_path / "curves.png").read_bytes()[:4] == b"\x89PNG"
    # The written options are taken by --config, and the training is then found to be finished.
    written = chosen_options(PoseNetTrainer(), str(tmp_path / "config.yaml"), [])
    assert "encoder" not in yaml.safe_load((tmp_path / "config.yaml").read_text())["network"]
    run = TrainingRun(tmp_path, "pose-net", "relocbench train pose-net", workers=0)
    assert PoseNetTrainer().train(Killed(0), validated, written, run).steps == 6


def test_mistakes_are_one_line(tmp_path: Path, encoder: Path) -> None:
    with refused(ConfigError, "", None, "stepz"):
        train(tmp_path, encoder, stepz=3)
    with refused(ConfigError, "", None, "network.side", 30, 8):
        train(tmp_path, encoder, network={**TINY_POSE_NET["network"], "side": 30})
    with refused(ConfigError, "", None, "turn_deg", "[0.0, 90.0, 0.0]"):
        train(tmp_path, encoder, turn_deg=[0, 90, 0])
    with refused(MethodError, "nothing.safetensors"):
        train(tmp_path, tmp_path / "nothing.safetensors")
    train(tmp_path / "done", encoder)
    with refused(MethodError, "", None, "options.seed", 0, 1):
        train(tmp_path / "done", encoder, seed=1)
    other = load_encoder(encoder)
    from baselines.gn_net.weights import save_weights

    with torch.no_grad():
        next(iter(other.parameters())).add_(1.0)
    save_weights(tmp_path / "other.safetensors", other, {})
    with refused(MethodError, "", None, "options.encoder_weights"):
        train(tmp_path / "done", tmp_path / "other.safetensors")


def test_it_is_a_trainer_by_its_dotted_name() -> None:
    found = trainer_named("baselines.lm_reloc.training.trainer:PoseNetTrainer")
    assert isinstance(found, Trainer)
    assert "encoder" not in found.default_options()["network"]

"""What is the pose network's own in a training: network, optimiser, learning rate, loss, how its weights are tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from baselines.gn_net.network import FeatureNet
from baselines.lm_reloc.loss import pose_loss
from baselines.lm_reloc.network import PoseNetwork
from baselines.lm_reloc.tracker import LmReloc
from baselines.lm_reloc.training.batches import Batch, Batches
from baselines.lm_reloc.training.curves import draw_curves
from baselines.lm_reloc.training.options import TrainOptions
from baselines.lm_reloc.weights import save_weights
from baselines.options import options_to_dict
from baselines.training.card import Description, weights_card
from baselines.training.ema import EmaNetwork
from baselines.training.log import Row
from baselines.training.loop import TrainingLoop
from baselines.training.random_streams import generator
from baselines.training.schedule import warmed_cosine
from relocbench.pages import render
from relocbench.training import PosedTrainingData, TrainingRun, Validate

NAME = "pose-net"
_INITIAL_WEIGHTS = 0


class Training(TrainingLoop[TrainOptions, PoseNetwork, Batch]):
    """One training of the pose network.

    Args:
        data: pairs to learn from.
        validate: tracks the validation pairs; None: no validation.
        options: see there; the encoder's shape is that of ``encoder``.
        encoder: the network that encodes images.
        encoder_digest: SHA-256 of the file that it was read from.
        run: folder, device, and whom to report to.

    Raises:
        MethodError: the folder holds another training, or the device cannot be used.
    """

    validation_columns = ("conditions", "pairs")

    def __init__(
        self,
        data: PosedTrainingData,
        validate: Validate | None,
        options: TrainOptions,
        encoder: FeatureNet,
        encoder_digest: str,
        run: TrainingRun,
    ) -> None:
        self._data, self._encoder, self._encoder_digest = dict(data.describe()), encoder, encoder_digest
        options = replace(options, network=replace(options.network, encoder=encoder.options))
        described = {**options_to_dict(options), "encoder_weights": encoder_digest}
        identity = {"name": NAME, "options": described, "data": self._data}
        batches = Batches(data, options, self._new_network(options))
        super().__init__(NAME, options, run, batches, options.steps, options.validate_every, validate, identity)
        self.resume()

    def build(self, step: int) -> None:
        options = self.options
        self.network = self._new_network(options).to(self.device).train()
        trained = [parameter for parameter in self.network.parameters() if parameter.requires_grad]
        self.optimiser = torch.optim.AdamW(trained, lr=options.learning_rate, weight_decay=options.weight_decay)
        self.ema = EmaNetwork(self.network, options.ema) if options.ema > 0 else None

    def learning_rate(self, step: int) -> float:
        """The learning rate of a step, counted from 0."""
        o = self.options
        return warmed_cosine(step, o.steps, o.warm_up, o.learning_rate, o.final_rate)

    def set_rates(self) -> dict[str, float]:
        rate = self.learning_rate(self.step)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        return {"learning_rate": rate}

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Both directions of all pairs pass the network together."""
        batch = batch.to(self.device)
        pairs = len(batch.true)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.half):
            described = self.network.describe(batch.maps.float().flatten(0, 1), batch.seen.flatten(0, 1))
            ref, query = described.unflatten(0, (pairs, 2)).unbind(1)
            both = torch.cat([ref, query]), torch.cat([query, ref]), torch.cat(batch.depth.unbind(1))
            predicted = self.network(*both)
        value = pose_loss(predicted.float(), torch.cat(batch.true.unbind(1)), self.options.translation_weight)
        return value.total, {"rotation_rad": value.rotation, "translation_m": value.translation}

    @property
    def remedy(self) -> str:
        return f"a lower learning_rate (now {self.options.learning_rate:g})"

    def save_weights(self, path: Path, network: PoseNetwork, step: int, scores: Mapping[str, Any] | None) -> None:
        options = self.options
        card = weights_card(
            self._data.items(), options.seed, step, options.steps, scores, name=NAME, encoder=self._encoder_digest
        )
        save_weights(path, network, card)

    def written_options(self) -> dict[str, Any]:
        """Without the encoder's shape, which its weights decide."""
        values = super().written_options()
        del values["network"]["encoder"]
        return values

    def on_new_best(self) -> None:
        """Leave the best weights in the folder while the training goes on."""
        assert self.best is not None
        self.save_weights(self.weights, self.kept_network, self.best.step, self.best.scores)

    def method_with(self, weights: Path) -> LmReloc:
        """The alignment that starts from the prediction: what a prediction is worth is whether that converges."""
        return LmReloc(pose_weights=weights, device=str(self.device))

    def draw_curves(self, path: Path, log: Sequence[Row], validation: Sequence[Row]) -> None:
        draw_curves(path, log, validation)

    def describe(self) -> Description:
        options = self.options
        parameters = self.network.parameters_count
        frozen = self.network.encoder.parameters_count
        return Description(
            title=NAME,
            about=render(
                __name__, "about.md.j2", name=NAME, network=options.network, parameters=parameters, frozen=frozen
            ),
            data=list(self._data.items()),
            facts={"encoder": f"weights with SHA-256 `{self._encoder_digest}`, not trained"},
            steps=f"{options.steps}, of {options.batch} pairs in both directions",
            groups="reference -> query | pairs",
            validated_by="The scores are those of `lm-reloc`, which aligns features from the predicted pose.",
        )

    def _new_network(self, options: TrainOptions) -> PoseNetwork:
        network = PoseNetwork(options.network, generator(options.seed, _INITIAL_WEIGHTS))
        network.encoder.load_state_dict(self._encoder.state_dict())
        return network

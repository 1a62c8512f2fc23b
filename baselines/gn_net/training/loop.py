"""What is GN-Net's own in a training: network, optimiser, learning rate, loss, and how its weights are tried."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from baselines.efficientnet_lite import IMAGENET_WEIGHTS, EfficientNetLite0, load_imagenet
from baselines.gn_net.encoder import EfficientNetEncoder
from baselines.gn_net.losses.pose import SeenPoints
from baselines.gn_net.losses.total import pose_loss, total_loss
from baselines.gn_net.network import FeatureNet
from baselines.gn_net.sampling import level_coordinates
from baselines.gn_net.tracker import GnNet
from baselines.gn_net.training.batches import Batch, Batches
from baselines.gn_net.training.curves import draw_curves
from baselines.gn_net.training.options import IMAGENET, TrainOptions
from baselines.gn_net.weights import load_weights, save_weights
from baselines.training.card import Description, weights_card
from baselines.training.ema import EmaNetwork
from baselines.training.log import Row
from baselines.training.loop import TrainingLoop
from baselines.training.random_streams import generator
from relocbench.errors import MethodError
from relocbench.pages import render
from relocbench.training import TrainingData, TrainingRun, Validate

_INITIAL_WEIGHTS, _LOSS, _START_POSES = range(3)


class Training(TrainingLoop[TrainOptions, FeatureNet, Batch]):
    """One training of GN-Net or a variant of it, whose weights are validated as those of ``tracker``.

    Raises:
        MethodError: the folder holds another training, the device cannot be used, or the weights to start from are
            missing, damaged or of another network.
    """

    validation_columns = ("conditions", "pairs")

    def __init__(
        self,
        data: TrainingData,
        validate: Validate | None,
        options: TrainOptions,
        run: TrainingRun,
        tracker: type[GnNet],
    ) -> None:
        self._data, self._tracker = dict(data.describe()), tracker
        identity = {"name": tracker.name, "options": asdict(options), "data": self._data}
        self._start = read_start(options)
        if self._start:
            identity["start"] = self._start.digest
        super().__init__(
            tracker.name,
            options,
            run,
            Batches(data, options),
            options.steps,
            options.validate_every,
            validate,
            identity,
        )
        self.resume()

    def build(self, step: int) -> None:
        options = self.options
        self.network = FeatureNet(options.network, generator(options.seed, _INITIAL_WEIGHTS))
        trunk = _pretrained(self.network) if options.encoder_weights == IMAGENET else None
        if trunk and not step:
            load_imagenet(trunk)
        if self._start and not step:
            self.network.load_state_dict(self._start.network.state_dict())
        self.network.to(memory_format=torch.channels_last).to(self.device).train()
        pretrained = set(trunk.parameters()) if trunk else set()
        groups = [{"params": [p for p in self.network.parameters() if p not in pretrained], "share": 1.0}]
        if trunk:
            groups.append({"params": list(trunk.parameters()), "share": options.encoder_rate})
        self.optimiser = torch.optim.AdamW(
            groups,
            lr=options.learning_rate,
            weight_decay=options.weight_decay,
        )
        self.ema = EmaNetwork(self.network, options.ema) if options.ema > 0 else None

    def learning_rate(self, step: int) -> float:
        """The learning rate of a step, counted from 0."""
        o = self.options
        return warmed_cosine(step, o.steps, o.warm_up, o.learning_rate, o.final_rate)

    def set_rates(self) -> dict[str, float]:
        rate = self.learning_rate(self.step)
        for group in self.optimiser.param_groups:
            group["lr"] = rate * group["share"]
        return {"learning_rate": rate}

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Both images of all pairs pass the network together, so that batch normalisation sees all weathers at once."""
        batch = batch.to(self.device)
        images = torch.cat([batch.images_ref, batch.images_query]).contiguous(memory_format=torch.channels_last)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.half):
            maps, confidences = self.network.with_confidences(images)
        pairs, finest = len(batch.mask), self.options.network.finest
        features = [m.float() for m in maps]
        ref, query = [m[:pairs] for m in features], [m[pairs:] for m in features]
        value = total_loss(
            ref,
            query,
            level_coordinates(batch.u_ref, finest),
            level_coordinates(batch.u_query, finest),
            batch.mask,
            self.options.loss,
            generator(self.options.seed, _LOSS, self.step),
            level_coordinates(batch.u_still, finest),
        )
        if self.options.loss.pose.weight == 0:
            return value.total, value.parts
        known = batch.mask & batch.known
        seen = SeenPoints(batch.X_ref, batch.u_ref, batch.u_query, known, batch.intrinsics, batch.T_query_ref)
        starts = generator(self.options.seed, _START_POSES, self.step)
        confident = [each[:pairs].float() for each in confidences]
        posed = pose_loss(ref, query, seen, self.options.loss, finest, starts, confident)
        return value.total + posed.total, {**value.parts, **posed.parts}

    @property
    def remedy(self) -> str:
        return f"a lower learning_rate (now {self.options.learning_rate:g})"

    def save_weights(self, path: Path, network: FeatureNet, step: int, scores: Mapping[str, Any] | None) -> None:
        options = self.options
        card = weights_card(self._data.items(), options.seed, step, options.steps, scores, name=self._tracker.name)
        save_weights(path, network, card)

    def on_new_best(self) -> None:
        """Leave the best weights in the folder while the training goes on."""
        assert self.best is not None
        self.save_weights(self.weights, self.kept_network, self.best.step, self.best.scores)

    def method_with(self, weights: Path) -> GnNet:
        return self._tracker(weights=weights, device=str(self.device))

    def draw_curves(self, path: Path, log: Sequence[Row], validation: Sequence[Row]) -> None:
        draw_curves(path, log, validation)

    def _first_weights(self) -> dict[str, str]:
        """For the card."""
        if self._start:
            return {"first weights": f"{Path(self.options.start).name}, SHA-256 {self._start.digest}"}
        return {"encoder's first weights": IMAGENET_WEIGHTS} if self.options.encoder_weights == IMAGENET else {}

    def describe(self) -> Description:
        options, name = self.options, self._tracker.name
        return Description(
            title=name,
            about=render(
                __name__,
                "about.md.j2",
                name=name,
                network=options.network,
                parameters=self.network.parameters_count,
            ),
            data=list(self._data.items()),
            facts=self._first_weights(),
            steps=f"{options.steps}, of {options.batch} pairs of {options.crop}x{options.crop} pixels",
            groups="reference -> query | pairs",
        )


@dataclass(frozen=True, eq=False)
class _Start:
    """The weights of an earlier training."""

    network: FeatureNet
    digest: str
    """SHA-256 of their file"""


def read_start(options: TrainOptions) -> _Start | None:
    """The weights that a training starts from, if options name a file.

    Raises:
        MethodError: it is missing, damaged, or of a network with other options.
    """
    if not options.start:
        return None
    path = Path(options.start)
    network = load_weights(path)
    asked, found = asdict(options.network), asdict(network.options)
    if different := [f"{name} {found[name]}, not {asked[name]}" for name in asked if asked[name] != found[name]]:
        raise MethodError(f"cannot start from it: its network has {'; '.join(different)}", path)
    return _Start(network, sha256(path.read_bytes()).hexdigest())


def _pretrained(network: FeatureNet) -> EfficientNetLite0:
    """The part of a network that starts from published weights."""
    if not isinstance(network.encoder, EfficientNetEncoder):
        raise TypeError("only the encoder efficientnet-lite0 has published weights")
    return network.encoder.trunk


def warmed_cosine(step: int, steps: int, warm_up: int, rate: float, final_rate: float) -> float:
    """The learning rate of a step, counted from 0: a linear rise to ``rate``, then half a cosine (SGDR, ICLR 2017).

    ``final_rate`` is the last one as a share of the highest.
    """
    if step < warm_up:
        return rate * (step + 1) / warm_up
    done = (step - warm_up) / max(steps - 1 - warm_up, 1)
    return rate * (final_rate + (1 - final_rate) * 0.5 * (1 + math.cos(math.pi * done)))

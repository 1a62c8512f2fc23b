"""The steps of a training, from the first or from where a checkpoint stands to the last."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from baselines.files import write_whole
from baselines.gn_net.losses import total_loss
from baselines.gn_net.network import FeatureNet
from baselines.gn_net.sampling import level_coordinates
from baselines.gn_net.tracker import GnNet
from baselines.gn_net.training.batches import Batch, Batches
from baselines.gn_net.training.card import model_card, weights_card
from baselines.gn_net.training.curves import draw_curves
from baselines.gn_net.training.ema import MeanNet
from baselines.gn_net.training.options import TrainOptions
from baselines.gn_net.weights import save_weights
from baselines.options import options_to_dict
from baselines.training.checkpoint import Best, Checkpoint, load_checkpoint, save_checkpoint
from baselines.training.checkpoint_content import check_state, restore_network, restore_optimiser
from baselines.training.device import half_precision
from baselines.training.loading import batches_in_order
from baselines.training.log import TIMED, Table, Window
from baselines.training.step import descend
from relocbench.errors import MethodError
from relocbench.training import TrainingData, TrainingReport, TrainingRun, Validate

_FIRST_WEIGHTS, _LOSS = range(2)


class Training:
    """One training in one folder.

    Args:
        tracker: what the weights are validated as.

    Raises:
        MethodError: the folder holds another training.
    """

    def __init__(
        self,
        data: TrainingData,
        validate: Validate | None,
        options: TrainOptions,
        run: TrainingRun,
        tracker: type[GnNet],
        device: torch.device,
    ) -> None:
        self.options, self.run, self.device = options, run, device
        self._validate, self._tracker = validate, tracker
        self._data = dict(data.describe())
        self.batches = Batches(data, options)
        self._identity: dict[str, Any] = {
            "name": tracker.name,
            "options": options_to_dict(options),
            "data": self._data,
            "validated": validate is not None,
        }
        self.net = FeatureNet(options.network, _generator(options.seed, _FIRST_WEIGHTS))
        self.net.to(memory_format=torch.channels_last).to(device).train()
        self.optimiser = torch.optim.AdamW(
            self.net.parameters(), lr=options.learning_rate, weight_decay=options.weight_decay
        )
        self.mean = MeanNet(self.net, options.ema) if options.ema > 0 else None
        self.step, self.seconds, self.window = 0, 0.0, Window()
        self.best: Best | None = None
        self._resume()
        self.log = Table(run.out / "log.csv", self.step)
        self.validation = Table(run.out / "validation.csv", self.step)

    def run_to_end(self) -> TrainingReport:
        """All steps that are left.

        Raises:
            MethodError: the loss or its gradient is not finite any more.
        """
        options, since = self.options, time.monotonic() - self.seconds
        left = options.steps - self.step
        if left and self.step:
            self.run.reporter.note(f"goes on after step {self.step} of {options.steps}")
        batches = batches_in_order(self.batches, self.step, options.steps, self.run.workers, self.device.type == "cuda")
        with self.run.reporter.stage(f"training {self._tracker.name}", left) as advance:
            for batch in batches if left else ():
                self.one_step(batch)
                self.seconds = time.monotonic() - since
                if self.step % options.log_every == 0 or self.step == options.steps:
                    self.log.add({"step": self.step, TIMED: self.seconds, **self.window.take()})
                validates = self.step % options.validate_every == 0 or self.step == options.steps
                if validates:
                    self._keep_if_better()
                    draw_curves(self.run.out / "curves.png", self.log.rows, self.validation.rows)
                    self.seconds = time.monotonic() - since
                if validates or self.step % options.checkpoint_every == 0:
                    self._save()
                advance(1)
        return self._finish()

    def learning_rate(self, step: int) -> float:
        """The learning rate of a step, counted from 0: a ramp, then half a cosine."""
        options = self.options
        if step < options.warm_up:
            return options.learning_rate * (step + 1) / options.warm_up
        done = (step - options.warm_up) / max(options.steps - 1 - options.warm_up, 1)
        low = options.final_rate
        return options.learning_rate * (low + (1 - low) * 0.5 * (1 + math.cos(math.pi * done)))

    @property
    def kept_net(self) -> FeatureNet:
        """What is validated and kept: the running mean, or the network itself."""
        return self.mean.net if self.mean else self.net

    def one_step(self, batch: Batch) -> None:
        """Learn from a batch. Raises MethodError where the loss or its gradient is not finite."""
        rate = self.learning_rate(self.step)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        loss, parts = self._loss(batch.to(self.device))
        remedy = f"a lower learning_rate (now {self.options.learning_rate:g})"
        values = descend(
            loss, parts, self.net.parameters(), self.optimiser, self.options.clip,
            step=self.step + 1, remedy=remedy, out=self.run.out,
        )  # fmt: skip
        self.step += 1
        if self.mean:
            self.mean.follow(self.net, self.step)
        self.window.add({"learning_rate": rate, **values})

    def _loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Both images of all pairs go through the network together: batch normalisation sees all weathers at once."""
        images = torch.cat([batch.images_ref, batch.images_query]).contiguous(memory_format=torch.channels_last)
        half = half_precision(self.options.mixed_precision, self.device)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=half):
            maps = self.net(images)
        pairs = len(batch.mask)
        features = [m.float() for m in maps]
        value = total_loss(
            [m[:pairs] for m in features],
            [m[pairs:] for m in features],
            level_coordinates(batch.u_ref, self.options.network.finest),
            level_coordinates(batch.u_query, self.options.network.finest),
            batch.mask,
            self.options.loss,
            _generator(self.options.seed, _LOSS, self.step),
        )
        return value.total, value.parts

    def _keep_if_better(self) -> None:
        """Track the validation pairs with the weights as a user would, from a file."""
        if self._validate is None:
            return
        candidate = self.run.out / "candidate.safetensors"
        save_weights(candidate, self.kept_net, {})
        scores = self._validate(self._tracker(weights=candidate, device=str(self.device)))
        candidate.unlink()
        for message in scores.messages:
            self.run.reporter.note(f"validation at step {self.step}: {message}")
        score = float(np.mean(list(scores.together.values())))
        told = ", ".join(f"{name} {100 * value:.1f} %" for name, value in scores.together.items())
        self.run.reporter.note(f"validation at step {self.step}: {told}")
        groups = {"all": scores.together, **scores.by_conditions}
        counts = {"all": sum(scores.pairs.values()), **scores.pairs}
        for group, values in groups.items():
            self.validation.add({"step": self.step, "conditions": group, "pairs": counts[group], **values})
        if self.best is None or score >= self.best.score:
            self.best = Best.of(self.step, score, self.kept_net, scores)

    def _save(self) -> None:
        if self.best is not None:
            self._write_weights()
        checkpoint = Checkpoint(
            identity=self._identity,
            step=self.step,
            net=self.net.state_dict(),
            optimiser=self.optimiser.state_dict(),
            mean_net=self.mean.net.state_dict() if self.mean else None,
            window=self.window.sums,
            window_steps=self.window.steps,
            seconds=self.seconds,
            best=self.best,
        )
        save_checkpoint(self._checkpoint, checkpoint)

    def _resume(self) -> None:
        found = load_checkpoint(self._checkpoint, self._identity)
        if found is None:
            return
        path = self._checkpoint
        if found.step > self.options.steps:
            raise MethodError(f"a checkpoint after step {found.step} of {self.options.steps}", path)
        restore_network(self.net, found.net, path)
        restore_optimiser(self.optimiser, found.optimiser, path)
        if self.mean and found.mean_net:
            restore_network(self.mean.net, found.mean_net, path)
        if found.best is not None:
            check_state(self.net, found.best.weights, path)
        self.step, self.seconds, self.best = found.step, found.seconds, found.best
        self.window = Window(found.window, found.window_steps)

    def _finish(self) -> TrainingReport:
        if self.best is None:  # without validation
            self.best = Best.of(self.step, math.nan, self.kept_net, None)
        self._write_weights()
        scores = self.best.validation
        text = model_card(
            self._tracker.name,
            self.options,
            self._data,
            self.run,
            self.device,
            self.seconds,
            self.net.parameters_count,
            self.best.step,
            scores,
        )
        write_whole(self.run.out / "MODEL_CARD.md", text)
        return TrainingReport(self._weights, self.step, scores, self.best.step)

    def _write_weights(self) -> None:
        assert self.best is not None
        net = FeatureNet(self.options.network)
        net.load_state_dict(self.best.weights)
        card = weights_card(self._tracker.name, self.options, self._data, self.best.step, self.best.scores or None)
        save_weights(self._weights, net, card)

    @property
    def _weights(self) -> Path:
        return self.run.out / "weights.safetensors"

    @property
    def _checkpoint(self) -> Path:
        return self.run.out / "checkpoint.pt"


def _generator(seed: int, *of: int) -> torch.Generator:
    """A stream of random numbers of its own, on the CPU."""
    state = np.random.SeedSequence([seed, *of]).generate_state(1, np.uint64)[0]
    return torch.Generator().manual_seed(int(state >> np.uint64(1)))

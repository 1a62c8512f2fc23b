"""The steps of a training, from the first or from where a checkpoint stands to the last, stage by stage."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from baselines.files import write_whole
from baselines.lpn.images import as_network_takes_them
from baselines.lpn.losses import LossValue, total_loss
from baselines.lpn.network import LpnNetwork, View, ViewOutput, copy_weights
from baselines.lpn.retriever import Lpn
from baselines.lpn.stages import enter
from baselines.lpn.training.batches import Batch, PlaceBatches
from baselines.lpn.training.card import model_card, weights_card
from baselines.lpn.training.curves import draw_curves
from baselines.lpn.training.first_weights import first_network, fresh_network, number_of, start_of
from baselines.lpn.training.options import TrainOptions
from baselines.lpn.training.schedule import Schedule
from baselines.lpn.weights import About, save_weights
from baselines.options import plain
from baselines.training.checkpoint import Best, Checkpoint, load_checkpoint, save_checkpoint
from baselines.training.checkpoint_content import check_state, restore_network, restore_optimiser
from baselines.training.device import half_precision
from baselines.training.loading import batches_in_order
from baselines.training.log import TIMED, Table, Window
from baselines.training.step import descend
from relocbench.errors import MethodError
from relocbench.retrieval import PlaceData
from relocbench.training import TrainingReport, TrainingRun, ValidateRetriever

_DROPOUT = 1


class Training:
    """One training in one folder.

    Args:
        options: with rates (``TrainOptions.with_rates``).

    Raises:
        ConfigError: the data does not hold what the options ask for.
        MethodError: the folder holds another training, or a file to start from is not right.
    """

    def __init__(
        self,
        data: PlaceData,
        validate: ValidateRetriever | None,
        options: TrainOptions,
        run: TrainingRun,
        device: torch.device,
    ) -> None:
        self.options, self.run, self.device = options, run, device
        self._validate, self._data = validate, data
        self.batches = PlaceBatches(data, options)
        self.schedule = Schedule(options, self.batches.steps_per_epoch)
        self.batches.steps = self.schedule.steps
        self._start = start_of(options)
        self._identity: dict[str, Any] = {
            "name": "lpn",
            "options": plain(options),
            "files": self._start.digests,
            "data": dict(data.described),
            "places": data.places,
            "images": len(data.images),
            "validated": validate is not None,
        }
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
        since, left = time.monotonic() - self.seconds, self.schedule.steps - self.step
        if left:
            self._tell_what_is_learnt()
        with self.run.reporter.stage(f"training {self.options.configuration}", left) as advance:
            while self.step < self.schedule.steps:
                if self.step == self.schedule.stretches[self._stage].last:
                    self._next_stage()
                last = self.schedule.stretches[self._stage].last
                for batch in batches_in_order(
                    self.batches, self.step, last, self.run.workers, self.device.type == "cuda"
                ):
                    self.one_step(batch)
                    self.seconds = time.monotonic() - since
                    self._after_step()
                    self.seconds = time.monotonic() - since
                    advance(1)
        return self._finish()

    def one_step(self, batch: Batch) -> None:
        """Learn from a batch. Raises MethodError where the loss or its gradient is not finite."""
        factor = self.schedule.factor(self.step)
        for group in self.optimiser.param_groups:
            group["lr"] = group["full_rate"] * factor
        value = self._loss(batch)
        trained = [parameter for parameter in self.network.parameters() if parameter.requires_grad]
        remedy = f"lower rates (backbone_rate {self.options.backbone_rate:g}, rate {self.options.rate:g})"
        values = descend(
            value.total, value.parts, trained, self.optimiser, self.options.clip,
            step=self.step + 1, remedy=remedy, out=self.run.out,
        )  # fmt: skip
        self.step += 1
        self.window.add({"rate_factor": factor, **values})

    def _loss(self, batch: Batch) -> LossValue:
        """Views go through the network one after the other: normalisations see one view at a time."""
        stage = self.schedule.stretches[self._stage].stage
        half = half_precision(self.options.mixed_precision, self.device)
        outputs: dict[View, ViewOutput] = {}
        devices = [self.device] if self.device.type == "cuda" else []
        with torch.random.fork_rng(devices=devices):
            torch.manual_seed(number_of(self.options.seed, _DROPOUT, self.step))
            for view, (images, _) in batch.items():
                with torch.autocast(self.device.type, torch.bfloat16, enabled=half):
                    output = self.network(view, as_network_takes_them(images, self.device))
                outputs[view] = ViewOutput(*(None if x is None else cast(Tensor, x).float() for x in output))  # type: ignore[arg-type]
        places = {view: of_view.to(self.device) for view, (_, of_view) in batch.items()}
        return total_loss(outputs, places, self.options.system.loss_in(stage))

    def _enter_stage(self, number: int, network: LpnNetwork) -> None:
        """Train a network as a stage says."""
        self._stage = number
        stage = self.schedule.stretches[number].stage
        self.network: LpnNetwork = network.to(self.device).to(memory_format=torch.channels_last)
        self.network.train()
        trained = enter(self.network, stage)
        self.trained_groups = list(trained)
        rates = {group: self.options.backbone_rate if group == "backbone" else self.options.rate for group in trained}
        self.optimiser = torch.optim.SGD(
            [{"params": ps, "lr": rates[group], "full_rate": rates[group]} for group, ps in trained.items()],
            lr=1.0,  # each group has its own
            momentum=self.options.momentum,
            nesterov=self.options.momentum > 0,
            weight_decay=self.options.weight_decay,
        )

    def _next_stage(self) -> None:
        """Go on with the weights as they are; what validated best before is of another network."""
        number, before = self._stage + 1, self.network.cpu()
        network = fresh_network(self.options, self.schedule.stretches[number].stage, number, self._data.places)
        copy_weights(before, network)
        self.best = None
        self._enter_stage(number, network)
        stage = self.schedule.stretches[number].stage
        self.run.reporter.note(f"stage '{stage.name}': {stage.epochs} epochs, trains {', '.join(self.trained_groups)}")

    def _after_step(self) -> None:
        options, step = self.options, self.step
        stretch = self.schedule.stretches[self._stage]
        ends = step == stretch.last
        if step % options.log_every == 0 or ends:
            row = {"step": step, TIMED: self.seconds, "stage": stretch.stage.name, **self.window.take()}
            self.log.add(cast(dict[str, float | int | str], row))
        epochs, rest = divmod(step - stretch.first, self.batches.steps_per_epoch)
        validates = ends or (rest == 0 and epochs % options.validate_every == 0)
        if validates:
            self._keep_if_better()
            draw_curves(self.run.out / "curves.png", self.log.rows, self.validation.rows)
        if ends and step < self.schedule.steps:
            about = self._about(stretch.stage.name, step, None)
            save_weights(self.run.out / f"stage-{stretch.stage.name}.safetensors", self.network, about)
        if validates or step % options.checkpoint_every == 0:
            self._save()

    def _keep_if_better(self) -> None:
        """Retrieve among the held-out places with the weights as a user would, from a file."""
        if self._validate is None:
            return
        candidate = self.run.out / "candidate.safetensors"
        save_weights(candidate, self.network, self._about("", self.step, None))
        scores = self._validate(Lpn(weights=candidate, device=str(self.device)))
        candidate.unlink()
        for message in scores.messages:
            self.run.reporter.note(f"validation at step {self.step}: {message}")
        for group, values in scores.by_conditions.items():
            told = ", ".join(f"{name} {100 * value:.1f} %" for name, value in values.items())
            self.run.reporter.note(f"validation at step {self.step}: {group}: {told}")
        groups = {"all": scores.together, **scores.by_conditions}
        counts = {"all": sum(scores.pairs.values()), **scores.pairs}
        for group, values in groups.items():
            self.validation.add({"step": self.step, "views": group, "queries": counts[group], **values})
        score = float(np.mean(list(scores.together.values())))
        if self.best is None or score >= self.best.score:
            self.best = Best.of(self.step, score, self.network, scores)

    def _save(self) -> None:
        checkpoint = Checkpoint(
            identity=self._identity,
            step=self.step,
            net=self.network.state_dict(),
            optimiser=self.optimiser.state_dict(),
            mean_net=None,
            window=self.window.sums,
            window_steps=self.window.steps,
            seconds=self.seconds,
            best=self.best,
        )
        save_checkpoint(self._checkpoint, checkpoint)

    def _resume(self) -> None:
        path = self._checkpoint
        found = load_checkpoint(path, self._identity)
        if found and found.step > self.schedule.steps:
            raise MethodError(f"a checkpoint after step {found.step} of {self.schedule.steps}", path)
        number = self.schedule.at(found.step) if found else 0
        stage = self.schedule.stretches[number].stage
        if found is None:
            self._enter_stage(0, first_network(self.options, stage, self._data.places))
            return
        network = fresh_network(self.options, stage, number, self._data.places)
        restore_network(network, found.net, path)
        if found.best is not None:
            check_state(network, found.best.weights, path)
        self._enter_stage(number, network)
        restore_optimiser(self.optimiser, found.optimiser, path)
        self.step, self.seconds, self.best = found.step, found.seconds, found.best
        self.window = Window(found.window, found.window_steps)

    def _tell_what_is_learnt(self) -> None:
        """What people trip over: views left out, places that only one view shows, where the backbone started."""
        note, data = self.run.reporter.note, self._data
        if self.step:
            note(f"goes on after step {self.step} of {self.schedule.steps}")
        left_out = [view for view in data.views if view not in self.options.views]
        for view in left_out:
            images = sum(each.image.view == view for each in data.images)
            note(f"{images} images of view '{view}' are not learnt from (--set views=[...] says which are)")
        of_view = ", ".join(f"{count} in {view}" for view, count in self.batches.places_by_view.items())
        overlap = self.batches.places_of_all_views
        note(
            f"{data.places} places: {of_view}, {overlap} in all of these views; a guess is right once in {data.places}"
        )
        if not overlap:
            note("no place is shown by all views: nothing teaches what they have in common; check the folders' names")
        epochs = " + ".join(f"{stretch.stage.epochs}" for stretch in self.schedule.stretches)
        note(f"{epochs} epochs of {self.batches.steps_per_epoch} steps; backbone: {self._start.told}")

    def _finish(self) -> TrainingReport:
        if self.best is None:  # without validation
            self.best = Best.of(self.step, math.nan, self.network, None)
        options, best = self.options, self.best
        self.network.load_state_dict(best.weights)
        scores = best.validation
        save_weights(self._weights, self.network, self._about("", best.step, best.scores or None))
        parameters = sum(parameter.numel() for parameter in self.network.parameters())
        text = model_card(
            options, self._data, self.run, self.device, self.seconds, parameters, best.step, self.schedule.steps,
            scores, self._start.told,
        )  # fmt: skip
        write_whole(self.run.out / "MODEL_CARD.md", text)
        return TrainingReport(self._weights, self.step, scores, best.step)

    def _about(self, stage: str, step: int, scores: dict[str, Any] | None) -> About:
        """What is told of the weights; ``stage`` is named where they are not the last one's."""
        options = self.options
        return About(
            configuration=options.configuration + (f" (stage {stage})" if stage else ""),
            size=options.size,
            backbone_start=self._start.told,
            views=options.views,
            rerank_top=0 if stage else options.system.rerank_top,
            card=weights_card(options, self._data, step, self.schedule.steps, scores),
        )

    @property
    def _weights(self) -> Path:
        return self.run.out / "weights.safetensors"

    @property
    def _checkpoint(self) -> Path:
        return self.run.out / "checkpoint.pt"

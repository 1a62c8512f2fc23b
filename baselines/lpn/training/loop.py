"""What is LPN's own in a training: network and optimiser of each stage, learning rates, loss, how weights are tried."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from baselines.lpn.images import as_network_takes_them
from baselines.lpn.losses import total_loss
from baselines.lpn.network import LpnNetwork, View, ViewOutput, copy_weights
from baselines.lpn.retriever import Lpn
from baselines.lpn.stages import enter
from baselines.lpn.training.batches import Batch, PlaceBatches
from baselines.lpn.training.cached_maps import MapsOfFrozen
from baselines.lpn.training.card import description
from baselines.lpn.training.curves import draw_curves
from baselines.lpn.training.initial_weights import initial_network, random_network, start_of
from baselines.lpn.training.options import TrainOptions
from baselines.lpn.training.schedule import Schedule, ScheduledStage
from baselines.lpn.weights import About, save_weights
from baselines.options import OptionError, plain
from baselines.training.card import Description, weights_card
from baselines.training.log import Row
from baselines.training.loop import TrainingLoop, percentages
from baselines.training.random_streams import derived_seed
from relocbench.retrieval import PlaceData
from relocbench.training import TrainingReport, TrainingRun, ValidateRetriever, ValidationScores

_DROPOUT = 1
_NO_INFLUENCE = ("maps", "maps_limit")
"""options that do not change what is learnt"""


class Training(TrainingLoop[TrainOptions, LpnNetwork, Batch]):
    """One training of LPN or a variant of it, stage by stage; the options have all rates (``with_rates``).

    Raises:
        ConfigError: the data does not hold what the options ask for.
        MethodError: the folder holds another training, a file to start from cannot be used, or the device cannot.
    """

    validation_columns = ("views", "queries")

    def __init__(
        self, data: PlaceData, validate: ValidateRetriever | None, options: TrainOptions, run: TrainingRun
    ) -> None:
        self._data, self._place_batches = data, PlaceBatches(data, options)
        steps_per_epoch = self._place_batches.steps_per_epoch
        self.schedule = Schedule(options, steps_per_epoch)
        self._place_batches.steps = self.schedule.steps
        self._start = start_of(options)
        identity = {
            "name": "lpn",
            "options": {name: value for name, value in plain(options).items() if name not in _NO_INFLUENCE},
            "files": self._start.digests,
            "data": dict(data.described),
            "places": data.places,
            "images": len(data.images),
        }
        super().__init__(
            options.configuration,
            options,
            run,
            self._place_batches,
            self.schedule.steps,
            options.validate_every * steps_per_epoch,
            validate,
            identity,
        )
        self.resume()

    def build(self, step: int) -> None:
        number = self.schedule.stage_at(step)
        make = random_network if step else initial_network
        self._enter(number, make(self.options, self.schedule.stages[number].stage, number, self._data.places))

    def run_to_end(self) -> TrainingReport:
        """See ``TrainingLoop``; maps of a frozen backbone are computed first. Raises also as ``cache_maps`` does."""
        if self.step < self.steps:
            self.cache_maps()
        return super().run_to_end()

    def cache_maps(self) -> None:
        """Have batches of maps in place of images where the backbone is frozen; those that are missing are computed.

        Raises:
            ConfigError: they would take too much room.
            MethodError: a file of them is damaged.
        """
        if self.options.frozen != "nothing":
            folder = Path(self.options.maps) if self.options.maps else self.run.out / "maps"
            maps = MapsOfFrozen(self.network, self._data, self.options, folder, self.device)
            self.run.reporter.note(maps.summary)
            self._place_batches.maps = maps.cached(self.run.reporter)

    @property
    def stage_steps(self) -> range:
        return range(self._scheduled.first, self._scheduled.last)

    def next_stage(self) -> None:
        """Go on with the weights as they are. What validated best so far is of another network and is forgotten."""
        ended, number = self._scheduled.stage.name, self._number + 1
        file = self.run.out / f"stage-{ended}.safetensors"
        save_weights(file, self.network, self._about(self.step, None, stage=ended))
        network = random_network(self.options, self.schedule.stages[number].stage, number, self._data.places)
        copy_weights(self.network.cpu(), network)
        self.best = None
        trained = self._enter(number, network)
        stage = self._scheduled.stage
        self.run.reporter.note(f"stage '{stage.name}': {stage.epochs} epochs, trains {', '.join(trained)}")

    def set_rates(self) -> dict[str, float]:
        factor = self.schedule.factor(self.step)
        for group in self.optimiser.param_groups:
            group["lr"] = group["full_rate"] * factor
        return {"rate_factor": factor}

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Views pass the network one after the other, so that batch normalisation sees one view at a time."""
        outputs: dict[View, ViewOutput] = {}
        devices = [self.device] if self.device.type == "cuda" else []
        with torch.random.fork_rng(devices=devices):
            torch.manual_seed(derived_seed(self.options.seed, _DROPOUT, self.step))
            for view, (images, _) in batch.items():
                with torch.autocast(self.device.type, torch.bfloat16, enabled=self.half):
                    output = self._output(view, images)
                outputs[view] = ViewOutput(*(None if x is None else x.float() for x in output))  # type: ignore[arg-type]
        places = {view: of_view.to(self.device) for view, (_, of_view) in batch.items()}
        value = total_loss(outputs, places, self.options.system.loss_in(self._scheduled.stage))
        return value.total, value.parts

    def _output(self, view: View, images: Tensor) -> ViewOutput:
        """The network's output for images, or for cached maps of them."""
        if images.dtype != torch.float16:
            return cast(ViewOutput, self.network(view, as_network_takes_them(images, self.device)))
        maps = images.to(self.device, non_blocking=True).float().contiguous(memory_format=torch.channels_last)
        return self.network.forward_from(view, maps, self.options.cached_blocks)

    @property
    def remedy(self) -> str:
        return f"lower rates (backbone_rate {self.options.backbone_rate:g}, rate {self.options.rate:g})"

    def log_labels(self) -> dict[str, str]:
        return {"stage": self._scheduled.stage.name}

    def notes_on(self, scores: ValidationScores) -> Iterator[str]:
        for group, values in scores.by_conditions.items():
            yield f"{group}: {percentages(values)}"

    def save_weights(self, path: Path, network: LpnNetwork, step: int, scores: Mapping[str, Any] | None) -> None:
        save_weights(path, network, self._about(step, scores))

    def method_with(self, weights: Path) -> Lpn:
        return Lpn(weights=weights, device=str(self.device))

    def draw_curves(self, path: Path, log: Sequence[Row], validation: Sequence[Row]) -> None:
        draw_curves(path, log, validation)

    def describe(self) -> Description:
        return description(self.options, self._data, self.network, self.steps, self._start.text)

    def announce(self) -> None:
        """Report also what people trip over: views left out, places that only one view shows, the backbone's start."""
        super().announce()
        note, data, batches = self.run.reporter.note, self._data, self._place_batches
        for view in (view for view in data.views if view not in self.options.views):
            images = sum(each.image.view == view for each in data.images)
            note(f"{images} images of view '{view}' are not learnt from (--set views=[...] says which are)")
        of_view = ", ".join(f"{count} in {view}" for view, count in batches.places_by_view.items())
        overlap = batches.places_of_all_views
        note(
            f"{data.places} places: {of_view}, {overlap} in all of these views; a guess is right once in {data.places}"
        )
        if not overlap:
            note("no place is shown by all views: nothing teaches what they have in common; check the folders' names")
        epochs = " + ".join(f"{scheduled.stage.epochs}" for scheduled in self.schedule.stages)
        note(f"{epochs} epochs of {batches.steps_per_epoch} steps; backbone: {self._start.text}")

    @property
    def _scheduled(self) -> ScheduledStage:
        return self.schedule.stages[self._number]

    def _enter(self, number: int, network: LpnNetwork) -> list[str]:
        """Train a network as a stage says; the groups of weights that are trained."""
        self._number = number
        self.network = network.to(self.device).to(memory_format=torch.channels_last)
        self.network.train()
        trained = enter(self.network, self._scheduled.stage, self._frozen_modules())
        own = {"backbone": self.options.backbone_rate, "partition": self.options.partition_rate}
        rates = {group: own.get(group, self.options.rate) for group in trained}
        self.optimiser = torch.optim.SGD(
            [{"params": ps, "lr": rates[group], "full_rate": rates[group]} for group, ps in trained.items()],
            lr=1.0,  # each group has its own
            momentum=self.options.momentum,
            nesterov=self.options.momentum > 0,
            weight_decay=self.options.weight_decay,
        )
        return list(trained)

    def _frozen_modules(self) -> list[nn.Module]:
        options, branches = self.options, [branch for _, branch in self.network.named_branches()]
        if options.frozen == "nothing":
            return []
        whole = options.frozen_blocks == len(branches[0].backbone.last_blocks)
        if whole and options.loss.decorrelation.weight > 0 and not options.network.attention.after:
            raise OptionError(
                "frozen_blocks",
                options.frozen_blocks,
                "fewer where loss.decorrelation.weight is above 0: it teaches the last map, in front of which nothing "
                f"would learn in '{self.name}'",
            )
        return [module for branch in branches for module in branch.backbone.frozen_modules(options.frozen_blocks)]

    def _about(self, step: int, scores: Mapping[str, Any] | None, stage: str = "") -> About:
        """What the weights file says; ``stage`` names the stage if it is not the last one."""
        options, data = self.options, self._data
        return About(
            configuration=options.configuration + (f" (stage {stage})" if stage else ""),
            size=options.size,
            backbone_start=self._start.text,
            views=options.views,
            rerank_top=0 if stage else options.system.rerank_top,
            card=weights_card(data.described, options.seed, step, self.steps, scores, places=str(data.places)),
        )

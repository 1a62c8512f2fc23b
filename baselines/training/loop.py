"""The loop that all trainers share: steps, log, validation, checkpoints, and the files that are left behind.

A trainer derives from :class:`TrainingLoop` and adds what is its own: the network and its optimiser, the batches, the
learning rates, the loss, how weights are written and validated, and what its model card says.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import cv2
import numpy as np
import torch
import yaml
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from baselines.device import device_named
from baselines.files import write_whole
from baselines.options import plain
from baselines.training.card import Description, model_card, score_rows
from baselines.training.checkpoint import Best, Checkpoint, load_checkpoint, save_checkpoint
from baselines.training.checkpoint_content import check_state, restore_network, restore_optimiser
from baselines.training.ema import EmaNetwork
from baselines.training.log import SECONDS, Row, Table, Window
from baselines.training.tensorboard import EventFile
from relocbench.errors import MethodError
from relocbench.training import TrainingReport, TrainingRun, ValidationScores

Network = TypeVar("Network", bound=nn.Module)
Batch = TypeVar("Batch")
_PREFETCH = 2
"""batches that each background process has ready"""
_DRAW_EVERY_S = 10.0
"""the curves of a long training are drawn at its validations, but no more often than this"""


class LoopOptions(Protocol):
    """The options that every trainer has; a dataclass with more of them."""

    @property
    def seed(self) -> int: ...
    @property
    def clip(self) -> float: ...
    @property
    def mixed_precision(self) -> bool | None: ...
    @property
    def log_every(self) -> int: ...
    @property
    def checkpoint_every(self) -> int: ...


Options = TypeVar("Options", bound=LoopOptions)


class TrainingLoop(ABC, Generic[Options, Network, Batch]):
    """One training in one folder.

    A derived class calls :meth:`resume` once it has set all that :meth:`build` needs.

    Args:
        name: shown beside the progress bar.
        options: written to ``config.yaml``.
        run: the folder, the device, and whom to report to.
        batches: the batch of each step.
        steps: of the whole training.
        validate_every: steps from one validation to the next, counted from the beginning of each stage.
        validate: scores what :meth:`method_with` gives; None: no validation.
        identity: options and data as plain values; a checkpoint with another identity is refused.

    Raises:
        MethodError: the device cannot be used.
    """

    validation_columns: ClassVar[tuple[str, str]]
    """columns of ``validation.csv``: the group, and its number of pairs or queries"""

    network: Network
    optimiser: torch.optim.Optimizer
    ema: EmaNetwork | None = None
    """averages the weights of ``network``; if there is one, the averages are validated and kept"""

    def __init__(
        self,
        name: str,
        options: Options,
        run: TrainingRun,
        batches: Dataset[Batch],
        steps: int,
        validate_every: int,
        validate: Callable[[Any], ValidationScores] | None,
        identity: Mapping[str, Any],
    ) -> None:
        self.name, self.options, self.run, self.batches, self.steps = name, options, run, batches, steps
        self.device = device_named(run.device)
        self._validate_every, self._validate = validate_every, validate
        self._identity = {**identity, "validated": validate is not None}
        self.step, self.seconds, self.window = 0, 0.0, Window()
        self.best: Best | None = None
        self._drawn = time.monotonic()

    # What a trainer adds.

    @abstractmethod
    def build(self, step: int) -> None:
        """Make network and optimiser as they are trained after ``step`` steps; at 0 with the initial weights."""

    @abstractmethod
    def set_rates(self) -> dict[str, float]:
        """Set the optimiser's learning rates for the step at hand; what the log is to say of them."""

    @abstractmethod
    def loss(self, batch: Batch) -> tuple[Tensor, Mapping[str, Tensor]]:
        """The loss of a batch (scalar), and the parts of it that are logged."""

    @property
    @abstractmethod
    def remedy(self) -> str:
        """What may help where the loss is no longer finite."""

    @abstractmethod
    def save_weights(self, path: Path, network: Network, step: int, scores: Mapping[str, Any] | None) -> None:
        """Write the weights of a network as a user gets them, with the step and the scores that they are from."""

    @abstractmethod
    def method_with(self, weights: Path) -> object:
        """The tracker or retriever that is validated, with weights from a file."""

    @abstractmethod
    def draw_curves(self, path: Path, log: Sequence[Row], validation: Sequence[Row]) -> None:
        """Draw how the training goes."""

    @abstractmethod
    def describe(self) -> Description:
        """What the model card says of this training."""

    # What a trainer may change.

    @property
    def stage_steps(self) -> range:
        """The steps of the stage at hand; a training without stages is one."""
        return range(self.steps)

    def next_stage(self) -> None:
        """Enter the stage after the one that has ended."""
        raise NotImplementedError

    def announce(self) -> None:
        """Report what a training that has steps left is about to do."""
        if self.step:
            self.run.reporter.note(f"goes on after step {self.step} of {self.steps}")

    def log_labels(self) -> dict[str, str]:
        """Columns of text for a row of the log."""
        return {}

    def notes_on(self, scores: ValidationScores) -> Iterable[str]:
        """What is reported of a validation, line by line."""
        yield percentages(scores.together)

    def on_new_best(self) -> None:
        """Called when the weights have scored best so far."""

    # The loop.

    @property
    def kept_network(self) -> Network:
        """The network that is validated and kept: the averaged one if there is one."""
        return self.ema.network if self.ema else self.network  # type: ignore[return-value]

    @property
    def weights(self) -> Path:
        """The file of the weights that are kept."""
        return self.run.out / "weights.safetensors"

    @property
    def half(self) -> bool:
        """Whether the network computes in bfloat16."""
        chosen = self.options.mixed_precision
        return self.device.type == "cuda" if chosen is None else chosen

    def resume(self) -> None:
        """Begin at the first step, or where the folder's checkpoint stands.

        Raises:
            MethodError: the folder holds another training, the checkpoint is damaged, or TensorBoard is not installed.
        """
        path = self._checkpoint
        found = load_checkpoint(path, self._identity)
        if found and found.step > self.steps:
            raise MethodError(f"a checkpoint after step {found.step} of {self.steps}", path)
        self.build(found.step if found else 0)
        if found:
            restore_network(self.network, found.net, path)
            restore_optimiser(self.optimiser, found.optimiser, path)
            if self.ema and found.mean_net:
                restore_network(self.ema.network, found.mean_net, path)
            if found.best is not None:
                check_state(self.network, found.best.weights, path)
            self.step, self.seconds, self.best = found.step, found.seconds, found.best
            self.window = Window(found.window, found.window_steps)
        self.log = Table(self.run.out / "log.csv", self.step)
        self.validation = Table(self.run.out / "validation.csv", self.step)
        self._events = EventFile(self.run.tensorboard, self.step) if self.run.tensorboard else None

    def run_to_end(self) -> TrainingReport:
        """Take all steps that are left.

        Raises:
            MethodError: the loss or its gradient is no longer finite.
        """
        write_whole(self.run.out / "config.yaml", yaml.safe_dump(plain(self.options), sort_keys=False))
        since, left = time.monotonic() - self.seconds, self.steps - self.step
        if left:
            self.announce()
        with self.run.reporter.stage(f"training {self.name}", left) as advance:
            while self.step < self.steps:
                if self.step == self.stage_steps.stop:
                    self.next_stage()
                last, on_gpu = self.stage_steps.stop, self.device.type == "cuda"
                for batch in batches_in_order(self.batches, self.step, last, self.run.workers, on_gpu):
                    self.one_step(batch)
                    self.seconds = time.monotonic() - since
                    self._after_step(since)
                    advance(1)
        return self._finish()

    def one_step(self, batch: Batch) -> None:
        """Learn from a batch.

        Raises:
            MethodError: the loss or its gradient is not finite; the weights are as they were.
        """
        rates = self.set_rates()
        loss, parts = self.loss(batch)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        trained = [parameter for parameter in self.network.parameters() if parameter.requires_grad]
        norm = nn.utils.clip_grad_norm_(trained, self.options.clip or math.inf)
        names = ["loss", "gradient_norm", *parts]
        numbers = torch.stack([x.detach().double() for x in (loss, norm, *parts.values())]).tolist()  # one wait
        values = dict(zip(names, numbers, strict=True))
        if not (math.isfinite(values["loss"]) and math.isfinite(values["gradient_norm"])):
            wrong = ", ".join(name for name, value in values.items() if not math.isfinite(value))
            raise MethodError(
                f"training broke down at step {self.step + 1}: not finite: {wrong}; try {self.remedy} in another --out",
                self.run.out,
            )
        self.optimiser.step()
        self.step += 1
        if self.ema:
            self.ema.follow(self.network, self.step)
        self.window.add({**rates, **values})

    def _after_step(self, since: float) -> None:
        """Log, validate and save where it is time to."""
        stage = self.stage_steps
        ends = self.step == stage.stop
        if self.step % self.options.log_every == 0 or ends:
            times = {"step": self.step, SECONDS: self.seconds}
            means = self.window.take()
            self.log.add({**times, **self.log_labels(), **means})
            if self._events:
                self._events.add(self.step, {f"training/{name}": mean for name, mean in means.items()})
        validates = ends or (self.step - stage.start) % self._validate_every == 0
        if validates:
            self._keep_if_better()
            if self.step == self.steps or time.monotonic() - self._drawn > _DRAW_EVERY_S:
                self.draw_curves(self.run.out / "curves.png", self.log.rows, self.validation.rows)
                self._drawn = time.monotonic()
            self.seconds = time.monotonic() - since
        if validates or self.step % self.options.checkpoint_every == 0:
            self._save_checkpoint()

    def _keep_if_better(self) -> None:
        """Validate the weights from a file, as a user would use them."""
        if self._validate is None:
            return
        candidate = self.run.out / "candidate.safetensors"
        self.save_weights(candidate, self.kept_network, self.step, None)
        scores = self._validate(self.method_with(candidate))
        candidate.unlink()
        for note in (*scores.messages, *self.notes_on(scores)):
            self.run.reporter.note(f"validation at step {self.step}: {note}")
        group_column, count_column = self.validation_columns
        for group, count, values in score_rows(scores):
            self.validation.add({"step": self.step, group_column: group, count_column: count, **values})
            if self._events:
                self._events.add(self.step, {f"{name}/{group}": value for name, value in values.items()})
        score = float(np.mean(list(scores.together.values())))
        if self.best is None or score >= self.best.score:
            self.best = Best.of(self.step, score, self.kept_network, scores)
            self.on_new_best()

    def _save_checkpoint(self) -> None:
        checkpoint = Checkpoint(
            identity=self._identity,
            step=self.step,
            net=self.network.state_dict(),
            optimiser=self.optimiser.state_dict(),
            mean_net=self.ema.network.state_dict() if self.ema else None,
            window=self.window.sums,
            window_steps=self.window.steps,
            seconds=self.seconds,
            best=self.best,
            messages=[],
        )
        save_checkpoint(self._checkpoint, checkpoint)

    def _finish(self) -> TrainingReport:
        """Write the kept weights and the model card; without validation the last weights are kept."""
        if self._events:
            self._events.close()
        best = self.best or Best.of(self.step, math.nan, self.kept_network, None)
        self.network.load_state_dict(best.weights)
        self.save_weights(self.weights, self.network, best.step, best.scores or None)
        scores = best.validation
        card = model_card(self.describe(), self.run, self.device, self.options.seed, self.seconds, best.step, scores)
        write_whole(self.run.out / "MODEL_CARD.md", card)
        return TrainingReport(self.weights, self.step, scores, best.step)

    @property
    def _checkpoint(self) -> Path:
        return self.run.out / "checkpoint.pt"


def percentages(values: Mapping[str, float]) -> str:
    """Metrics in one line, in percent."""
    return ", ".join(f"{name} {100 * value:.1f} %" for name, value in values.items())


def batches_in_order(batches: Dataset[Batch], first: int, last: int, workers: int, pin_memory: bool) -> Iterator[Batch]:
    """The batches of the steps from ``first`` to ``last``, excluding it, in order.

    They are read ahead by ``workers`` background processes, or in this one with 0; they are the same whatever their
    number. ``pin_memory`` places them in page-locked memory, for a GPU.
    """
    loader = DataLoader(
        batches,
        batch_size=None,
        sampler=range(first, last),
        num_workers=workers,
        worker_init_fn=_begin_worker,
        prefetch_factor=_PREFETCH if workers else None,
        multiprocessing_context="spawn" if workers else None,
        pin_memory=pin_memory,
        generator=torch.Generator().manual_seed(0),  # the loader draws a seed that nothing uses
    )
    return iter(loader)


def _begin_worker(_: int) -> None:
    """Leave the cores to the training (the loader limits torch's threads in the same way), and its end to itself."""
    cv2.setNumThreads(1)
    hook = sys.excepthook

    def unless_its_reader_ended(kind: type[BaseException], value: BaseException, trace: TracebackType | None) -> None:
        if threading.current_thread() is threading.main_thread() or not issubclass(kind, (ConnectionError, EOFError)):
            hook(kind, value, trace)

    sys.excepthook = unless_its_reader_ended  # multiprocessing's thread that hands tensors over calls it

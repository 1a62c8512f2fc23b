"""Which step belongs to which stage, and how fast it learns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from baselines.lpn.stages import Stage
from baselines.lpn.training.options import TrainOptions


class Stretch(NamedTuple):
    """A stage and its steps."""

    stage: Stage
    first: int
    """step, counted from 0 over all stages"""
    last: int
    """the first one that does not belong to it"""


@dataclass(frozen=True)
class Schedule:
    """All stages one after the other."""

    options: TrainOptions
    steps_per_epoch: int

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """In order; the last one's ``last`` is the number of steps."""
        out: list[Stretch] = []
        for stage in self.options.stages:
            first = out[-1].last if out else 0
            out.append(Stretch(stage, first, first + stage.epochs * self.steps_per_epoch))
        return tuple(out)

    @property
    def steps(self) -> int:
        """The steps of all stages together."""
        return self.stretches[-1].last

    def at(self, done: int) -> int:
        """Number of the stage that ``done`` steps lie in; a stage's last step lies in it."""
        return next(number for number, stretch in enumerate(self.stretches) if done <= stretch.last)

    def factor(self, step: int) -> float:
        """The factor of the learning rates at a step: a ramp, 1, and after a share of the stage's epochs ``decay``."""
        stretch = self.stretches[self.at(step + 1)]
        done = step - stretch.first
        ramp = min((done + 1) / self.options.warm_up, 1.0) if self.options.warm_up else 1.0
        epoch = done // self.steps_per_epoch
        return ramp * (self.options.decay if epoch >= self.options.decay_after * stretch.stage.epochs else 1.0)

"""Which steps belong to which stage, and how the learning rates change."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from baselines.lpn.stages import Stage
from baselines.lpn.training.options import TrainOptions


class ScheduledStage(NamedTuple):
    """A stage and its steps, which are counted from 0 over all stages."""

    stage: Stage
    first: int
    last: int
    """the first step that does not belong to it"""


@dataclass(frozen=True)
class Schedule:
    """All stages, one after the other."""

    options: TrainOptions
    steps_per_epoch: int

    @cached_property
    def stages(self) -> tuple[ScheduledStage, ...]:
        """The stages in order."""
        out: list[ScheduledStage] = []
        for stage in self.options.stages:
            first = out[-1].last if out else 0
            out.append(ScheduledStage(stage, first, first + stage.epochs * self.steps_per_epoch))
        return tuple(out)

    @property
    def steps(self) -> int:
        """The number of steps of all stages together."""
        return self.stages[-1].last

    def stage_at(self, done: int) -> int:
        """The index of the stage that is at work, or has just ended, after ``done`` steps."""
        return next(number for number, scheduled in enumerate(self.stages) if done <= scheduled.last)

    def factor(self, step: int) -> float:
        """The factor of the learning rates at a step: it rises to 1, and late in the stage falls to ``decay``."""
        scheduled = self.stages[self.stage_at(step + 1)]
        done = step - scheduled.first
        ramp = min((done + 1) / self.options.warm_up, 1.0) if self.options.warm_up else 1.0
        epoch = done // self.steps_per_epoch
        return ramp * (self.options.decay if epoch >= self.options.decay_after * scheduled.stage.epochs else 1.0)

"""Options shared by all commands that run methods: where they run, and their limits."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from relocbench.datasets.core.schema import Strict
from relocbench.execution import TIME_LIMIT_S, Limits, Run, Scheduler, default_workers, parse_size


def _size(value: Any) -> Any:
    return parse_size(value) if isinstance(value, str | int | float) else value


class LimitOptions(Strict):
    """Limits of a method; fields are options of the command line and keys of YAML files."""

    time_limit: float = Field(TIME_LIMIT_S, gt=0, allow_inf_nan=False)
    """seconds for a pair or an image; ten times as many for the constructor, for preparing and for a first call"""
    memory_limit: Annotated[int, BeforeValidator(_size), Field(gt=0)] | None = None
    """bytes, or a size such as ``4GB``, of resident memory of a worker process with its children"""

    @property
    def limits(self) -> Limits:
        return Limits(self.time_limit, self.memory_limit)


class ExecutionOptions(LimitOptions):
    """Limits of a method, and where it runs."""

    workers: int | None = Field(None, ge=0)
    """number of processes; None: one for each core; 0: this process, without limits"""
    scheduler: Scheduler | None = None

    @property
    def run(self) -> Run:
        return Run(default_workers() if self.workers is None else self.workers, self.scheduler, self.limits)

    @model_validator(mode="after")
    def _limits_that_can_be_kept(self) -> Self:
        given = [
            f"--{name.replace('_', '-')}" for name in ("time_limit", "memory_limit") if name in self.model_fields_set
        ]
        if given and (self.scheduler is not None or self.workers == 0):
            where = (
                "--workers 0 asks in this process" if self.scheduler is None else "--scheduler has workers of its own"
            )
            raise ValueError(f"{' and '.join(given)} cannot be enforced: {where}")
        return self

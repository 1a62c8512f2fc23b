"""Options shared by the commands that run methods: on what, where they run, and their limits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from relocbench.datasets.core.schema import Strict
from relocbench.execution import TIME_LIMIT_S, Limits, Run, SandboxChoice, default_workers, parse_size
from relocbench.execution.scheduler_setting import SchedulerSetting

Overwrite = Literal["never", "failed", "always"]
"""answers to compute again: none, those that failed, or all"""


def _size(value: Any) -> Any:
    return parse_size(value) if isinstance(value, str | int | float) else value


class LimitOptions(Strict):
    """Limits of a method; fields are options of the command line and keys of YAML files."""

    time_limit: float = Field(TIME_LIMIT_S, gt=0, allow_inf_nan=False)
    """seconds for a pair or an image; ten times as many for the constructor, for preparing and for a first call"""
    memory_limit: Annotated[int, BeforeValidator(_size), Field(gt=0)] | None = None
    """bytes, or a size such as ``4GB``, of resident memory of a worker process with its children"""

    sandbox: SandboxChoice = "auto"
    """whether its processes have a sandbox: where the system has one, always (or nothing runs), or never"""

    @property
    def limits(self) -> Limits:
        return Limits(self.time_limit, self.memory_limit)


class ExecutionOptions(LimitOptions):
    """Limits of a method, and where it runs."""

    workers: int | None = Field(None, ge=0)
    """number of processes; None: one for each core; 0: this process, without limits"""
    scheduler: SchedulerSetting | None = None

    @property
    def run(self) -> Run:
        return Run(
            default_workers() if self.workers is None else self.workers, self.scheduler, self.limits, self.sandbox
        )

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


class EvaluationOptions(Strict):
    """What is evaluated on which part of a dataset; fields are options of the command line and keys of YAML files."""

    dataset: Path
    methods: tuple[str, ...] = ()
    set: tuple[str, ...] = ()
    """parameters, as key=value or LABEL.key=value"""
    out: Path = Path("results")
    split: str | None = None
    pair_sets: tuple[str, ...] = ()
    """or tasks of retrieval"""
    overwrite: Overwrite = "never"
    seed: int = Field(0, ge=0)


class AnswerOptions(EvaluationOptions):
    """The same, of methods that are run or of predictions that were made elsewhere."""

    predictions: Path | None = None

    @model_validator(mode="after")
    def _something_to_do(self) -> Self:
        if not self.methods and self.predictions is None:
            raise ValueError("nothing to evaluate: give --method NAME or --predictions PATH")
        if self.predictions is not None and len(self.methods) > 1:
            raise ValueError("--predictions takes one --method, the label to keep them under")
        return self

"""A scheduler as options and configuration files give it: its keys, or its address alone.

It stands apart because pydantic takes half as long to import as all that a process of a method needs.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator

from relocbench.execution.scheduler import Scheduler


def _keys(value: Any) -> Any:
    return {"address": value} if isinstance(value, str) else value


SchedulerSetting = Annotated[Scheduler, BeforeValidator(_keys)]

"""However a worker ends, its parent says how, and the other units are done."""

from __future__ import annotations

import pytest
from misbehaving import do

from relocbench.execution import Limits, Loss, Run, run_limited

IN_TIME = Limits(time_s=0.5)
IN_MEMORY = Limits(memory_bytes=400 * 10**6)
ENDS = {
    "hang": (IN_TIME, "time", "0.5 s"),
    "hang_in_native_code": (IN_TIME, "time", "0.5 s"),
    "leave": (IN_TIME, "death", "exit status 3"),
    "crash": (IN_TIME, "death", "SIGSEGV"),
    "kill_itself": (IN_TIME, "death", "SIGKILL"),
    "fork_sleepers": (IN_TIME, "death", "exit status 4"),
    "take_memory": (IN_MEMORY, "memory", "400 MB"),
}
"""what a method does, within which limits, which kind of loss it is, and what is said of it"""


@pytest.mark.parametrize("limits", [IN_TIME, IN_MEMORY])
def test_each_end_of_a_worker_is_told_and_costs_its_unit_alone(limits: Limits) -> None:
    deeds = [deed for deed in ENDS if ENDS[deed][0] is limits]
    units = [unit for deed in deeds for unit in (deed, "")]
    losses: dict[str, Loss] = {}

    def lost(unit: str, loss: Loss) -> str:
        losses[unit] = loss
        return "lost"

    results = dict(run_limited(do, units, Run(1, limits=limits), on_loss=lost))
    assert [results[index] for index in range(len(units))] == ["lost", "done"] * len(deeds)
    for deed in deeds:
        _, kind, words = ENDS[deed]
        loss = losses[deed]
        assert loss.kind == kind, deed
        assert words in loss.words
        assert loss.step is not None
        assert loss.step.keys == (deed,)

"""However a worker ends, its parent says how, and the other units are done."""

from __future__ import annotations

from pathlib import Path

import pytest
from misbehaving import do
from units_of_work import meet

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


@pytest.mark.thorough
@pytest.mark.parametrize("limits", [IN_TIME, IN_MEMORY])
def test_each_end_of_a_worker_is_told_and_costs_its_unit_alone(limits: Limits) -> None:
    deeds = [deed for deed in ENDS if ENDS[deed][0] is limits]
    units = [unit for deed in deeds for unit in (deed, "")]
    losses: dict[str, Loss] = {}

    def lost(unit: str, loss: Loss) -> str:
        losses[unit] = loss
        return "lost"

    results = dict(run_limited(do, [units], Run(1, limits=limits), on_loss=lost))
    assert [results[index] for index in range(len(units))] == ["lost", "done"] * len(deeds)
    for deed in deeds:
        _, kind, words = ENDS[deed]
        loss = losses[deed]
        assert loss.kind == kind, deed
        assert words in loss.words
        assert loss.step is not None
        assert loss.step.keys == (deed,)


def test_a_worker_stays_with_a_series_and_begins_another_before_it_helps(tmp_path: Path) -> None:
    """What the first unit of a series has started is there for the others: the process of a method, say."""
    series = [[(str(tmp_path), f"{number}-{name}", 2) for number in range(3)] for name in "ab"]
    series.append([(str(tmp_path), f"{number}-c", 1) for number in range(3, 5)])
    asked = run_limited(meet, series, Run(2), on_loss=lambda unit, loss: pytest.fail(loss.words))
    done = dict(result for _, result in asked)
    assert len(done) == 8
    first, second = ({done[f"{number}-{name}"] for number in range(3)} for name in "ab")
    assert len(first) == len(second) == 1
    assert first != second

"""The log of a training is taken up again, or refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from refusals import refused

from baselines.training.log import Table
from relocbench.errors import MethodError


def test_rows_up_to_the_checkpoint_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    table = Table(path, 0)
    for step in (1, 2, 3):
        table.add({"step": step, "loss": 0.5 * step})
    assert Table(path, 2).rows == [{"step": "1", "loss": "0.5"}, {"step": "2", "loss": "1"}]


@pytest.mark.parametrize(
    ("content", "line", "names"),
    [
        (b"loss,seconds\n1,2\n", 1, ["step"]),
        (b"", 1, ["step"]),
        (b"step,loss\n1,2\n2\n", 3, [2, 1]),
        ("step,loss\n²²,2\n".encode(), 2, ["step", "²²"]),
        (b"step,loss\n\xff,2\n", None, []),
        (b'step,loss\n"1,2\n', None, []),
    ],
)
def test_a_log_that_is_none_is_refused_in_one_line(
    tmp_path: Path, content: bytes, line: int | None, names: list[object]
) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    with refused(MethodError, "log.csv", line, *names):
        Table(path, 10)

"""The processes that read batches ahead."""

from __future__ import annotations

import subprocess
import sys

import pytest

READER_THAT_ENDS_EARLY = """
import os, socket, sys
from multiprocessing import resource_sharer
from baselines.training.loop import _begin_worker
if "worker" in sys.argv:
    _begin_worker(0)
address, _ = resource_sharer.DupFd(os.open(os.devnull, os.O_RDONLY))._id
reader = socket.socket(socket.AF_UNIX)
reader.connect(address)
reader.close()
resource_sharer.stop(timeout=10)
"""


@pytest.mark.thorough
def test_nothing_is_printed_when_the_training_ends_while_a_tensor_is_handed_over() -> None:
    """As after a Ctrl-C; without the worker's own way it is a traceback, which shows that the case is made."""

    def said(*arguments: str) -> str:
        command = [sys.executable, "-c", READER_THAT_ENDS_EARLY, *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stderr

    assert "Traceback" in said()
    assert said("worker") == ""

"""Small odd inputs beside the repository, each in a folder of its own; a test is skipped where there are none."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from repository import ROOT

REAL = Path(os.environ.get("RELOCBENCH_REAL_DATA", ROOT.parent / "shared" / "data"))


def odd_input(case: str) -> Path:
    folder = REAL / "odd_inputs" / case
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here")
    return folder

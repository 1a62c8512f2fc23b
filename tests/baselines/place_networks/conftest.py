"""Files of drawn weights, which all tests here share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from drawn_places import STATES


@pytest.fixture(scope="session")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A file of weights by the name of its retriever, made when it is first asked for."""
    folder = tmp_path_factory.mktemp("weights")

    def file(name: str) -> Path:
        path = folder / f"{name}.pth"
        if not path.exists():
            torch.save(STATES[name](), path)
        return path

    return file

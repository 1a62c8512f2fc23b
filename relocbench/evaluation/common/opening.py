"""The dataset that a run asks about, once it is sure that the run will not harm it and that it is whole."""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core import fingerprint
from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import ConfigError


def opened(folder: Path, out: Path) -> Dataset:
    """The dataset in a folder, for results that go to another one.

    Raises:
        ConfigError: ``out`` lies inside the dataset.
        DatasetError: there is no dataset, or one of its tables is not what its manifest says.
    """
    dataset = Dataset(folder)
    if out.resolve().is_relative_to(dataset.root.resolve()):
        raise ConfigError("--out lies inside the dataset, which results would change; choose another folder", out)
    for fault in fingerprint.faults(dataset.layout, content="text"):
        raise fault
    return dataset

"""Opening the dataset of an evaluation after checking that it is whole and that results will not harm it."""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core import fingerprint
from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import ConfigError


def open_for_evaluation(folder: Path, out: Path) -> Dataset:
    """The dataset in a folder, to be evaluated with results in another folder.

    Raises:
        ConfigError: ``out`` lies inside the dataset.
        DatasetError: there is no dataset, or one of its tables is not what its manifest records.
    """
    dataset = Dataset(folder)
    if out.resolve().is_relative_to(dataset.root.resolve()):
        raise ConfigError("--out lies inside the dataset, which results would change; choose another folder", out)
    for fault in fingerprint.faults(dataset.layout, content="text"):
        raise fault
    return dataset

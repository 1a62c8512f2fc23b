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
    check_outside(out, dataset.root)
    for fault in fingerprint.faults(dataset.layout, content="text"):
        raise fault
    return dataset


def check_outside(out: Path, dataset: Path) -> None:
    """Raise ConfigError if the folder for results lies inside the dataset."""
    if out.resolve().is_relative_to(dataset.resolve()):
        raise ConfigError("--out lies inside the dataset, which results would change; choose another folder", out)

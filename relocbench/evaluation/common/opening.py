"""Opening the dataset of an evaluation after checking that it is whole and that results will not harm it."""

from __future__ import annotations

from pathlib import Path

from relocbench.datasets.core import fingerprint
from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import ConfigError, DatasetError


def open_for_evaluation(folder: Path, out: Path) -> Dataset:
    """The dataset in a folder, to be evaluated with results in another folder.

    Raises:
        ConfigError: ``out`` lies inside the dataset.
        DatasetError: there is no dataset, or one of its tables is not what its manifest records.
    """
    if not (folder / "dataset.yaml").exists() or not (folder / "traversals").is_dir():
        _refuse_places(folder)
    dataset = Dataset(folder)
    check_outside(out, dataset.root)
    check_whole(dataset)
    return dataset


def check_whole(dataset: Dataset) -> None:
    """Raise DatasetError for the first of a dataset's files that is missing or, as far as it is text, changed."""
    for fault in fingerprint.faults(dataset.layout, content="text"):
        raise fault


def check_outside(out: Path, dataset: Path, option: str = "--out") -> None:
    """Raise ConfigError if a folder that is written to, named by the option, lies inside the dataset."""
    if out.resolve().is_relative_to(dataset.resolve()):
        raise ConfigError(f"{option} lies inside the dataset, which results would change; choose another folder", out)


def check_in_no_dataset(out: Path) -> None:
    """Raise ConfigError if a folder that is written to is a dataset, or lies inside one."""
    for folder in (out.resolve(), *out.resolve().parents):
        if (folder / "manifest.csv").is_file() and (folder / "dataset.yaml").is_file():
            raise ConfigError(f"--out lies inside the dataset {folder}; choose another folder", out)


def _refuse_places(folder: Path) -> None:
    """Raise DatasetError if the folder holds places by several views instead of pairs."""
    from relocbench.datasets.cross_view import is_cross_view

    if is_cross_view(folder):
        raise DatasetError(
            "holds places by several views and no pairs: retrievers are evaluated on it, by `relocbench "
            "evaluate-retrieval`",
            folder,
        )

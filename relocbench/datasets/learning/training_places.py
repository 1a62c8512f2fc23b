"""Training data of retrievers: the train folders of cross-view sets, or places along the drives of datasets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.cross_view import is_cross_view, open_cross_view
from relocbench.datasets.learning.drive_places import drive_places
from relocbench.errors import ConfigError
from relocbench.progress import Reporter
from relocbench.retrieval import PlaceData


def training_places(roots: Sequence[Path], reporter: Reporter) -> PlaceData:
    """Images of known places from one or several sets; places of different sets are different.

    Args:
        roots: folders of cross-view sets, or of datasets.
        reporter: receives notes on empty folders and on places that are also in the test folders.

    Raises:
        DatasetError: a folder is neither a cross-view set nor a dataset, or has no training images.
        ConfigError: a folder is given twice, or a dataset's training split shares a traversal with its test split.
    """
    known: set[Path] = set()
    for root in roots:
        if root.resolve() in known:
            raise ConfigError("this dataset is given twice", root)
        known.add(root.resolve())
    return joined([_places(root, reporter) for root in roots])


def _places(root: Path, reporter: Reporter) -> PlaceData:
    layout = DatasetLayout(root)
    # A rendered cross-view set has files of these names, too. Of an unfinished build there is the second alone.
    drives = not is_cross_view(root) and (layout.dataset_yaml.exists() or layout.build_yaml.exists())
    return drive_places(root) if drives else open_cross_view(root, reporter).training()


def joined(sets: Sequence[PlaceData]) -> PlaceData:
    """The places of several sets, numbered consecutively."""
    images = []
    places = 0
    for each in sets:
        images += [replace(image, place=image.place + places) for image in each.images]
        places += each.places
    return PlaceData(places, tuple(images), tuple(described for each in sets for described in each.described))

"""Descriptors relative to the mean of their view, from images of which nobody knows what place they show.

Descriptors of a trained network share most of what they are: between two views, such as a drone's and a satellite's,
much of the rest is the difference of the views. Of each part of a descriptor, the mean over unlabelled images of the
same view is taken away:

    descriptor_p = (f_p - m_p) / (||f_p - m_p|| sqrt(P))        m_p: the mean of f_p over images of the view

This is the centring before whitening of Jégou and Chum ("Negative evidences and co-occurences in image retrieval",
ECCV 2012), done for each view as in the alignment of domains by their first moments (Sun, Feng and Saenko, "Return of
frustratingly easy domain adaptation", AAAI 2016, who also align the second ones).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.lpn.descriptor import descriptors, parts_of
from relocbench.datasets.core.images import as_rgb, read_image
from relocbench.errors import DatasetError, MethodError
from relocbench.retrieval import ImageView

Descriptors = NDArray[np.floating]
SUFFIXES = (".jpg", ".jpeg", ".png")
MOST_IMAGES = 64
"""of a view, evenly from all in the order of their names: the mean hardly changes with more"""


class ViewMeans:
    """The mean descriptor of each view, computed when the view is first met.

    Args:
        folder: holds a folder for each view (``street``, ``drone``, ``satellite``), with images at any depth.
        describe: the retriever's descriptors (N, P * D) of images of one view.
        parts: P.

    Raises:
        MethodError: there is no such folder.
    """

    def __init__(self, folder: Path, describe: Callable[[Sequence[ImageView]], Descriptors], parts: int) -> None:
        if not folder.is_dir():
            raise MethodError("is no folder; expected one with a folder of images for each view", folder)
        self._folder, self._describe, self._parts = folder, describe, parts
        self._means: dict[str, Descriptors] = {}

    def centred(self, rows: Descriptors, views: Sequence[str]) -> Descriptors:
        """Descriptors (N, P * D) of images of these views, relative to the mean of the view, float32 of norm 1.

        Raises:
            MethodError: a view has no images, or one of them cannot be read.
        """
        means = np.stack([self._mean(view) for view in views]) if len(views) else np.zeros_like(rows)
        relative = parts_of(torch.from_numpy(rows - means), self._parts)
        return descriptors(relative).numpy()

    def _mean(self, view: str) -> Descriptors:
        if view not in self._means:
            images = [
                ImageView(path.name, view, partial(_read, path)) for path in unlabelled_images(self._folder, view)
            ]
            self._means[view] = np.nanmean(self._describe(images), axis=0)
        return self._means[view]


def unlabelled_images(folder: Path, view: str) -> list[Path]:
    """The images that the mean of a view is made of, in the order of their names.

    Raises:
        MethodError: the view has none.
    """
    within = folder / view
    paths = sorted(path for path in within.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    if not paths:
        raise MethodError(f"holds no image; expected unlabelled images of the view '{view}'", within)
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(len(paths), MOST_IMAGES)).round().astype(int))
    return [paths[k] for k in chosen]


def unlabelled_files(folder: Path | None) -> dict[str, Path]:
    """All images that the means can depend on, by a name, for the record of a run; none without a folder."""
    if folder is None or not Path(folder).is_dir():
        return {}
    folder = Path(folder)
    views = sorted(path.name for path in folder.iterdir() if path.is_dir())
    found = [path for view in views for path in _listed(folder, view)]
    return {f"unlabelled/{path.relative_to(folder).as_posix()}": path for path in found}


def _listed(folder: Path, view: str) -> list[Path]:
    try:
        return unlabelled_images(folder, view)
    except MethodError:
        return []


def _read(path: Path) -> NDArray[np.uint8]:
    try:
        return as_rgb(read_image(path))
    except DatasetError as bad:
        raise MethodError(f"an unlabelled image cannot be read: {bad}") from bad

"""Descriptors relative to the mean of their view, from images of which nobody knows what place they show.

Descriptors of a trained network share most of what they are: between two views, such as a drone's and a satellite's,
much of the rest is the difference of the views. Of each part of a descriptor, the mean over unlabelled images of the
same view is taken away:

    descriptor_p = (u_p - m_p) / (||u_p - m_p|| sqrt(P))        u_p = f_p / ||f_p||; m_p: its mean over the view

This is the centring before whitening of Jégou and Chum ("Negative evidences and co-occurences in image retrieval",
ECCV 2012), done for each view as in the alignment of domains by their first moments (Sun, Feng and Saenko, "Return of
frustratingly easy domain adaptation", AAAI 2016, who also align the second ones).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import torch

from baselines.lpn.descriptor import descriptors, parts_of
from relocbench.arrays import Image
from relocbench.errors import MethodError
from relocbench.retrieval import Descriptors, ImageView

SUFFIXES = (".jpg", ".jpeg", ".png")
MOST_IMAGES = 64
"""of a view, evenly from all in the order of their names: the mean hardly changes with more"""
_BATCH = 16
"""images in memory at a time"""
_SAME = 1e-5
"""a descriptor of norm 1 that is so near to the mean is the mean, in single precision"""


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
            raise MethodError("is not a folder; expected one with a folder of images for each view", folder)
        self._folder, self._describe, self._parts = folder, describe, parts
        self._means: dict[str, Descriptors] = {}

    def centred(self, rows: Descriptors, views: Sequence[str]) -> Descriptors:
        """Descriptors (N, P * D) of images of these views, relative to the mean of the view, float32 of norm 1.

        An image whose descriptor is the mean itself has a row of NaN.

        Raises:
            MethodError: a view has no images, none of them has a descriptor, or one cannot be read.
        """
        relative = rows - np.stack([self._mean(view) for view in views]) if len(views) else rows.copy()
        relative[np.linalg.norm(relative, axis=1) < _SAME] = np.nan
        return descriptors(parts_of(torch.from_numpy(relative), self._parts)).numpy()

    def _mean(self, view: str) -> Descriptors:
        if view not in self._means:
            paths = unlabelled_images(self._folder, view)
            rows = np.concatenate([self._rows(paths[k : k + _BATCH], view) for k in range(0, len(paths), _BATCH)])
            described = rows[np.isfinite(rows).all(axis=1)]
            if not len(described):
                raise MethodError("none of its images can be described", self._folder / view)
            self._means[view] = described.mean(axis=0)
        return self._means[view]

    def _rows(self, paths: Sequence[Path], view: str) -> Descriptors:
        return self._describe([ImageView(path.name, view, partial(_read, path)) for path in paths])


def unlabelled_images(folder: Path, view: str) -> list[Path]:
    """The images that the mean of a view is made of, in the order of their names.

    Links to folders are followed; files whose name begins with a dot are not images.

    Raises:
        MethodError: the view has none.
    """
    paths = sorted(_images(folder / view))
    if not paths:
        raise MethodError(f"holds no JPEG or PNG; expected unlabelled images of the view '{view}'", folder / view)
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(len(paths), MOST_IMAGES)).round().astype(int))
    return [paths[k] for k in chosen]


def unlabelled_files(folder: Path | None) -> dict[str, Path]:
    """All images that the means can depend on, by a name, for the record of a run; none without a folder."""
    if folder is None or not Path(folder).is_dir():
        return {}
    views = sorted(path.name for path in Path(folder).iterdir() if path.is_dir() and any(_images(path)))
    found = [path for view in views for path in unlabelled_images(Path(folder), view)]
    return {f"unlabelled/{path.relative_to(folder).as_posix()}": path for path in found}


def _images(folder: Path) -> Iterator[Path]:
    seen = set()
    for path, folders, files in os.walk(folder, followlinks=True):
        real = os.path.realpath(path)
        if real in seen:  # a link that leads back
            folders.clear()
            continue
        seen.add(real)
        for name in files:
            if Path(name).suffix.lower() in SUFFIXES and not name.startswith("."):
                yield Path(path, name)


def _read(path: Path) -> Image:
    try:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as bad:  # more pixels than OpenCV reads
        raise MethodError("an unlabelled image that is too large", path) from bad
    if image is None:
        raise MethodError("an unlabelled image that cannot be read; expected a JPEG or PNG", path)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)

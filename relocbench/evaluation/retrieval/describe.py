"""Descriptors of many images: computed in batches, with an error message for each image on which the method broke."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Image, Indices, Mask
from relocbench.errors import one_line
from relocbench.evaluation.isolation.views import read_only
from relocbench.evaluation.retrieval.handles import RetrieverHandle, WorkerRetriever
from relocbench.evaluation.retrieval.local import LocalRetriever
from relocbench.evaluation.retrieval.output_checks import fault_of
from relocbench.execution import chunks
from relocbench.retrieval import Descriptors, ImageView, RetrievalTask, Retriever

BATCH = 32
_HOPELESS = 64
"""if this many images broke one by one and none has succeeded, batches that break are not retried image by image"""


@dataclass(frozen=True, eq=False)
class Described:
    """The descriptors of N images."""

    values: NDArray[np.floating]
    """(N, D); a row of NaN for an image without a descriptor; (N, 1) where no image has one"""
    messages: tuple[str, ...]
    """(N,) how the method crashed on an image; empty where it did not"""
    seconds: Array
    """(N,) an equal share of the batch's time, without reading the images"""

    def __len__(self) -> int:
        return len(self.values)

    @property
    def finite(self) -> Mask:
        """(N,) whether an image has a descriptor."""
        return np.asarray(np.isfinite(self.values).all(axis=1), dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class _One:
    value: NDArray[np.floating] | None
    seconds: float
    message: str = ""


class Describer:
    """Describes images with one retriever, and caches descriptors that will be needed again.

    Args:
        retriever: constructed, and fitted if it can be; or a handle that calls one in another process.
        shared: identities of the images whose descriptors are cached.
        salt: of the digests that the retriever sees in place of keys, and of the order of images.
    """

    def __init__(
        self, retriever: Retriever | RetrieverHandle, shared: frozenset[str] = frozenset(), salt: str = ""
    ) -> None:
        self.handle: RetrieverHandle = (
            retriever if isinstance(retriever, LocalRetriever | WorkerRetriever) else _local_handle(retriever)
        )
        self._shared = shared
        self._salt = salt
        self._known: dict[str, _One] = {}
        self._dimensions: int | None = None
        self._broken = 0

    def __call__(self, images: Sequence[ImageView], advance: Callable[[int], None]) -> Described:
        """Describe all images; ``advance`` is called with the number of images just done.

        Raises:
            DatasetError: an image cannot be read.
            MethodError: the method reports that it cannot go on.
        """
        order = mixed(len(images), self._salt)
        out: list[_One] = []
        for batch in chunks([images[index] for index in order], BATCH):
            new = list({identity(image): image for image in batch if identity(image) not in self._known}.values())
            fresh = dict(zip(map(identity, new), self._batch(new), strict=True))
            self._known |= {key: one for key, one in fresh.items() if key in self._shared}
            out += [fresh.get(identity(image)) or self._known[identity(image)] for image in batch]
            advance(len(batch))
        return _stacked([out[index] for index in np.argsort(order)])

    def knows(self, images: Iterable[ImageView]) -> bool:
        """Whether the descriptors of all these images are cached."""
        return all(identity(image) in self._known for image in images)

    def _batch(self, images: Sequence[ImageView]) -> list[_One]:
        if not images:
            return []
        views = list(anonymous(images, self._salt))
        values, seconds, crash = self._ask(views)
        if crash and len(views) > 1 and (self._broken < _HOPELESS or self._dimensions is not None):
            return [one for view in views for one in self._single(view)]
        return self._taken(values, seconds, crash, len(views))

    def _single(self, view: ImageView) -> list[_One]:
        return self._taken(*self._ask([view]), 1)

    def _taken(self, values: Any, seconds: float, crash: str, count: int) -> list[_One]:
        if crash:
            self._broken += count
            return [_One(None, seconds / count, crash)] * count
        self._dimensions = values.shape[1]
        return [_One(row.copy(), seconds / count) for row in values]

    def _ask(self, views: list[ImageView]) -> tuple[Any, float, str]:
        """Return descriptors, the seconds they took, and how the method crashed."""
        values, seconds, crash = self.handle.describe(views)
        return values, seconds, crash or fault_of(values, len(views), self._dimensions) or ""


def _local_handle(retriever: Any) -> RetrieverHandle:
    return LocalRetriever(retriever)


def mixed(count: int, salt: str) -> Indices:
    """The order in which a method sees images, which otherwise are in the order of a drive; as given without a salt."""
    if not salt:
        return np.arange(count)
    return np.random.default_rng(list(hashlib.sha256(salt.encode()).digest())).permutation(count)


def anonymous(images: Iterable[ImageView], salt: str = "") -> Iterator[ImageView]:
    """Yield the views that a method gets, whose keys are digests: a path may name the place, a digest does not.

    The digest depends on ``salt``, since that of a path that can be guessed would give the path away.
    The views are new, so that an image is released together with its view.
    """
    for image in images:
        name = hashlib.blake2s(image.key.encode(), digest_size=8, key=salt.encode()[:32]).hexdigest()
        yield ImageView(name, image.view, partial(_read_only, image.read))


def _read_only(read: Callable[[], Image]) -> Image:
    return read_only(read())


class AnonymousViews(Sequence[ImageView]):
    """A gallery for ``fit`` that can be indexed in any order; it keeps no image in memory."""

    def __init__(self, images: Sequence[ImageView], salt: str = "", order: Indices | None = None) -> None:
        self._images, self._salt = images, salt
        self._order = mixed(len(images), salt) if order is None else order

    def __len__(self) -> int:
        return len(self._order)

    @overload
    def __getitem__(self, index: int) -> ImageView: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[ImageView]: ...
    def __getitem__(self, index: int | slice) -> ImageView | Sequence[ImageView]:
        if isinstance(index, slice):
            return AnonymousViews(self._images, self._salt, self._order[index])
        return next(anonymous([self._images[self._order[index]]], self._salt))


def identity(image: ImageView) -> str:
    """A key that is equal for images with equal descriptors: the view and content, or the name if that is unknown."""
    return f"{image.view} {image.content}" if image.content else image.key


def shared_images(tasks: Sequence[RetrievalTask]) -> frozenset[str]:
    """Identities of images that occur in more than one task, or both as query and in a gallery."""
    counts = Counter(identity(image) for task in tasks for side in (task.queries, task.gallery) for image in side)
    return frozenset(one for one, count in counts.items() if count > 1)


def descriptor_variance(*described: Described) -> float | None:
    """The variance of normalised descriptors about their mean, ``1 - |mean|^2``; None without any descriptor."""
    total, count = np.zeros(1), 0
    for each in described:
        values = each.values[each.finite].astype(np.float64)
        norms = np.linalg.norm(values, axis=1, keepdims=True)
        kept = (norms > 0).ravel()
        if kept.any():
            total = total + (values[kept] / norms[kept]).sum(axis=0)
            count += int(kept.sum())
    return max(0.0, 1.0 - float(np.sum((total / count) ** 2))) if count else None


def nothing(count: int, message: str) -> Described:
    """The result for images that could not be described at all."""
    return Described(np.full((count, 1), np.nan), (one_line(message),) * count, np.zeros(count))


def _stacked(ones: Sequence[_One]) -> Described:
    known = [one.value for one in ones if one.value is not None]
    width = len(known[0]) if known else 1
    dtype: Any = np.result_type(*{value.dtype for value in known}) if known else np.float64
    values: Descriptors = np.full((len(ones), width), np.nan, dtype=dtype)
    for row, one in zip(values, ones, strict=True):
        if one.value is not None:
            row[:] = one.value
    seconds = np.array([one.seconds for one in ones], dtype=np.float64)
    return Described(values, tuple(one.message for one in ones), seconds)

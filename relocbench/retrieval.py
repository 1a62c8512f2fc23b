"""The contract of retrievers: what a retriever is given, and what it returns.

A retriever is any object with ``describe``. It inherits nothing and is found by the entry-point group
``relocbench.retrievers`` or by a dotted path; rankings made elsewhere need none. It describes images by vectors, and
keyframes are ranked by the dot product of their vectors with the query's. It may also rerank the first K candidates
(``rerank``), and learn from the gallery before it describes anything (``fit``).

The views hold no label, no position and no pose: a retriever never sees the ground truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Image
from relocbench.metrics.retrieval.relevance import Relevance

Descriptors = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class ImageView:
    """An image as a retriever sees it; the file is read when ``image`` is first used."""

    key: str
    """identifies the image within its set, without hinting at the place"""
    view: str
    """where it was taken from: ``street``, ``drone``, ``satellite``"""
    read: Callable[[], Image]
    """reads the image; raises DatasetError"""
    content: str = ""
    """digest of the image's content, if known: images of one view with equal digests are described once"""

    @cached_property
    def image(self) -> Image:
        """(H, W, 3) RGB uint8."""
        return self.read()


@runtime_checkable
class Retriever(Protocol):
    """Describes images so that images of one place have similar descriptors."""

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        """Descriptors (N, D) of N images, float32 or float64; a larger dot product means a nearer place.

        An image that cannot be described has a row of NaN: it retrieves nothing and is not retrieved.

        Raises:
            MethodError: the method cannot go on at all, which ends the run.
        """
        ...


@runtime_checkable
class FittingRetriever(Retriever, Protocol):
    """A retriever that first learns from the gallery (a vocabulary, whitening), without labels, as for a new map."""

    def fit(self, gallery: Sequence[ImageView], seed: int) -> None:
        """Learn from the gallery; called once, before any ``describe``."""
        ...


@runtime_checkable
class RerankingRetriever(Retriever, Protocol):
    """A retriever that reranks the first candidates."""

    rerank_top: int
    """K, the number of candidates that are reranked; 0 for none"""

    def rerank(self, query: Descriptors, candidates: Descriptors) -> Descriptors:
        """Scores (K,) of candidates (K, D) for a query (D,), larger is nearer; all other images stay behind these."""
        ...


@dataclass(frozen=True, eq=False)
class RetrievalTask:
    """Queries, a gallery, and which images are right; a leaderboard has a row for each method and task."""

    name: str
    """unique within its set, such as ``drone-satellite`` or ``Rain__Sunny__front``; answers are named after it"""
    queries: tuple[ImageView, ...]
    gallery: tuple[ImageView, ...]
    relevance: Relevance
    condition_query: str = ""
    condition_gallery: str = ""
    groups: tuple[str, ...] = ()
    """group of each query (such as its building) for resampling; empty to resample blocks along the drive"""


@dataclass(frozen=True, eq=False)
class PlaceImage:
    """A training image and the place that it shows."""

    image: ImageView
    place: int
    """0 .. places - 1: images of one place have the same number, whatever the view"""
    condition: str = ""
    """weather and light in words, where they are known"""


@dataclass(frozen=True, eq=False)
class PlaceData:
    """Training data of a retriever: images of known places, none of which occurs in a test set."""

    places: int
    images: tuple[PlaceImage, ...]
    described: tuple[tuple[str, str], ...]
    """name and fingerprint of each dataset that the data comes from"""

    @property
    def views(self) -> tuple[str, ...]:
        """The views that occur, sorted."""
        return tuple(sorted({one.image.view for one in self.images}))


class RetrievalSet(Protocol):
    """All retrieval tasks on one dataset."""

    @property
    def name(self) -> str: ...

    @property
    def fingerprint(self) -> str:
        """A hash of everything that can change a score.

        A set may also have a ``question``, a digest equal for copies whose images differ in last digits, by which
        results are then compared.
        """
        ...

    def tasks(self) -> Sequence[RetrievalTask]: ...

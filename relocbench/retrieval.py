"""The contract between relocbench and a retriever: what it is given, what it answers.

A retriever is any object with ``describe``; it inherits nothing and is found by the entry-point group
``relocbench.retrievers``, by a dotted path, or not at all where rankings were made elsewhere. It describes images by
vectors; keyframes are ranked by the dot product of theirs with the query's. It may also order the first K anew
(``rerank``), and learn from the gallery before it describes anything (``fit``).

The views hold no label, no position and no pose: what the answer is judged by is never seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from relocbench.metrics.retrieval.relevance import Relevance

Image = NDArray[np.uint8]
Descriptors = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class ImageView:
    """An image as a retriever sees it; it is read when it is looked at."""

    key: str
    """names the image within its set; says nothing about the place"""
    view: str
    """from where it was taken: ``street``, ``drone``, ``satellite``"""
    read: Callable[[], Image]
    """raises DatasetError"""
    content: str = ""
    """digest of what the image holds, where it is known: images of one view with the same are described once"""

    @cached_property
    def image(self) -> Image:
        """(H, W, 3) RGB uint8."""
        return self.read()


@runtime_checkable
class Retriever(Protocol):
    """Describes images so that images of one place are near."""

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        """Descriptors (N, D) of N images, float32 or float64; larger dot product = nearer place.

        An image that cannot be described has a row of NaN: it retrieves nothing, and is not retrieved.

        Raises:
            MethodError: the method cannot go on.
        """
        ...


@runtime_checkable
class FittingRetriever(Retriever, Protocol):
    """Learns from the images of the gallery first (a vocabulary, whitening); without labels, as a map would be made."""

    def fit(self, gallery: Sequence[ImageView], seed: int) -> None:
        """Called once, before any ``describe``."""
        ...


@runtime_checkable
class RerankingRetriever(Retriever, Protocol):
    """Orders the first of a ranking anew."""

    rerank_top: int
    """K: so many of the first are handed over; 0 for none"""

    def rerank(self, query: Descriptors, candidates: Descriptors) -> Descriptors:
        """Scores (K,) of candidates (K, D) for a query (D,); larger is nearer. Those after the first K stay behind."""
        ...


@dataclass(frozen=True, eq=False)
class RetrievalTask:
    """Queries, a gallery, and which of it is right: one row of a leaderboard is a method on one task."""

    name: str
    """unique within its set, as ``drone-satellite`` or ``Rain__Sunny__front``; names the files of the answers"""
    queries: tuple[ImageView, ...]
    gallery: tuple[ImageView, ...]
    relevance: Relevance
    condition_query: str = ""
    condition_gallery: str = ""
    groups: tuple[str, ...] = ()
    """of each query: what is resampled together where intervals are made (a building); empty: blocks along the drive"""


@dataclass(frozen=True, eq=False)
class PlaceImage:
    """An image to learn from, and what it shows."""

    image: ImageView
    place: int
    """0 .. places - 1: images of one place have one number, whatever the view"""
    condition: str = ""
    """weather and light in words, where they are known"""


@dataclass(frozen=True, eq=False)
class PlaceData:
    """What a retriever learns from: images of known places. No place of it is in what a method is tested on."""

    places: int
    images: tuple[PlaceImage, ...]
    described: tuple[tuple[str, str], ...]
    """dataset's name and fingerprint, of each that it was made of"""

    @property
    def views(self) -> tuple[str, ...]:
        """Which there are, sorted."""
        return tuple(sorted({one.image.view for one in self.images}))


class RetrievalSet(Protocol):
    """Everything a retriever is asked on one dataset."""

    @property
    def name(self) -> str: ...

    @property
    def fingerprint(self) -> str:
        """A hash of everything that can change a score.

        A set that also has a ``question``, the same for copies whose images differ in last digits, is compared by that.
        """
        ...

    def tasks(self) -> Sequence[RetrievalTask]: ...

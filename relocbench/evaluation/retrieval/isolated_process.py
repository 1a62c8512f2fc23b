"""The process of a retriever: it is shown images under digests for keys, and holds no dataset and no labels."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, overload

from relocbench.arrays import Image
from relocbench.errors import RelocbenchError
from relocbench.evaluation.isolation.isolated_process import Arrays, Connection, serve
from relocbench.evaluation.isolation.method_process import NEEDS
from relocbench.evaluation.isolation.views import read_only
from relocbench.evaluation.retrieval.local import CallResult, LocalRetriever, create_retriever
from relocbench.methods import MethodSpec
from relocbench.retrieval import Descriptors, ImageView

Named = tuple[str, str]
"""key and view of an image"""
Shown = tuple[str, str, Image]
"""key and view of an image, and the image"""


def main(descriptor: int) -> None:
    """Answer requests about a retriever from a socket, which the descriptor names, until its other end is closed."""
    serve(descriptor, _made)


def _made(spec: MethodSpec, connection: Connection) -> tuple[object, dict[str, Any]]:
    retriever = LocalRetriever(create_retriever(spec))
    declared = {
        "fits": retriever.fits,
        "rerank_top": retriever.rerank_top,
        "rerank_fault": retriever.rerank_fault,
    }
    return _RequestHandler(retriever, connection), declared


class _RequestHandler:
    """The requests of the protocol, by name."""

    def __init__(self, retriever: LocalRetriever, connection: Connection) -> None:
        self._retriever = retriever
        self._connection = connection

    def info(self) -> tuple[Any, Arrays]:
        return {"info": self._retriever.info}, []

    def fit(self, gallery: list[Named], seed: int) -> tuple[Any, Arrays]:
        return _answer(lambda: (None, *self._retriever.fit(_Gallery(gallery, self._connection), seed)[1:]))

    def warm_up(self, images: list[Shown]) -> tuple[Any, Arrays]:
        return _answer(lambda: self._retriever.warm_up(_views(images)))

    def describe(self, images: list[Shown]) -> tuple[Any, Arrays]:
        return _answer(lambda: self._retriever.describe(_views(images)))

    def rerank(self, query: Descriptors, candidates: Descriptors) -> tuple[Any, Arrays]:
        return _answer(lambda: self._retriever.rerank(query, candidates))


class _Gallery(Sequence[ImageView]):
    """A gallery whose images are fetched from the evaluator when they are looked at; none is kept."""

    def __init__(self, named: Sequence[Named], connection: Connection, indices: Sequence[int] | None = None) -> None:
        self._named, self._connection = named, connection
        self._indices = range(len(named)) if indices is None else indices
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, index: int) -> ImageView: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[ImageView]: ...
    def __getitem__(self, index: int | slice) -> ImageView | Sequence[ImageView]:
        if isinstance(index, slice):
            return _Gallery(self._named, self._connection, self._indices[index])
        at = self._indices[index]
        key, view = self._named[at]
        return ImageView(key, view, partial(self._fetch, at))

    def _fetch(self, index: int) -> Image:
        with self._lock:
            self._connection.answer({NEEDS: index})
            image: Image = self._connection.request()
        return read_only(image)


def _views(images: Sequence[Shown]) -> list[ImageView]:
    return [ImageView(key, view, partial(read_only, image)) for key, view, image in images]


def _answer(call: Callable[[], CallResult]) -> tuple[Any, Arrays]:
    try:
        values, _, crash = call()
    except RelocbenchError as bad:
        return {"raised": str(bad)}, []
    return {"broke": crash}, [] if values is None else [values]

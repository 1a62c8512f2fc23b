"""Retrievers with known behaviour, named by dotted path in tests of the contract."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from relocbench.retrieval import Descriptors, ImageView


class Thumbnail:
    """Grey thumbnails without their mean, of norm 1; a line in ``log`` for each image that it describes."""

    def __init__(self, side: int = 8, log: str = "", seed: int = 0) -> None:
        self.side = side
        self.log = log

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        if self.log:
            with Path(self.log).open("a") as stream:
                stream.writelines(f"{one.key}\n" for one in images)
        return np.stack([self.vector(one.image) for one in images])

    def vector(self, image: np.ndarray) -> np.ndarray:
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        small = cv2.resize(grey, (self.side, self.side), interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
        small -= small.mean()
        return small / max(float(np.linalg.norm(small)), 1e-6)


class FromFile(Thumbnail):
    """Reads its side from a file, and tells of it."""

    def __init__(self, weights: Path) -> None:
        super().__init__(side=int(weights.read_text()))

    @property
    def info(self) -> dict[str, Any]:
        return {"side": np.int64(self.side), "from": "a file"}


class Constant(Thumbnail):
    """Everything looks the same."""

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        return np.ones((len(images), 4), dtype=np.float32)


class Picky(Thumbnail):
    """Raises on the n-th image it sees, or describes it by NaN; images are known by their digests."""

    def __init__(self, raises: str = "", blind: str = "", always: bool = False) -> None:
        super().__init__()
        self.raises, self.blind, self.always = raises, blind, always

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        if self.always or any(one.key == self.raises for one in images):
            raise ZeroDivisionError("on\npurpose")
        out = super().describe(images)
        out[[one.key == self.blind for one in images]] = np.nan
        return out


class Whitened(Thumbnail):
    """Learns the mean of the gallery first; refuses to describe before, and to learn twice."""

    def __init__(self, breaks: bool = False) -> None:
        super().__init__()
        self.breaks = breaks
        self.mean: np.ndarray | None = None

    def fit(self, gallery: Sequence[ImageView], seed: int) -> None:
        if self.breaks:
            raise ValueError("too few images")
        assert self.mean is None
        self.mean = np.mean([self.vector(one.image) for one in gallery], axis=0)

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        assert self.mean is not None
        out: Descriptors = super().describe(images) - self.mean
        return out


class OfItsProcess(Whitened):
    """Tells which process it lives in."""

    @property
    def info(self) -> dict[str, Any]:
        return {"process": os.getpid()}


class Reversing(Thumbnail):
    """Turns the first K of each ranking round."""

    def __init__(self, top: int = 2, fault: str = "") -> None:
        super().__init__()
        self.rerank_top = top
        self.fault = fault

    def rerank(self, query: Descriptors, candidates: Descriptors) -> Descriptors:
        if self.fault == "raise":
            raise ZeroDivisionError("rerank")
        scores = -(candidates @ query)
        return np.full(len(scores), np.nan) if self.fault == "nan" else scores


class Ends(Thumbnail):
    """Interrupts the run at the n-th call, as its user does."""

    def __init__(self, log: str = "", calls: int = 1) -> None:
        super().__init__(log=log)
        self.calls = calls

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        out = super().describe(images)
        if len(Path(self.log).read_text().splitlines()) >= self.calls:
            signal.raise_signal(signal.SIGINT)  # an exception alone would be the method's own fault
        return out


class WrongShapes:
    """Breaks the contract in a way that ``answer`` chooses."""

    def __init__(self, answer: int = 0) -> None:
        self.answer = answer

    def describe(self, images: Sequence[ImageView]) -> Any:
        n = len(images)
        return (None, np.zeros(n), np.zeros((n + 1, 3)), np.zeros((n, 3), dtype=int), np.zeros((n, 0)))[self.answer]


class NotARetriever:
    pass


def makes_nothing() -> object:
    """A factory whose product keeps no contract."""
    return object()

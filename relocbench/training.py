"""The contract between relocbench and a method that learns: what it is given, what it leaves behind.

A trainer is any object with ``default_options`` and ``train``; it inherits nothing and is found by the entry-point
group ``relocbench.trainers``. It gets pairs of images with ground-truth correspondences, and a way to try what it has
learnt as a tracker on pairs that it never learns from.

A trainer of places has ``train_places`` in place of ``train``. It gets images of known places, and a way to try what it
has learnt as a retriever on places that it never learns from.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from relocbench.progress import Reporter, Silent
from relocbench.retrieval import PlaceData, Retriever
from relocbench.tracking import Tracker


@dataclass(frozen=True)
class PairLabel:
    """What a training pair shows, known without reading it."""

    dataset: str
    """name and short fingerprint: traversals of different datasets are different"""
    traversal_ref: str
    traversal_query: str
    camera: str
    condition_ref: str
    """in words, equal for all traversals of one condition"""
    condition_query: str


@dataclass(frozen=True, eq=False)
class TrainingPair:
    """Two images and the pixels in them that see the same surface points.

    What is hidden in either is left out, as far as the data's depth tells.
    """

    label: PairLabel
    image_ref: NDArray[np.uint8]
    """(H, W, 3) RGB; a grey image has three equal channels"""
    image_query: NDArray[np.uint8]
    """(H, W, 3)"""
    u_ref: NDArray[np.float32]
    """(N, 2) pixels (u, v), centres at integers"""
    u_query: NDArray[np.float32]
    """(N, 2)"""
    sigma_px: NDArray[np.float32] | None = None
    """(N,) one standard deviation of ``u_query``, NaN where unknown; None where the data does not tell"""


class TrainingData(Protocol):
    """Pairs to learn from. It can be pickled, and each process reads for itself."""

    def __len__(self) -> int: ...

    def label(self, index: int) -> PairLabel:
        """What a pair is, without reading it, so that pairs can be drawn evenly over conditions and traversals."""
        ...

    def load(self, index: int) -> TrainingPair:
        """Read one pair. Raises DatasetError."""
        ...

    def describe(self) -> Mapping[str, str]:
        """What it is made of: dataset's name -> fingerprint."""
        ...


@dataclass(frozen=True)
class ValidationScores:
    """What a tracker scored on the validation pairs, or a retriever on the validation places."""

    together: Mapping[str, float]
    """metric's name -> value over all pairs; of a retriever: mean over the directions"""
    by_conditions: Mapping[str, Mapping[str, float]]
    """``REFERENCE -> QUERY`` -> metric's name -> value; of a retriever by ``QUERY-GALLERY`` view, and more than the
    metrics: what chance would score, how far descriptors spread"""
    pairs: Mapping[str, int]
    """how many of each ``REFERENCE -> QUERY``; of a retriever: queries of each direction"""
    messages: tuple[str, ...] = ()
    """what broke, if anything did: the first of each kind"""


Validate = Callable[[Tracker], ValidationScores]
"""Tracks the same pairs at each call; the tracker is used as ``relocbench evaluate`` uses it."""

ValidateRetriever = Callable[[Retriever], ValidationScores]
"""Retrieves among the same held-out places at each call, by descriptors alone."""


@dataclass(frozen=True)
class TrainingRun:
    """Where and how a training runs; nothing here changes what is learnt on a CPU."""

    out: Path
    """folder of what is left behind; a folder with a checkpoint is gone on with"""
    name: str = ""
    """what the trainer was asked for by"""
    command: str = ""
    """that makes this run again"""
    workers: int = 1
    """background processes that read pairs; 0 for none"""
    device: str = "cpu"
    reporter: Reporter = field(default_factory=Silent)


@dataclass(frozen=True)
class TrainingReport:
    """What a training left behind."""

    weights: Path
    steps: int
    scores: ValidationScores | None
    """of the weights that were kept; None without validation"""
    best_step: int


@runtime_checkable
class Trainer(Protocol):
    """A method that learns."""

    def default_options(self) -> dict[str, Any]:
        """All options, nested, as plain values for YAML."""
        ...

    def train(
        self, data: TrainingData, validate: Validate | None, options: Mapping[str, Any], run: TrainingRun
    ) -> TrainingReport:
        """Learn, keep the weights that validate best, or the last ones where there is no validation.

        Args:
            data: pairs to learn from.
            validate: see :data:`Validate`.
            options: nested as ``default_options``; what is absent has its default.
            run: where and how.

        Raises:
            ConfigError: an option that does not exist or makes no sense.
            MethodError: the training broke down, or ``run.out`` holds another one.
        """
        ...


@runtime_checkable
class PlaceTrainer(Protocol):
    """A retriever that learns."""

    def default_options(self) -> dict[str, Any]:
        """All options, nested, as plain values for YAML."""
        ...

    def train_places(
        self, data: PlaceData, validate: ValidateRetriever | None, options: Mapping[str, Any], run: TrainingRun
    ) -> TrainingReport:
        """Learn, keep the weights that validate best, or the last ones where there is no validation.

        Args:
            data: images to learn from.
            validate: see :data:`ValidateRetriever`.
            options: nested as ``default_options``; what is absent has its default.
            run: where and how.

        Raises:
            ConfigError: an option that does not exist or makes no sense, or data that the options do not fit.
            MethodError: the training broke down, or ``run.out`` holds another one.
        """
        ...


@runtime_checkable
class ConfiguredTrainer(Protocol):
    """A trainer of several systems, told apart by the option ``configuration``, each with options of its own."""

    configurations: tuple[str, ...]
    """their names, which ``relocbench train --config`` takes"""

    def options_of(self, configuration: str) -> dict[str, Any]:
        """As ``default_options``, of one system. Raises ConfigError."""
        ...

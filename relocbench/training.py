"""The contract of trainers: what a method that learns is given, and what it leaves behind.

A trainer is any object with ``default_options`` and ``train``. It inherits nothing and is found by the entry-point
group ``relocbench.trainers``. It gets pairs of images with ground-truth correspondences, and a function that scores it
as a tracker on pairs that it does not learn from.

A trainer of places has ``train_places`` instead of ``train``. It gets images of known places, and a function that
scores it as a retriever on places that it does not learn from.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from relocbench.arrays import Array, Floats, Image
from relocbench.geometry import Camera
from relocbench.progress import Reporter, Silent
from relocbench.retrieval import PlaceData, Retriever
from relocbench.tracking import KeyframePoints, Tracker


@dataclass(frozen=True)
class PairLabel:
    """Facts about a training pair that are known without reading it."""

    dataset: str
    """name and short fingerprint, which distinguish traversals of different datasets"""
    traversal_ref: str
    traversal_query: str
    camera: str
    """of the query"""
    condition_ref: str
    """in words, equal for all traversals of one condition"""
    condition_query: str
    camera_ref: str = ""
    """of the keyframe; empty where it is the query's"""


@dataclass(frozen=True, eq=False)
class TrainingPair:
    """Two images and the pixels in them that see the same surface points.

    Points that are hidden in either image are left out, as far as the depth of the data shows it.
    """

    label: PairLabel
    image_ref: Image
    """(H, W, 3) RGB; a grey image has three equal channels"""
    image_query: Image
    """(H, W, 3)"""
    u_ref: Floats
    """(N, 2) pixels (u, v), centres at integers"""
    u_query: Floats
    """(N, 2)"""
    sigma_px: Floats | None = None
    """(N,) one standard deviation of ``u_query``, NaN where unknown; None where the data has none"""


class TrainingData(Protocol):
    """Pairs to learn from. The object can be pickled, and each process reads for itself."""

    def __len__(self) -> int: ...

    def label(self, index: int) -> PairLabel:
        """The label of a pair, which is not read, so that pairs can be drawn evenly over conditions and traversals."""
        ...

    def load(self, index: int) -> TrainingPair:
        """Read one pair. Raises DatasetError."""
        ...

    def describe(self) -> Mapping[str, str]:
        """The names and fingerprints of the datasets that the data comes from."""
        ...


@dataclass(frozen=True, eq=False)
class PosedPair:
    """The true pose between the images of a training pair, which are named and not read."""

    image_ref: str
    """its name for :meth:`PosedTrainingData.view`; an image that belongs to several pairs has one name"""
    image_query: str
    T_query_ref: Array
    """(4, 4)"""


@dataclass(frozen=True, eq=False)
class TrainingView:
    """One image of the training data with its camera."""

    image: Image
    """(H, W, 3) RGB; a grey image has three equal channels"""
    camera: Camera
    points: KeyframePoints
    """pixels with known depth; none where the image is not a keyframe, or depth was not requested"""


class PosedTrainingData(TrainingData, Protocol):
    """Training data with true poses and cameras, for trainers of what predicts poses.

    Images can be read one by one, so that what is computed of an image can be kept for all of its pairs.
    """

    def posed(self, index: int) -> PosedPair:
        """The true pose of a pair; no image is read. Raises DatasetError where poses are withheld."""
        ...

    def view(self, name: str, *, depth: bool) -> TrainingView:
        """Read one image by the name that :meth:`posed` gives, with or without depth. Raises DatasetError."""
        ...


@dataclass(frozen=True)
class ValidationScores:
    """The scores of a tracker on the validation pairs, or of a retriever on the validation places."""

    together: Mapping[str, float]
    """metric -> value over all pairs; for a retriever, the mean over the directions"""
    by_conditions: Mapping[str, Mapping[str, float]]
    """``REFERENCE -> QUERY`` conditions -> metric -> value; for a retriever ``QUERY-GALLERY`` views, or conditions of
    its only view -> metric, chance level and spread of descriptors"""
    pairs: Mapping[str, int]
    """number of pairs for each ``REFERENCE -> QUERY``; for a retriever, of queries for each direction"""
    messages: tuple[str, ...] = ()
    """what broke, if anything did: the first message of each kind"""


Validate = Callable[[Tracker], ValidationScores]
"""Tracks the same pairs at each call, and uses the tracker as ``relocbench evaluate`` does."""

ValidateRetriever = Callable[[Retriever], ValidationScores]
"""Retrieves among the same held-out places at each call, by descriptors alone."""


@dataclass(frozen=True)
class TrainingRun:
    """Where and how a training runs; nothing in it changes what is learnt on a CPU."""

    out: Path
    """output folder; if it holds a checkpoint, that training is resumed"""
    name: str = ""
    """the name by which the trainer was requested"""
    command: str = ""
    """the command that repeats this run"""
    workers: int = 1
    """number of background processes that read pairs; 0 for none"""
    device: str = "cpu"
    reporter: Reporter = field(default_factory=Silent)
    tensorboard: Path | None = None
    """folder for event files of TensorBoard, of what is logged anyway; None: there are none"""


@dataclass(frozen=True)
class TrainingReport:
    """The results of a training."""

    weights: Path
    steps: int
    scores: ValidationScores | None
    """of the weights that were kept; None without validation"""
    best_step: int


@runtime_checkable
class Trainer(Protocol):
    """A method that learns.

    A trainer that learns from poses and images alone declares so by an attribute ``needs_correspondences = False``: its
    pairs are all that have a true pose, and the datasets need no correspondences.
    """

    def default_options(self) -> dict[str, Any]:
        """All options, nested, as plain values for YAML."""
        ...

    def train(
        self, data: PosedTrainingData, validate: Validate | None, options: Mapping[str, Any], run: TrainingRun
    ) -> TrainingReport:
        """Train, and keep the weights that validate best, or the last ones if there is no validation.

        Args:
            data: pairs to learn from. A trainer that needs no poses may ask for :class:`TrainingData` only.
            validate: see :data:`Validate`.
            options: nested as ``default_options``; missing options have their defaults.
            run: where and how to train.

        Raises:
            ConfigError: an unknown or invalid option.
            MethodError: the training failed, or ``run.out`` holds another training.
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
        """Train, and keep the weights that validate best, or the last ones if there is no validation.

        Args:
            data: images to learn from.
            validate: see :data:`ValidateRetriever`.
            options: nested as ``default_options``; missing options have their defaults.
            run: where and how to train.

        Raises:
            ConfigError: an unknown or invalid option, or data that the options do not fit.
            MethodError: the training failed, or ``run.out`` holds another training.
        """
        ...


@runtime_checkable
class ConfiguredTrainer(Protocol):
    """A trainer of several systems with options of their own, selected by the option ``configuration``."""

    configurations: tuple[str, ...]
    """names of the systems, which ``relocbench train --config`` takes"""

    def options_of(self, configuration: str) -> dict[str, Any]:
        """The default options of one system. Raises ConfigError."""
        ...

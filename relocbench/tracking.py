"""The contract of trackers: what a tracker is given, and what it returns.

A tracker is any object with a ``track`` method; it inherits nothing. It never sees the ground truth, which the views
below do not hold.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.errors import one_line, raised
from relocbench.geometry import Camera

MOST_QUERIES = 8
"""queries of a keyframe about which an evaluation asks in one call"""


@dataclass(frozen=True, eq=False)
class KeyframePoints:
    """Pixels of a keyframe with known depth."""

    uv: Array
    """(N, 2) pixels, centres at integers"""
    inverse_depth: Array
    """(N,) 1/m, positive"""
    sigma: Array
    """(N,) standard deviation of the inverse depth, 1/m"""

    def __post_init__(self) -> None:
        n = len(self.uv)
        if self.uv.shape != (n, 2) or self.inverse_depth.shape != (n,) or self.sigma.shape != (n,):
            raise ValueError(
                f"keyframe points need uv (N, 2), inverse_depth (N,), sigma (N,); got {self.uv.shape}, "
                f"{self.inverse_depth.shape}, {self.sigma.shape}"
            )

    def __len__(self) -> int:
        return len(self.uv)


@dataclass(frozen=True, eq=False)
class Neighbour:
    """Another frame of the reference's own traversal, with its pose relative to the reference by the map."""

    seconds_from_ref: float
    """time from the reference to this frame, negative before it"""
    image: Image
    """(H, W) grey or (H, W, 3) RGB"""
    camera: Camera
    T_neighbour_ref: Array
    """(4, 4)"""


@dataclass(frozen=True, eq=False)
class Reference:
    """A keyframe of the map: image, camera, and depth where it is known."""

    key: str
    """identifies the keyframe; a tracker that is evaluated sees a digest of image and camera"""
    timestamp_ns: int | None
    """when the image was taken; None for a tracker that does not declare ``uses_times``"""
    image: Image
    """(H, W) grey or (H, W, 3) RGB"""
    camera: Camera
    sparse_points: KeyframePoints | None = None
    """points of a sparse map; None where the keyframe has a dense depth image"""
    depth: Floats | None = None
    """(H, W) metres along z, 0 where unknown; None where the map is sparse"""
    depth_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(a, b, c): sigma of a dense depth z is a + b z + c z^2, metres"""
    neighbours: Sequence[Neighbour] = ()

    @cached_property
    def points(self) -> KeyframePoints:
        """All pixels with known depth, from a sparse or dense map."""
        if self.sparse_points is not None:
            return self.sparse_points
        if self.depth is None:
            return KeyframePoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
        v, u = np.nonzero(self.depth > 0)
        z = self.depth[v, u].astype(np.float64)
        a, b, c = self.depth_sigma
        sigma_z = a + b * z + c * z * z
        points = (np.stack([u, v], axis=-1).astype(np.float64), 1.0 / z, sigma_z / (z * z))
        for array in points:
            array.flags.writeable = False  # they are cached for later callers
        return KeyframePoints(*points)

    @cached_property
    def inverse_depth_map(self) -> Floats:
        """(H, W) inverse depth in 1/m, 0 where unknown; of sparse points rounded to one pixel, the nearest counts."""
        out = np.zeros((self.camera.height, self.camera.width), dtype=np.float32)
        if self.depth is not None:
            known = self.depth > 0
            out[known] = 1.0 / self.depth[known]
            out.flags.writeable = False
            return out
        points = self.points
        u, v = np.rint(points.uv).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < out.shape[1]) & (v < out.shape[0])
        np.maximum.at(out, (v[inside], u[inside]), points.inverse_depth[inside].astype(np.float32))
        out.flags.writeable = False
        return out


@dataclass(frozen=True, eq=False)
class Query:
    """An image to be relocalized."""

    key: str
    """identifies the image; a tracker that is evaluated sees a digest of image and camera"""
    timestamp_ns: int | None
    """when the image was taken; None for a tracker that does not declare ``uses_times``"""
    image: Image
    """(H, W) grey or (H, W, 3) RGB"""
    camera: Camera


@dataclass(frozen=True, eq=False)
class TrackResult:
    """A tracker's answer: a pose, or a reported failure."""

    T_query_ref: Array | None
    """(4, 4) maps points of the reference camera to the query camera; None when the method failed"""
    confidence: float | None = None
    """higher is more certain, on any scale; compared only among answers of the same method"""
    message: str = ""
    """the reason of a failure, or a remark"""
    info: Mapping[str, Any] = field(default_factory=dict)
    """any further numbers and words: inliers, energy, iterations, ...; up to 8192 characters of JSON are kept"""

    @classmethod
    def failure(cls, message: str, **info: Any) -> TrackResult:
        """An answer without a pose, with the reason."""
        return cls(T_query_ref=None, message=message, info=info)

    @property
    def answered(self) -> bool:
        return self.T_query_ref is not None


@runtime_checkable
class Tracker(Protocol):
    """A method that finds the pose of one pair.

    The parameters of a tracker are the keyword arguments of its constructor, with their annotations and defaults:
    ``--set key=value`` sets them and ``run.yaml`` records them. A parameter called ``seed`` gets the run's seed.

    ``run.yaml`` records the content of files that parameters name as a ``Path``. A class that reads other files
    (weights that come with it) lists them in a class method ``files(**parameters) -> Mapping[str, Path]``.

    ``reference`` is what :meth:`SupportsPrepare.prepare` returned where the tracker has it, the
    :class:`Reference` itself otherwise. ``prior`` is a (4, 4) initial guess of ``T_query_ref``, or None; a tracker
    that uses it declares so by a class attribute ``uses_prior = True``. A tracker that wants frames around the
    keyframe declares their number on each side by ``neighbours = N``.

    Times say where along a drive an image was taken, so that a tracker sees none, and pairs come in random order.
    A tracker of sequences declares ``uses_times = True``: it gets the times of keyframes and queries and
    the pairs in order of time, and is not ranked with the others.
    """

    def track(self, reference: Any, query: Query, prior: Array | None = None) -> TrackResult: ...


@runtime_checkable
class SupportsPrepare(Protocol):
    """Optional: work that is done once for each reference, for all its queries (features, point selection, ...)."""

    def prepare(self, reference: Reference) -> Any: ...


@runtime_checkable
class SupportsBatch(Protocol):
    """Optional: answer several queries of one reference together.

    An evaluation gives up to :data:`MOST_QUERIES`; an attribute ``batch_size = N`` makes it at most N.
    """

    def track_batch(
        self, reference: Any, queries: Sequence[Query], priors: Sequence[Array | None]
    ) -> Sequence[TrackResult]: ...


@runtime_checkable
class SupportsMatching(Protocol):
    """Optional: find single pixels of a reference in a query, to measure matching quality.

    ``uv_ref`` (N, 2) are pixels of the reference, ``uv_start`` (N, 2) start pixels in the query, float64, with centres
    at integers. The result is (N, 2) pixels of the query, NaN where there is no answer. It is where the method's own
    per-pixel Gauss-Newton ends: each answer depends on its own pixel and start alone, not on the others in the call.
    """

    def match(self, reference: Any, query: Query, uv_ref: Array, uv_start: Array) -> Array: ...


@runtime_checkable
class SupportsLevelMatching(Protocol):
    """Optional, in addition to :class:`SupportsMatching`: matches found on each single level of the image pyramid.

    The result is one (N, 2) array for each level, finest first, in pixels of the image: where the method's Gauss-Newton
    ends if it uses that level only. The number of levels is the same for every pair.
    """

    def match_levels(self, reference: Any, query: Query, uv_ref: Array, uv_start: Array) -> Sequence[Array]: ...


class FeatureMap(Protocol):
    """One level of a method's features of an image."""

    @property
    def map(self) -> Floats:
        """(H, W, D)"""
        ...


class FeatureMaps(Protocol):
    """A method's features of an image, level by level."""

    @property
    def levels(self) -> Sequence[FeatureMap]:
        """Finest first; pixel (u, v) of level l is the place ((u + 0.5) 2^l - 0.5, (v + 0.5) 2^l - 0.5)."""
        ...


@runtime_checkable
class SupportsFeatures(Protocol):
    """Optional: return the dense features that the method computes of an image, so that they can be drawn."""

    def features(self, image: Image, camera: Camera) -> FeatureMaps: ...


class ContractFault(Exception):
    """An answer that breaks the contract; the message says why."""


def plain_pixels(ends: object, count: int) -> Array:
    """A copy (N, 2) float64 of a result of ``match`` for ``count`` pixels. Raises ContractFault if it is not valid."""
    if not isinstance(ends, np.ndarray) or not np.issubdtype(ends.dtype, np.floating):
        kind = f"an array of {ends.dtype}" if isinstance(ends, np.ndarray) else type(ends).__name__
        raise ContractFault(f"match returned {kind}, expected an array of floats")
    pixels = np.asarray(ends)  # a plain array: a subclass could behave differently at each look
    if pixels.shape != (count, 2):
        raise ContractFault(f"match returned shape {pixels.shape}, expected ({count}, 2)")
    with np.errstate(over="ignore"):
        pixels = np.array(pixels, dtype=np.float64)
    if np.isinf(pixels).any():
        raise ContractFault("match returned an infinite pixel; a pixel without an answer is NaN")
    return pixels


def plain_result(result: object) -> TrackResult:
    """A copy of an answer, with the pose as (4, 4) float64 and the confidence as float; message and info are kept.

    Each field is read once, so that what was checked is what is used.

    Raises:
        ContractFault: the answer breaks the contract.
        Exception: whatever an object of the method's raises when it is read.
    """
    if not isinstance(result, TrackResult):
        raise ContractFault(f"returned {type(result).__name__}, expected TrackResult")
    pose, confidence, message, info = result.T_query_ref, result.confidence, result.message, result.info
    return TrackResult(
        None if pose is None else _plain_pose(pose),
        None if confidence is None else _plain_confidence(confidence),
        message,
        info,
    )


def _plain_confidence(value: Any) -> float:
    """A confidence as float; scalars of NumPy and PyTorch are accepted. Raises ContractFault."""
    if getattr(value, "shape", ()) != ():
        raise ContractFault(
            f"confidence is an array of shape {one_line(value.shape, 60)}, expected a finite number or None"
        )
    if isinstance(value, str | bytes):
        raise ContractFault(f"confidence is '{one_line(value, 60)}', expected a finite number or None")
    if not hasattr(value, "__float__"):
        raise ContractFault(f"confidence is a {type(value).__name__}, expected a finite number or None")
    try:
        number = float.__float__(float(value))
    except OverflowError:
        raise ContractFault("confidence is too large for a float, expected a finite number or None") from None
    if not math.isfinite(number):
        raise ContractFault(f"confidence is {number!r}, expected a finite number or None")
    return number


def _plain_pose(value: Any) -> Array:
    """A pose as (4, 4) float64, from floats or integers. Raises ContractFault."""
    try:
        given = np.asarray(value)
    except ValueError as bad:
        raise ContractFault(f"T_query_ref is not an array: {raised(bad)}") from None
    if given.shape != (4, 4):
        raise ContractFault(f"T_query_ref has shape {given.shape}, expected (4, 4)")
    if not (np.issubdtype(given.dtype, np.floating) or np.issubdtype(given.dtype, np.integer)):
        raise ContractFault(f"T_query_ref is an array of {one_line(given.dtype, 60)}, expected floats")
    with np.errstate(all="ignore"):
        pose = np.array(given, dtype=np.float64)
        if not np.all(np.isfinite(pose)):
            raise ContractFault("T_query_ref is not finite")
        rotation = pose[:3, :3]
        # Huge numbers overflow to NaN, which "not at most" rejects and "more than" would accept.
        off = not np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-3
        if off or np.linalg.det(rotation) < 0:
            raise ContractFault("T_query_ref is not a rigid transform (its rotation is off SO(3) by more than 1e-3)")
    if np.abs(pose[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise ContractFault("the last row of T_query_ref is not 0 0 0 1")
    return pose

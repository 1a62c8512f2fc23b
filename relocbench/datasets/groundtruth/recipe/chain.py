"""Pair after pair along a drive: the first by global registration or by hand, each other from the solution before it.

Nothing is verified, and nothing is solved for jointly: a pair is accepted by its fitness and RMSE alone, and the next
one starts from the last one that was accepted, moved along by both odometries. From the first pair, the chain goes to
the end of the drive, and then back from the first pair to the beginning.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.making import BlockOptions, reader_of
from relocbench.datasets.groundtruth.blocks.nodes import arc_length_along
from relocbench.datasets.groundtruth.pairs.outcome import nearest_keyframe, too_far
from relocbench.datasets.groundtruth.pairs.pairing import CameraFrames
from relocbench.datasets.groundtruth.recipe.open3d_pair import (
    FEWEST_POINTS,
    Cloud,
    Open3dFit,
    Open3dOptions,
    refine,
    search,
)
from relocbench.datasets.groundtruth.registration.along_drive import Remember
from relocbench.datasets.groundtruth.registration.hypotheses import SearchResult
from relocbench.datasets.groundtruth.registration.submap_pair import NOTHING_JUDGED, unregistered
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.geometry import invert, path_lengths, spaced

Solved = tuple[int, int, Array]
"""a pair that the next one starts from: (reference time, query time, ``T_ref_query`` of the rigs)"""

NO_START = "no pair before it was accepted"
_NAN = np.full((4, 4), np.nan)


@dataclass(frozen=True, eq=False)
class ChainUnit:
    """One camera of a query drive and of the reference: a unit of work."""

    reference: FieldRecording
    query: FieldRecording
    images: CameraFrames
    submap_m: float = 60.0
    max_distance_m: float = 5.0
    max_angle_deg: float = 60.0
    first: Solved | None = None
    """a pose by hand"""
    options: Open3dOptions = field(default_factory=Open3dOptions)

    def __str__(self) -> str:
        return f"pairs of {self.query.name} with {self.reference.name}, {self.images.camera}"


def follow(
    unit: ChainUnit,
    say: Callable[[str], None] = lambda message: None,
    remember: Remember = lambda key, work: work(),
) -> list[Registration]:
    """The pairs of a query drive: one for each query image, in their order.

    ``ref`` and ``query`` of a pair are numbers of its keyframe and of its query image, and its pose is that of the rigs
    at the times of both. Its evidence has fitness as ``overlap_query`` and RMSE as ``residual_query_m``.

    Args:
        say: takes what a user should know.
        remember: see :class:`relocbench.datasets.groundtruth.registration.journal.Journal`.

    Raises:
        DatasetError: a scan is damaged.
    """
    return _Chain(unit, say, remember).run()


class _Chain:
    def __init__(self, unit: ChainUnit, say: Callable[[str], None], remember: Remember) -> None:
        self._unit, self._say, self._remember = unit, say, remember
        submaps = [RawSubmaps(r, unit.submap_m) for r in (unit.reference, unit.query)]
        # A keyframe is often that of several queries.
        self._clouds = [lru_cache(2)(lambda ns, s=s: Cloud.of(s.around(ns), unit.options)) for s in submaps]
        self._known = unit.query.odometry.covers(np.array(unit.images.query_ns, dtype=np.int64))
        keyframes = np.array(unit.images.ref_ns, dtype=np.int64)
        self._T_odom_keyframe = unit.reference.odometry.at(keyframes) @ unit.images.T_rig_refcam

    def run(self) -> list[Registration]:
        count = len(self._unit.images.query_ns)
        registrations: dict[int, Registration] = {}
        start, first = self._start()
        if first is not None:
            for rows in (range(start, count), range(start - 1, -1, -1)):
                last = first
                for row in rows:
                    registrations[row] = self._pair(row, last)
                    if registrations[row].trusted:
                        last = self._solved(registrations[row])
        return [registrations.get(row) or self._untried(row, NO_START) for row in range(count)]

    def _solved(self, pair: Registration) -> Solved:
        return self._unit.images.ref_ns[pair.ref], self._unit.images.query_ns[pair.query], pair.T_ref_query

    def _untried(self, row: int, reason: str, keyframe: int = 0) -> Registration:
        if not self._known[row]:
            reason = "no odometry at the time of the query"
        return unregistered((keyframe, row), _NAN, reason)

    def _pair(self, row: int, last: Solved) -> Registration:
        """A query image with its nearest keyframe by the last pair's solution."""
        unit, time = self._unit, self._unit.images.query_ns[row]
        if not self._known[row]:
            return self._untried(row, "")
        T_odom_query = self._predicted(last, time)
        keyframe, reason = self._nearest(T_odom_query @ unit.images.T_rig_querycam)
        if reason:
            return self._untried(row, reason, keyframe)
        ref_ns = unit.images.ref_ns[keyframe]
        T_ref_query = invert(unit.reference.odometry.at(np.array([ref_ns]))[0]) @ T_odom_query
        return self._refined(keyframe, row, T_ref_query)

    def _predicted(self, last: Solved, time_ns: int) -> Array:
        """(4, 4) pose of the query's rig at a time in the reference's odometry."""
        reference, query = self._unit.reference.odometry, self._unit.query.odometry
        ref_ns, query_ns, T_ref_query = last
        T_odom_ref = reference.at(np.array([ref_ns]))[0]
        then, now = query.at(np.array([query_ns, time_ns]))
        return np.asarray(T_odom_ref @ T_ref_query @ invert(then) @ now)

    def _nearest(self, T_odom_querycam: Array) -> tuple[int, str]:
        """The nearest keyframe that is turned by no more than is allowed, and why it is not paired; empty if it is."""
        keyframes = self._T_odom_keyframe
        every = np.ones(len(keyframes), dtype=bool)
        best, reason = nearest_keyframe(keyframes, T_odom_querycam, self._unit.max_angle_deg, every)
        apart = np.linalg.norm(keyframes[[best], :3, 3] - T_odom_querycam[:3, 3], axis=1)
        return best, reason or too_far(float(apart[0]), self._unit.max_distance_m)

    def _refined(self, keyframe: int, row: int, T_ref_query: Array | None) -> Registration:
        """ICP of a pair from a prediction; from that of RANSAC if there is none."""
        times = self._unit.images.ref_ns[keyframe], self._unit.images.query_ns[row]
        kind = "search" if T_ref_query is None else "pair"
        result = self._remember(
            f"{kind} {times[0]} {times[1]}",
            lambda: SearchResult(self._register(keyframe, row, *times, T_ref_query)),
        )
        assert result.best is not None
        return result.best

    def _register(self, keyframe: int, row: int, ref_ns: int, query_ns: int, T_ref_query: Array | None) -> Registration:
        ref, query = self._clouds[0](ref_ns), self._clouds[1](query_ns)
        fewest = min(len(ref), len(query))
        if fewest < FEWEST_POINTS:
            return unregistered((keyframe, row), _NAN, f"one of its submaps has {fewest} points")
        options = self._unit.options
        start = search(ref, query, options) if T_ref_query is None else T_ref_query
        fit = refine(ref, query, start, options)
        reason = fit.refusal(options)
        if not reason and T_ref_query is not None:
            reason = too_far(self._offset_m(fit), self._unit.max_distance_m)
        evidence = replace(NOTHING_JUDGED, overlap_query=fit.fitness, residual_query_m=fit.rmse_m)
        return Registration(keyframe, row, fit.T_ref_query, fit.information, evidence, reason)

    def _offset_m(self, fit: Open3dFit) -> float:
        T_refcam_querycam = invert(self._unit.images.T_rig_refcam) @ fit.T_ref_query @ self._unit.images.T_rig_querycam
        return float(np.linalg.norm(T_refcam_querycam[:3, 3]))

    def _start(self) -> tuple[int, Solved | None]:
        """The row of the first query image and a pair near it: by hand, else by global registration."""
        unit = self._unit
        rows = np.flatnonzero(self._known).tolist()
        if not rows:
            return 0, None
        times = np.array(unit.images.query_ns, dtype=np.int64)[rows]
        if unit.first is not None:
            return rows[int(np.argmin(np.abs(times - unit.first[1])))], unit.first
        # Where the drives do not overlap, the search is repeated further along the query's drive.
        ways = path_lengths(unit.query.odometry.at(times)[:, :3, 3])
        tried = -np.inf
        reason = ""
        for row, way in zip(rows, ways, strict=True):
            if way - tried < unit.submap_m / 2:
                continue
            tried = way
            registration = self._searched(row)
            if registration is not None and registration.trusted:
                self._say(f"first pair by Open3D's global registration, {way:.0f} m along the drive")
                return row, self._solved(registration)
            reason = registration.reason if registration is not None else reason
        self._say(
            f"global registration found no first pair{f' (the last try: {reason})' if reason else ''}; give one by "
            "--first-pose"
        )
        return 0, None

    def _searched(self, row: int) -> Registration | None:
        """The best fit of a query image with some keyframes; None if no keyframe is near by GNSS."""
        registrations = [self._refined(keyframe, row, None) for keyframe in self._candidates(row)]
        return max(
            registrations, key=lambda pair: (pair.trusted, np.nan_to_num(pair.evidence.overlap_query)), default=None
        )

    def _candidates(self, row: int) -> Sequence[int]:
        """The keyframe that is nearest by GNSS; without GNSS keyframes half a submap apart."""
        unit, time = self._unit, np.array([self._unit.images.query_ns[row]])
        prior = unit.reference.prior, unit.query.prior
        times = np.array(unit.images.ref_ns, dtype=np.int64)
        if prior[0] is not None and prior[1] is not None and prior[1].covers(time)[0]:
            known = np.flatnonzero(prior[0].covers(times))
            if len(known):
                predicted = prior[0].at(times[known])[:, :3, 3]
                apart = np.linalg.norm(predicted - prior[1].at(time)[0, :3, 3], axis=1)
                near = int(np.argmin(apart))
                return [int(known[near])] if apart[near] <= unit.submap_m else []
        return spaced(self._T_odom_keyframe[:, :3, 3], unit.submap_m / 2)


class RawSubmaps:
    """All points that the lidars of one drive measured along a stretch of road, put together along the odometry.

    Unlike the submaps of blocks they are made anew around any time, and keep moving things and all points of a voxel.
    """

    def __init__(self, recording: FieldRecording, length_m: float) -> None:
        """
        Args:
            length_m: metres of road of a submap.

        Raises:
            DatasetError: odometry and lidars have no time in common.
        """
        self._odometry = recording.odometry
        self._half_m = length_m / 2
        self._way = arc_length_along(recording)
        self._reader = reader_of(recording, self._way, BlockOptions())

    def around(self, time_ns: int) -> Array:
        """(N, 3) points in the frame of the rig at a time that the odometry covers.

        Raises:
            DatasetError: a scan is damaged.
        """
        begin, end = self.span(time_ns)
        at = np.array([time_ns], dtype=np.int64)
        return np.asarray(self._reader.between(begin, end, self._odometry.at(at)[0]).points)

    def span(self, time_ns: int) -> tuple[int, int]:
        """First time and end, exclusive, of the stretch of road, within the segment of the odometry."""
        times, way = self._way.times_ns, self._way.travelled_m
        row = int(np.clip(np.searchsorted(times, time_ns, side="right") - 1, 0, len(times) - 1))
        mine = self._way.segment == self._way.segment[row]
        at = self._way.at(np.array([time_ns], dtype=np.int64))[0]
        inside = times[mine & (np.abs(way - at) <= self._half_m)]
        if not len(inside):
            return time_ns, time_ns + 1
        return int(min(inside[0], time_ns)), int(max(inside[-1], time_ns)) + 1

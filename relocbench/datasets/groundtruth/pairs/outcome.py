"""The outcome of a pair: its pose and covariance, or the reason why it is rejected."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.pose_graph.graph import Solution
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import adjoint, interpolate, invert, rotation_angle

SOURCE = "lidar registration, pose graph"
_SYSTEMATIC = np.diag(np.repeat([0.0007**2, np.radians(0.004) ** 2], 3))
"""(6, 6) covariance of errors that do not average out however many points are matched, such as a bias of ranges that
depends on the surface"""

_END_M, _END_FACTOR = 5.0, 1.5
"""where trusted registrations reach less far to one side along the query's drive, sigma along the street is so many
times that of the graph: at the end of the common road, edges have no neighbours that would show their errors"""


@dataclass(frozen=True)
class OutcomeLimits:
    """Limits within which a pair is accepted."""

    distance_m: float = 10.0
    """largest distance between the cameras"""
    evidence_m: float = 15.0
    """largest distance, along each drive, to the nearest trusted registration"""
    both_sides_m: float = 30.0
    """largest distance, along the query's drive, to trusted registrations both before and after; if one is further
    away, the limits on sigmas are reduced"""
    one_sided: float = 0.5
    """factor of this reduction"""
    sigma_m: float = 0.05
    """largest sigma of the position along each axis"""
    sigma_rotation_deg: float = 0.15
    contradiction_m: float = 30.0
    """least distance, along either drive, from an odometry edge that registrations contradict"""


@dataclass(frozen=True, eq=False)
class PairOutcome:
    """A pair (keyframe, query), accepted or rejected."""

    ref_timestamp_ns: int
    query_timestamp_ns: int
    T_query_ref: Array | None = None
    """(4, 4) camera to camera; None if it is unknown"""
    covariance: Array | None = None
    """(6, 6) of ``xi`` in ``T_ref_query @ se3_exp(xi)``, camera to camera, in the query camera's axes"""
    sigma_along_m: float | None = None
    """standard deviation of the query camera's centre along the query rig's x"""
    sigma_across_m: float | None = None
    """along its y"""
    sigma_height_m: float | None = None
    """along its z"""
    sigma_rotation_deg: float | None = None
    """standard deviation of the rotation about one axis: ``sqrt(trace / 3)``"""
    reason: str = ""
    """why it is rejected; empty if it is accepted"""
    source: str = SOURCE
    """how it was obtained"""

    @property
    def accepted(self) -> bool:
        return not self.reason

    @property
    def sigma_translation_m(self) -> float | None:
        """Standard deviation of the position along one axis: ``sqrt(trace / 3)``, metres."""
        return None if self.covariance is None else float(np.sqrt(np.trace(self.covariance[:3, :3]) / 3))

    def rejected(self, reason: str) -> PairOutcome:
        """The same pair, rejected for a reason."""
        return replace(self, reason=reason)

    def pair(self) -> Pair:
        """The pair as a row of a pair set."""
        return Pair(
            self.ref_timestamp_ns,
            self.query_timestamp_ns,
            self.T_query_ref if self.accepted else None,
            sigma_translation_m=self.sigma_translation_m,
            sigma_rotation_deg=self.sigma_rotation_deg,
            source=self.source,
            accepted=self.accepted,
            reason=self.reason,
            sigma_along_m=self.sigma_along_m,
            sigma_across_m=self.sigma_across_m,
            sigma_height_m=self.sigma_height_m,
        )


def axis_sigmas(covariance: Array, R_rig_cam: Array) -> tuple[float, float, float, float]:
    """Sigmas along, across, in height and of rotation (degrees) of a covariance (6, 6) in the query camera's axes.

    It is rotated into the axes of the camera's rig, with x along the street.
    """
    along, across, height = np.sqrt(np.diagonal(R_rig_cam @ covariance[:3, :3] @ R_rig_cam.T)).tolist()
    return along, across, height, float(np.degrees(np.sqrt(np.trace(covariance[3:, 3:]) / 3)))


def nearest_keyframe(T_keyframes: Array, T_querycam: Array, max_angle_deg: float, among: Mask) -> tuple[int, str]:
    """Row of the nearest keyframe that is turned by at most ``max_angle_deg``.

    If there is none, the nearest of all and why it is rejected.

    Args:
        T_keyframes: (M, 4, 4) poses of the keyframes.
        T_querycam: (4, 4) in the same frame.
        among: (M,) keyframes to choose from, at least one.
    """
    apart = np.linalg.norm(T_keyframes[:, :3, 3] - T_querycam[:3, 3], axis=1)
    turned = np.degrees(rotation_angle(np.swapaxes(T_keyframes[:, :3, :3], -1, -2) @ T_querycam[:3, :3]))
    fit = among & (turned <= max_angle_deg)
    best = int(np.argmin(np.where(fit if fit.any() else among, apart, np.inf)))
    return best, "" if fit.any() else f"no keyframe within {max_angle_deg:g} deg: {turned[best]:.0f} deg"


def too_far(apart_m: float, limit_m: float) -> str:
    """Why a keyframe is too far away to be paired; empty if it is not."""
    return f"no keyframe within {limit_m:g} m: nearest {apart_m:.0f} m" if apart_m > limit_m else ""


@dataclass(frozen=True, eq=False)
class RigPose:
    """Pose of the rig at some time, by the pose graph."""

    node: int
    """number of the nearest node of its drive"""
    T_world_rig: Array
    """(4, 4)"""
    distance_m: float
    """distance from that node"""


@dataclass(frozen=True, eq=False)
class SolvedDrive:
    """One of the two drives of a solved pose graph."""

    nodes: Nodes
    odometry: Trajectory
    T_world_node: Array
    """(K, 4, 4) poses of the nodes, by the graph"""

    def place(self, time_ns: int) -> RigPose | None:
        """The pose of the rig at a time, by odometry from the nodes around it.

        None if the odometry has no pose then, or if no node around it is on the same piece of the odometry.

        Between two nodes the poses by either are interpolated, so that the result is continuous.
        """
        if not bool(self.odometry.covers(np.array([time_ns]))[0]):
            return None
        T_odom_rig = self.odometry.at(np.array([time_ns]))[0]
        times = self.nodes.times_ns
        after = int(np.searchsorted(times, time_ns, side="right"))
        around = [n for n in (after - 1, after) if 0 <= n < len(times)]
        pieces = self.odometry.pieces(np.array([time_ns, *times[around]]))
        around = [n for n, piece in zip(around, pieces[1:], strict=True) if piece == pieces[0]]
        if not around:
            return None
        steps = [invert(self.nodes.T_odom_node[n]) @ T_odom_rig for n in around]
        distances = [float(np.linalg.norm(T[:3, 3])) for T in steps]
        poses = [self.T_world_node[n] @ T for n, T in zip(around, steps, strict=True)]
        nearest = int(np.argmin(distances))
        if len(around) == 1 or sum(distances) < 1e-9:
            return RigPose(around[nearest], poses[nearest], distances[nearest])
        T_world_rig = interpolate(poses[0], poses[1], distances[0] / (distances[0] + distances[1]))
        return RigPose(around[nearest], T_world_rig, distances[nearest])


class Outcomes:
    """Computes the outcomes of pairs of two drives. Calls in the order of the road are fastest."""

    def __init__(
        self,
        solution: Solution,
        reference: tuple[Nodes, Trajectory],
        query: tuple[Nodes, Trajectory],
        registrations: Sequence[Registration] = (),
        limits: OutcomeLimits | None = None,
        white_noise: tuple[Array, Array] = (np.zeros(6), np.zeros(6)),
    ) -> None:
        """
        Args:
            reference, query: the nodes of each drive and its odometry.
            white_noise: (6,) of each drive, standard deviations of the odometry's white noise, metres and radians.
            registrations: those that the solution was made from; they give the reason where none is trusted.
        """
        self.solution = solution
        self.limits = limits or OutcomeLimits()
        self.reference = SolvedDrive(*reference, solution.T_world_ref)
        self.query = SolvedDrive(*query, solution.T_world_query)
        self._registrations = registrations
        self._white = tuple(np.diag(np.square(sigmas)) for sigmas in white_noise)

    @cached_property
    def _way_to_contradiction(self) -> Array:
        """(N,) arc length from each node to the nearest odometry edge that registrations contradict, metres."""
        bad = [node for edge in self.solution.contradicted_odometry() for node in edge]
        out: Array = self.solution.drives.arc_length_to(np.array(bad, dtype=np.int64)).min(axis=1)
        return out

    @cached_property
    def _at_end(self) -> Mask:
        """(Q,) whether trusted registrations reach less far than ``_END_M`` to one side of each node of the query."""
        drives, limits = self.solution.drives, self.limits
        count = drives.reference_count
        way, segment = drives.travelled_m[count:], drives.segment[count:]
        trusted = np.flatnonzero((self.solution.arc_length_to_trusted[count:] == 0).all(axis=1))
        out = np.ones(len(way), dtype=np.bool_)
        for node in range(len(way)):
            ahead = (way[trusted] - way[node])[segment[trusted] == segment[node]]
            ahead = ahead[np.abs(ahead) <= limits.both_sides_m]
            out[node] = not len(ahead) or min(-ahead.min(), ahead.max()) < _END_M
        return out

    def of(self, ref_ns: int, query_ns: int, T_rig_refcam: Array, T_rig_querycam: Array) -> PairOutcome:
        """The outcome of a pair of a query and its nearest keyframe.

        Args:
            ref_ns, query_ns: times of the images.
            T_rig_refcam, T_rig_querycam: (4, 4) extrinsics of both cameras.
        """
        ref, query = self.reference.place(ref_ns), self.query.place(query_ns)
        if ref is None or query is None:
            which = "keyframe" if ref is None else "query"
            return PairOutcome(ref_ns, query_ns, reason=f"no odometry at the time of the {which}")
        if not self.solution.connected(ref.node, query.node):
            return PairOutcome(ref_ns, query_ns, reason=f"not registered: {self._why(query.node)}")
        covariance = self._covariance(ref, query, T_rig_querycam)
        T_query_ref = invert(query.T_world_rig @ T_rig_querycam) @ ref.T_world_rig @ T_rig_refcam
        R = T_rig_querycam[:3, :3]
        along, across, height, rotation = axis_sigmas(covariance, R)
        reason = self._rejection(ref, query, T_query_ref, (along, across, height, rotation))
        if reason.startswith("sigma") and self.solution.shared is not None:
            alone = axis_sigmas(self._covariance(ref, query, T_rig_querycam, shared=False), R)
            if not self._rejection(ref, query, T_query_ref, alone):
                reason = f"calibration of the lidars too uncertain: {reason}"
        return PairOutcome(ref_ns, query_ns, T_query_ref, covariance, along, across, height, rotation, reason)

    def _covariance(self, ref: RigPose, query: RigPose, T_rig_querycam: Array, shared: bool = True) -> Array:
        """(6, 6) covariance of the twist on the right of ``T_refcam_querycam``.

        It is the sum of the covariances of the nodes' relative pose and of the odometry from each node to its image,
        all transformed to the query camera.
        """
        solution = self.solution
        nodes = solution.covariance(ref.node, query.node, shared)
        T_querynode_cam = invert(solution.T_world_query[query.node]) @ query.T_world_rig @ T_rig_querycam
        T_refrig_cam = invert(ref.T_world_rig) @ query.T_world_rig @ T_rig_querycam
        out = np.zeros((6, 6))
        for T, cov in (
            (T_querynode_cam, nodes),
            (T_rig_querycam, self._motion(query.distance_m) + self._white[1]),
            (T_refrig_cam, self._motion(ref.distance_m) + self._white[0]),
        ):
            A = adjoint(invert(T))
            out += A @ cov @ A.T
        if self._at_end[query.node]:
            along = T_rig_querycam[0, :3]
            out[:3, :3] += (_END_FACTOR**2 - 1) * float(along @ out[:3, :3] @ along) * np.outer(along, along)
        return out + _SYSTEMATIC

    def _motion(self, distance_m: float) -> Array:
        """(6, 6) covariance of odometry over a distance from a node."""
        return np.diag(distance_m * self.solution.noise.sigma**2)

    def _rejection(
        self, ref: RigPose, query: RigPose, T_query_ref: Array, sigmas: tuple[float, float, float, float]
    ) -> str:
        """Why a pair is rejected, the simplest reason first; empty if it is accepted."""
        limits, count = self.limits, self.solution.drives.reference_count
        if reason := too_far(float(np.linalg.norm(T_query_ref[:3, 3])), limits.distance_m):
            return reason
        before, after = self.solution.arc_length_to_trusted[count + query.node].tolist()
        nearest = max(min(before, after), float(self.solution.arc_length_to_trusted[ref.node].min()))
        if nearest > limits.evidence_m:
            return f"not registered within {limits.evidence_m:g} m, {_metres(nearest)}: {self._why(query.node)}"
        contradiction = min(self._way_to_contradiction[ref.node], self._way_to_contradiction[count + query.node])
        if contradiction <= limits.contradiction_m:
            return f"odometry and registrations contradict each other {contradiction:.0f} m away"
        one_sided = max(before, after) > limits.both_sides_m
        share = limits.one_sided if one_sided else 1.0
        end = ", with registrations on one side only" if one_sided else ""
        for name, sigma in zip(("along", "across", "above"), sigmas[:3], strict=True):
            if sigma > share * limits.sigma_m:
                return f"sigma {name} the street {sigma:.2f} m exceeds {share * limits.sigma_m:g} m{end}"
        if sigmas[3] > share * limits.sigma_rotation_deg:
            return f"sigma of rotation {sigmas[3]:.2f} deg exceeds {share * limits.sigma_rotation_deg:g} deg{end}"
        return ""

    def _why(self, query_node: int) -> str:
        """The most frequent reason why registrations near a query node are not trusted."""
        nodes, at = self.query.nodes, self.query.nodes.travelled_m[query_node]
        reasons = [
            verdict or "its registration is checked by no other"
            for registration, verdict, trusted in zip(
                self._registrations, self.solution.verdicts, self.solution.trusted, strict=False
            )
            if abs(nodes.travelled_m[registration.query] - at) <= self.limits.evidence_m and not trusted
        ]
        return Counter(reasons).most_common(1)[0][0] if reasons else "no registration was found there"


def _metres(distance_m: float) -> str:
    return "nor anywhere along the drive" if np.isinf(distance_m) else f"nearest {distance_m:.0f} m"

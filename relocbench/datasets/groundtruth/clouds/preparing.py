"""Clouds as submaps: thinned, with planes fitted to a fixed number of neighbours, whatever their spacing.

Where the sensor is unknown, normals are turned towards the middle of the points around them, which is the inside of a
room and the air above ground, and the same for both clouds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from relocbench.arrays import Array, Floats, Indices, Mask
from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.clouds.cloud import Cloud
from relocbench.datasets.groundtruth.clouds.field_of_view import FieldOfView, field_of_view
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale
from relocbench.datasets.groundtruth.submaps.free_space import FreeSpace, Patches
from relocbench.datasets.groundtruth.submaps.planes import direction_bins
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels, thin
from relocbench.geometry import apply, invert, make_transform

_VOXEL_M, _MOST_POINTS = 0.1, 150_000
"""size of the voxels in which one point is kept; larger if more points than this are left"""
_NEIGHBOURS = (15, 40)
"""numbers of neighbours that planes are fitted to; the larger one where the first lie on a line, as on a ring"""
_FARTHEST_M = 2.5
"""neighbours further away than this do not belong to the surface"""
_FLAT, _LINE, _THICK_M = 0.22, 0.15, 0.05
"""largest ratio of thickness to breadth, least ratio of breadth to length, and largest thickness, as a standard
deviation, of neighbours on a plane"""
_LEVEL = 0.9
"""cosine of the largest angle between the ground and the horizontal"""
_GROUND_SHARE = 0.08
"""least share of level planes in a scene that has ground"""
_INSIDE_M = 8.0
"""radius of the points whose middle normals are turned to, where the sensor is unknown"""
_INDOORS = 2.0
"""scenes that are enlarged by more than this have no ground: floors and tables are structure like walls"""
_CROWDING, _PLANE_M = 0.75, 0.6
"""power of the number of patches in one plane by which the weight of each is divided, and the thickness of a plane"""
_LOW = 1 / 3
"""factor by which low patches outdoors weigh less than in a submap of 60 m: of a single scan, the cars that park beside
the sensor are a large part"""
_NEAR_POINTS_M = 1.0
"""where a sensor is unknown, a cloud could see what is so near to its points"""
_MOST_SENSORS = 64
"""positions of sensors whose fields of view are looked at; more belong to a moving sensor"""
_THROUGH_ITSELF = 0.05
"""a cloud was not measured from where its own beams go through more than this share of its surfaces"""


class PreparedCloud(PreparedSubmap):
    """A cloud as one side of a registration, in enlarged metres, in the frame of its node.

    Indoors, surface patches weigh less the more of them lie in one plane: all rooms have a floor and walls, and only
    what stands in them tells one from another. Outdoors the ground is left out of them instead.
    """

    def __init__(self, submap: Submap, T_cloud_node: Array, sees: bool, by_points: bool) -> None:
        """
        Args:
            T_cloud_node: (4, 4) of the node in the cloud's frame, enlarged.
            sees: whether the sensor's positions are known.
            by_points: whether what a cloud could see is judged by where it has points, not by its sensors.
        """
        super().__init__(submap)
        self.T_cloud_node, self.sees, self.by_points = T_cloud_node, sees, by_points

    @cached_property
    def space(self) -> FreeSpace:
        return _Space(self.submap, self.sees, self.by_points)

    @cached_property
    def outdoors(self) -> bool:
        """Whether the cloud has ground."""
        return bool(np.any(self.submap.surface == Surface.GROUND))

    def judged_by_points(self) -> PreparedCloud:
        """The same cloud, for a pair in which one sensor is unknown."""
        return self if self.by_points else PreparedCloud(self.submap, self.T_cloud_node, self.sees, True)


class _Space(FreeSpace):
    """Free space of a cloud whose sensor may be unknown."""

    def __init__(self, submap: Submap, sees: bool, by_points: bool) -> None:
        super().__init__(submap)
        self._sees, self._by_points = sees, by_points
        if by_points:
            self.same_place_m = _NEAR_POINTS_M

    @cached_property
    def low_height_m(self) -> float:
        submap = self.submap
        level = submap.points[(submap.surface == Surface.GROUND) & (np.abs(submap.normals[:, 2]) > _LEVEL), 2]
        # Where nothing is known to be the ground, no height is low.
        return self.low_m + float(np.median(level)) if len(level) else -np.inf

    @cached_property
    def patches(self) -> Patches:
        patches = super().patches
        weights = patches.weights
        if not np.any(self.submap.surface == Surface.GROUND) and len(patches):
            weights = weights / np.power(_crowd(patches), _CROWDING)
        else:
            weights = np.where(patches.middle[:, 2] < self.low_height_m, _LOW * weights, weights)
        return replace(patches, origins=patches.middle if self._by_points else patches.origins, weights=weights)

    @cached_property
    def sensor_positions(self) -> Array:
        if not self._by_points:
            return super().sensor_positions
        points = self.submap.points.astype(np.float64)
        return np.asarray(points[first_in_voxels(points, _NEAR_POINTS_M / 3)])

    @cached_property
    def fields_of_view(self) -> list[FieldOfView]:
        """Those of the sensors; none where all sensors have everything in view, or where they are not known."""
        if not self._sees:
            return []
        origins = self.submap.origins.astype(np.float64)
        positions, which = np.unique(origins, axis=0, return_inverse=True)
        if len(positions) > _MOST_SENSORS:
            return []
        points, which = self.submap.points.astype(np.float64), which.reshape(-1)
        fields = [field_of_view(position, points[which == k]) for k, position in enumerate(positions)]
        return fields if any(len(field.sides) for field in fields) else []

    def could_see(self, patches: Patches, T_patches_this: Array) -> Mask:
        if self._by_points or not self.fields_of_view:
            return super().could_see(patches, T_patches_this)
        T_this_patches = invert(T_patches_this)
        middle, origins = apply(T_this_patches, patches.middle), apply(T_this_patches, patches.origins)
        seen = np.zeros(len(patches), dtype=bool)
        for field in self.fields_of_view:
            near = np.linalg.norm(origins - field.position, axis=1) < self.same_place_m
            seen |= near & field.holds(middle)
        return seen

    @cached_property
    def beams(self) -> tuple[Array, Array]:
        return super().beams if self._sees else (np.zeros((0, 3)), np.zeros((0, 3)))


def _crowd(patches: Patches) -> Array:
    """(V,) number of patches in the plane that each patch lies in, roughly."""
    bins = direction_bins(patches.normals)
    count = np.bincount(bins)
    mean = np.column_stack([np.bincount(bins, patches.normals[:, k]) for k in range(3)]) / np.maximum(count, 1)[:, None]
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    offset = np.floor(np.einsum("ni,ni->n", patches.middle, mean[bins]) / _PLANE_M).astype(np.int64)
    _, plane = np.unique(bins * 100_000 + offset, return_inverse=True)
    sizes: Array = np.bincount(plane).astype(np.float64)
    return sizes[plane]


@dataclass(frozen=True, eq=False)
class Preparation:
    """A prepared cloud, and what is known of its sensor."""

    prepared: PreparedCloud
    sensor: Literal["known", "supposed", "refuted", "unknown"]
    """``supposed``: the origin, which the points do not contradict; ``refuted``: they do"""


def prepare(cloud: Cloud, scale: SceneScale) -> Preparation:
    """Enlarge a cloud, thin it, and fit planes; a supposed sensor is checked against the cloud itself."""
    submap, T_cloud_node = submap_of(cloud, scale)
    if cloud.sensors is None:
        return Preparation(PreparedCloud(submap, T_cloud_node, False, True), "unknown")
    prepared = PreparedCloud(submap, T_cloud_node, True, False)
    if not cloud.supposed:
        return Preparation(prepared, "known")
    space = prepared.space
    votes = space.votes_of(space.beams, np.eye(4))
    if votes.violations(np.zeros(len(space.patches), dtype=bool)) <= _THROUGH_ITSELF:
        return Preparation(prepared, "supposed")
    submap, T_cloud_node = submap_of(replace(cloud, sensors=None), scale)
    return Preparation(PreparedCloud(submap, T_cloud_node, False, True), "refuted")


def submap_of(cloud: Cloud, scale: SceneScale) -> tuple[Submap, Array]:
    """The enlarged submap of a cloud in the frame of its node, and ``T_cloud_node`` (4, 4), enlarged.

    The node is where the sensor was on average, or the middle of the points; its axes are those of the cloud.
    """
    points = cloud.points * scale.factor
    sensors = None if cloud.sensors is None else cloud.sensors * scale.factor
    middle = np.median(points, axis=0) if sensors is None else sensors.mean(axis=0)
    points = points - middle
    keep = _thinned(points)
    points = np.ascontiguousarray(points[keep])
    sensors = None if sensors is None else sensors[keep] - middle
    normals, plane = fit_planes(points)
    stated = None if cloud.normals is None else cloud.normals[keep]
    normals = _oriented(points, normals, sensors, stated)
    surface = np.where(plane, Surface.STRUCTURE, Surface.ROUGH)
    if scale.factor <= _INDOORS:
        axis = _up(normals[plane])
        if axis is not None:
            surface[plane & (np.abs(normals[:, axis]) > _LEVEL)] = Surface.GROUND
    # Only the errors of odometry grow with the lever arm, so that a rigid cloud has none.
    origins = np.zeros_like(points) if sensors is None else sensors
    submap = Submap(
        points=points.astype(np.float32),
        normals=np.where(plane[:, None], normals, 0.0).astype(np.float32),
        origins=origins.astype(np.float32),
        surface=surface.astype(np.uint8),
        steady=np.ones(len(points), np.float32),
        block=np.zeros(len(points), np.int32),
    )
    return submap, make_transform(np.eye(3), middle)


def _thinned(points: Array) -> Indices:
    voxel_m = _VOXEL_M
    keep: Indices = thin(points, voxel_m)
    while len(keep) > _MOST_POINTS:
        voxel_m *= max(float(np.sqrt(len(keep) / _MOST_POINTS)), 1.1)
        keep = thin(points, voxel_m)
    return keep


def fit_planes(points: Array) -> tuple[Array, Mask]:
    """Unit normals (N, 3), of either sign, of planes near points (N, 3), and (N,) where one fits."""
    normals, plane = np.zeros_like(points), np.zeros(len(points), dtype=bool)
    tree, undecided = cKDTree(points), np.arange(len(points))
    for wanted in _NEIGHBOURS:
        count = min(wanted, len(points))
        distances, rows = tree.query(points[undecided], k=count, distance_upper_bound=_FARTHEST_M, workers=1)
        near = np.isfinite(np.asarray(distances))
        group = points[np.where(near, rows, 0)]
        weight = near / np.maximum(near.sum(axis=1, keepdims=True), 1)
        mean = np.einsum("nk,nki->ni", weight, group)
        centred = group - mean[:, None]
        values, vectors = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, centred, centred))
        enough = near.sum(axis=1) >= 8
        broad = values[:, 1] >= _LINE**2 * values[:, 2]
        normals[undecided] = vectors[:, :, 0]
        thin_enough = values[:, 0] <= np.minimum(_FLAT**2 * values[:, 1], _THICK_M**2)
        plane[undecided] = enough & broad & thin_enough
        undecided = undecided[enough & ~broad]
        if not len(undecided):
            break
    return normals, plane


def _oriented(points: Array, normals: Array, sensors: Array | None, stated: Array | None) -> Array:
    """Normals (N, 3) turned towards the sensor, as the file states them, or towards the inside."""
    if sensors is not None:
        towards = sensors - points
    elif stated is not None:
        towards = stated
    else:
        coarse = points[first_in_voxels(points, 0.5)]
        balls = cKDTree(coarse).query_ball_point(coarse, _INSIDE_M, workers=1)
        middles = np.array([coarse[ball].mean(axis=0) for ball in balls])
        towards = middles[np.asarray(cKDTree(coarse).query(points, workers=1)[1])] - points
    away = np.einsum("ni,ni->n", normals, np.nan_to_num(towards)) < 0
    return np.where(away[:, None], -normals, normals)


def _up(normals: Floats | Array) -> int | None:
    """The axis along which the ground's normals point: z if there are level planes, else the most frequent axis."""
    if not len(normals):
        return None
    shares = [float(np.mean(np.abs(normals[:, axis]) > _LEVEL)) for axis in range(3)]
    axis = 2 if shares[2] >= _GROUND_SHARE else int(np.argmax(shares))
    return axis if shares[axis] >= _GROUND_SHARE else None

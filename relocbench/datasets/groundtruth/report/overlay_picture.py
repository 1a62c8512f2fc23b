"""``overlay_NN.png``: the points of both drives around a pair from above, coloured by drive, with enlarged details.

If the pose is right, corners of both colours agree in the details to the thickness of a line. A shift along the street
shows at walls across it, and a wrong height shows at the road.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from relocbench.arrays import Array, Bytes, Mask
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.report.figures import QUERY, REFERENCE, shortened, write_figure
from relocbench.datasets.groundtruth.report.inspected import InspectedSet, Spot, relative_pose
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.geometry import apply, invert, make_transform

_LENGTH_M, _WIDTH_M = 60.0, 30.0
_PIXEL_M = 0.05
_DETAIL_M = 3.0
"""size of the cells in which places for details are searched"""
_CLOSE_M = 1.6
"""size of the area that a detail shows"""
_APART_M = 8.0
_DIRECTIONS = 12
"""number of bins for the directions of walls seen from above, over half a turn"""
_STEADY = 0.5


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of one drive in the frame of the reference node, with x along the road and z up."""

    points: Array
    """(N, 3)"""
    normals: Array
    """(N, 3)"""
    surface: Bytes
    """(N,)"""

    @classmethod
    def of(cls, submap: Submap, T_ref_node: Array) -> Cloud:
        """The static points of a submap."""
        keep = submap.steady >= _STEADY
        points = apply(T_ref_node, submap.points[keep].astype(np.float64))
        return cls(points, submap.normals[keep] @ T_ref_node[:3, :3].T, submap.surface[keep])

    @property
    def upright(self) -> Mask:
        """(N,) whether each point lies on an upright plane."""
        return np.asarray((self.surface == Surface.STRUCTURE) & (np.abs(self.normals[:, 2]) < 0.5))


def write_overlay(path: Path, inspected: InspectedSet, spot: Spot, number: int) -> None:
    """Draw one pair, placed by :func:`relative_pose`."""
    relative = relative_pose(inspected, spot.pair)
    windows = [inspected.window(side, _LENGTH_M / 2) for side in (0, 1)]
    if relative.T_ref_query is None:
        clouds = [
            Cloud.of(w.at(node), np.eye(4)) for w, node in zip(windows, (relative.ref, relative.query), strict=True)
        ]
        lines = [*_title(spot, number), "their relative pose is unknown: each drive on its own"]
        write_figure(path, (12, 12.5), lambda figure: _draw_apart(figure, clouds[0], clouds[1], lines))
        return
    T_ref_world = invert(inspected.reference.T_world_node[relative.ref])
    T_querynode_world = invert(inspected.query.T_world_node[relative.query])
    keyframe = (T_ref_world @ inspected.reference.at(spot.pair.ref_timestamp_ns))[:3, 3]
    image = (relative.T_ref_query @ T_querynode_world @ inspected.query.at(spot.pair.query_timestamp_ns))[:3, 3]
    # The query image is in the middle of the picture, whose axes are those of the reference node.
    T_view_ref = make_transform(np.eye(3), -image * (1, 1, 0))
    ref = Cloud.of(windows[0].at(relative.ref), T_view_ref)
    query = Cloud.of(windows[1].at(relative.query), T_view_ref @ relative.T_ref_query)
    lines = [*_title(spot, number), f"relative pose by: {shortened(relative.source, 110)}"]
    away = (keyframe - image)[:2]
    write_figure(path, (12, 10.5), lambda figure: _draw(figure, ref, query, away, lines))


def _title(spot: Spot, number: int) -> list[str]:
    pair = spot.pair
    head = f"{number}: {shortened(spot.why, 110)}"
    key = f"keyframe {pair.ref_timestamp_ns}, query {pair.query_timestamp_ns}"
    return [head, key, _state(pair)]


def _state(pair: Pair) -> str:
    sigmas = [f"{name} {100 * s:.1f}" for name, s in zip(("along", "across", "height"), pair.axis_sigmas, strict=True)
              if s is not None]  # fmt: skip
    stated = f"sigma {', '.join(sigmas)} cm" if sigmas else "no sigma"
    if pair.sigma_rotation_deg is not None:
        stated += f", {pair.sigma_rotation_deg:.3f} deg"
    if sigmas and not pair.has_calibrated_sigmas:
        stated += " (not calibrated)"
    return f"accepted, {stated}" if pair.accepted else f"REJECTED: {shortened(pair.reason, 110)}; {stated}"


def _draw(figure: Figure, ref: Cloud, query: Cloud, keyframe: Array, lines: list[str]) -> None:
    image = np.zeros(2)
    figure.suptitle("\n".join(lines), fontsize=10)
    grid = figure.add_gridspec(2, 4, height_ratios=(1.9, 1.1))
    above = figure.add_subplot(grid[0, :])
    title = (
        f"structure from above; dark: both drives; grey: road; circle: keyframe, {np.linalg.norm(keyframe):.1f} m away"
    )
    _from_above(above, [(ref, REFERENCE), (query, QUERY)], title)
    for place, colour, marker in ((keyframe, REFERENCE, "o"), (image, QUERY, "^")):
        above.plot(*place, marker, color=colour, markeredgecolor="black", markersize=8)
    above.set_xlim(-_LENGTH_M / 2, _LENGTH_M / 2)
    above.set_ylim(-_WIDTH_M / 2, _WIDTH_M / 2)
    details = detail_places(ref, query, image)
    for k in range(2):
        axes = figure.add_subplot(grid[1, k])
        if k >= len(details):
            axes.set_axis_off()
            continue
        corner = details[k] - _CLOSE_M / 2
        above.add_patch(Rectangle((corner[0], corner[1]), _CLOSE_M, _CLOSE_M, fill=False, color="#000000", lw=1))
        x, y = (details[k] + _CLOSE_M / 2).tolist()
        above.text(x, y, "ab"[k], fontsize=11, fontweight="bold")
        _detail(axes, ref, query, details[k], f"{'ab'[k]}: walls from above")
    _section(figure.add_subplot(grid[1, 2]), ref, query)
    _road(figure.add_subplot(grid[1, 3]), ref, query)


def _draw_apart(figure: Figure, ref: Cloud, query: Cloud, lines: list[str]) -> None:
    figure.suptitle("\n".join(lines), fontsize=10)
    top, bottom = figure.subplots(2, 1)
    _from_above(top, [(ref, REFERENCE)], "the reference around the keyframe")
    _from_above(bottom, [(query, QUERY)], "the query around its pose")


def _from_above(axes: Axes, clouds: list[tuple[Cloud, str]], title: str) -> None:
    """Draw structure from above: pixels have the colour of their drive, or are dark if both have points there."""
    columns, rows = round(_LENGTH_M / _PIXEL_M), round(_WIDTH_M / _PIXEL_M)
    image = np.ones((rows, columns, 3))
    for cloud, _ in clouds:
        image[_hit(cloud.points[cloud.surface == Surface.GROUND], rows, columns)] = 0.9
    masks = [_hit(c.points[c.surface == Surface.STRUCTURE], rows, columns) for c, _ in clouds]
    for mask, (_, colour) in zip(masks, clouds, strict=True):
        image[mask] = to_rgb(colour)
    if len(masks) == 2:
        image[masks[0] & masks[1]] = 0.15
    extent = (-_LENGTH_M / 2, _LENGTH_M / 2, -_WIDTH_M / 2, _WIDTH_M / 2)
    axes.imshow(image, extent=extent, origin="lower", interpolation="none")
    for k, (_, colour) in enumerate(clouds):
        name = "reference" if colour == REFERENCE else "query"
        axes.text(0.005 + 0.09 * k, 0.97, name, color=colour, transform=axes.transAxes, va="top", fontweight="bold",
                  bbox={"fc": "white", "ec": "none", "pad": 1})  # fmt: skip
    axes.set_title(title, fontsize=9)
    axes.set_ylabel("m to the left")


def _hit(points: Array, rows: int, columns: int) -> Mask:
    """(rows, columns) pixels with a point, and their right and upper neighbours, since points are 10 cm apart."""
    u = np.floor((points[:, 0] + _LENGTH_M / 2) / _PIXEL_M).astype(np.int64)
    v = np.floor((points[:, 1] + _WIDTH_M / 2) / _PIXEL_M).astype(np.int64)
    out = np.zeros((rows, columns), dtype=bool)
    for du, dv in ((0, 0), (1, 0), (0, 1), (1, 1)):
        inside = (u + du >= 0) & (u + du < columns) & (v + dv >= 0) & (v + dv < rows)
        out[v[inside] + dv, u[inside] + du] = True
    return out


def detail_places(ref: Cloud, query: Cloud, near: Array) -> list[Array]:
    """Two places (2,) near a point where both drives have walls in two directions, so that any shift shows."""
    corners = [_corners(cloud) for cloud in (ref, query)]
    both = np.minimum(corners[0], corners[1])
    middles = _cell_middles()
    score = both / (1 + np.square(np.linalg.norm(middles - near, axis=-1) / 12.0))
    out: list[Array] = []
    while len(out) < 2 and score.max() > 0:
        best = np.unravel_index(int(np.argmax(score)), score.shape)
        out.append(_centre(ref, query, middles[best]))
        score = np.where(np.linalg.norm(middles - middles[best], axis=-1) < _APART_M, 0.0, score)
    return out


def _centre(ref: Cloud, query: Cloud, middle: Array) -> Array:
    """(2,) the corner in a cell: the mean of its wall points, weighted by the rarity of their normals' directions."""
    points, normals = (
        np.concatenate([getattr(c, name)[c.upright, :2] for c in (ref, query)]) for name in ("points", "normals")
    )
    inside = np.all(np.abs(points - middle) < _DETAIL_M / 2, axis=1)
    points, normals = points[inside], normals[inside]
    least = np.linalg.eigh(normals.T @ normals)[1][:, 0]
    return np.asarray(np.average(points, axis=0, weights=np.square(normals @ least) + 1e-9))


def _cell_middles() -> Array:
    x = np.arange(-_LENGTH_M / 2, _LENGTH_M / 2, _DETAIL_M) + _DETAIL_M / 2
    y = np.arange(-_WIDTH_M / 2, _WIDTH_M / 2, _DETAIL_M) + _DETAIL_M / 2
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)


def _corners(cloud: Cloud) -> Array:
    """(X, Y) number of wall points across the main wall of each cell; less if normals are diffuse, as in trees."""
    shape = _cell_middles().shape[:2]
    points, n = cloud.points[cloud.upright], cloud.normals[cloud.upright]
    cell = np.floor((points[:, :2] + (_LENGTH_M / 2, _WIDTH_M / 2)) / _DETAIL_M).astype(np.int64)
    inside = np.all((cell >= 0) & (cell < shape), axis=1)
    index = np.ravel_multi_index((cell[inside, 0], cell[inside, 1]), shape)
    turned = np.mod(np.arctan2(n[inside, 1], n[inside, 0]), np.pi) / np.pi
    bins = np.minimum((turned * _DIRECTIONS).astype(np.int64), _DIRECTIONS - 1)
    counts = np.bincount(index * _DIRECTIONS + bins, minlength=shape[0] * shape[1] * _DIRECTIONS)
    counts = counts.reshape(-1, _DIRECTIONS)
    near = counts + np.roll(counts, 1, axis=1) + np.roll(counts, -1, axis=1)
    main = np.argmax(near, axis=1)
    # Directions at least 60 degrees from the main one.
    others = (main[:, None] + np.arange(4, _DIRECTIONS - 3)) % _DIRECTIONS
    across = np.take_along_axis(near, others, axis=1).max(axis=1)
    both = (near.max(axis=1) + across) / np.maximum(counts.sum(axis=1), 1)
    return np.asarray((across * both**3).reshape(shape))


def _detail(axes: Axes, ref: Cloud, query: Cloud, middle: Array, title: str) -> None:
    half = _CLOSE_M / 2
    _dots(axes, ref, query, lambda cloud: cloud.upright & np.all(np.abs(cloud.points[:, :2] - middle) < half, axis=1))
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    start = middle - 0.9 * half
    axes.plot([start[0], start[0] + 0.1], [start[1], start[1]], color="black", linewidth=3)
    axes.annotate("10 cm", (start[0], start[1]), (0, 4), textcoords="offset points", fontsize=8)
    axes.set_title(title, fontsize=9)


def _dots(
    axes: Axes, ref: Cloud, query: Cloud, chosen: Callable[[Cloud], Mask], columns: tuple[int, int] = (0, 1)
) -> None:
    """Draw the reference's points as wide dots and the query's as small ones on top, which lie inside if both agree."""
    for cloud, colour, size, alpha in ((ref, REFERENCE, 5.0, 0.4), (query, QUERY, 2.2, 0.9)):
        x, y = cloud.points[chosen(cloud)][:, columns].T
        axes.plot(x, y, ".", color=colour, markersize=size, alpha=alpha, markeredgewidth=0)
    axes.set_aspect("equal")
    axes.grid(True, color="#dddddd", linewidth=0.6)


def _section(axes: Axes, ref: Cloud, query: Cloud) -> None:
    _dots(axes, ref, query, lambda cloud: np.abs(cloud.points[:, 0]) < 1.0, (1, 2))
    axes.set_xlim(8, -8)
    axes.set_ylim(-3, 8)
    axes.set_title("2 m of road, looking along it", fontsize=9)


def _road(axes: Axes, ref: Cloud, query: Cloud) -> None:
    """Draw the height of the road, much exaggerated."""
    heights = []
    for cloud, colour in ((ref, REFERENCE), (query, QUERY)):
        ground = cloud.surface == Surface.GROUND
        near = ground & (np.abs(cloud.points[:, 0]) < 1.0) & (np.abs(cloud.points[:, 1]) < 5.0)
        y, z = cloud.points[near, 1], 100 * cloud.points[near, 2]
        axes.plot(y, z, ".", color=colour, markersize=2, alpha=0.4, markeredgewidth=0)
        heights.append(z)
        edges = np.arange(-5, 5.1, 0.5)
        bins = np.digitize(y, edges)
        medians = [
            np.median(z[bins == k]) if np.count_nonzero(bins == k) >= 5 else np.nan for k in range(1, len(edges))
        ]
        axes.stairs(medians, edges, baseline=None, color=colour, linewidth=2)
    every = np.concatenate(heights)
    if every.size:
        low, high = np.percentile(every, [2, 98])
        axes.set_ylim(low - 3, high + 3)
    axes.set_xlim(5, -5)
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_title("height of the road (cm)", fontsize=9)

"""Pictures of a registration: both clouds before and after it, and the distances that are left.

Where both clouds have points the pictures are dark. After a right registration few bright colours are left, except
where only one cloud was measured.
"""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from relocbench.arrays import Array, Bytes, Mask
from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.clouds.register import CloudRegistration
from relocbench.datasets.groundtruth.report.figures import QUERY, REFERENCE, shortened, write_figure
from relocbench.geometry import apply, robust_sigma

_PIXELS = 420
"""pixels along the longer side of a view"""
_MARGIN = 0.04
_KEPT_ALIKE = 10
"""characters that long names keep of what they begin with alike"""


def write_before_after(path: Path, registration: CloudRegistration, names: tuple[str, str]) -> None:
    """Draw both clouds as they were given and registered, from above and from the side."""
    factor = registration.scale.factor
    a, b = ((side.prepared.submap.points + side.prepared.T_cloud_node[:3, 3]) / factor for side in registration.sides)
    keep_a, keep_b = (_structure(side.prepared.submap.surface) for side in registration.sides)
    a, b = a[keep_a], b[keep_b]
    after = apply(registration.T_a_b, b) if np.isfinite(registration.T_a_b).all() else b
    write_figure(path, (12, 9.5), lambda figure: _draw(figure, a, (b, after), registration, names))


def _structure(surface: Bytes) -> Mask:
    """Points that are not ground, which hides what stands on it from above."""
    chosen = surface != Surface.GROUND
    return np.asarray(chosen if np.count_nonzero(chosen) > 100 else np.ones(len(surface), dtype=bool))


def _draw(
    figure: Figure, a: Array, both: tuple[Array, Array], registration: CloudRegistration, names: tuple[str, str]
) -> None:
    verdict = "TRUSTED" if registration.trusted else f"NOT TRUSTED: {shortened(registration.reason, 100)}"
    a_name, b_name = distinct_names(names)
    figure.suptitle(f"A {a_name}, B {b_name}\n{verdict}", fontsize=10)
    axes = figure.subplots(2, 2)
    for row, (b, when) in enumerate(zip(both, ("before: the frames of the files", "after"), strict=True)):
        for column, (i, j, view) in enumerate(((0, 1, "from above"), (0, 2, "from the side"))):
            _view(axes[row][column], a, b, (i, j), f"{when}, {view}")


def distinct_names(names: tuple[str, str], most: int = 50) -> list[str]:
    """Two names of at most ``most`` characters; where one is longer, without most of what both begin with."""
    if max(map(len, names)) <= most:
        return list(names)
    alike = sum(1 for _ in takewhile(lambda both: both[0] == both[1], zip(*names, strict=False)))
    alike = max(alike - _KEPT_ALIKE, 0)
    return [shortened(f"…{name[alike:]}" if alike else name, most) for name in names]


def _view(axes: Axes, a: Array, b: Array, along: tuple[int, int], title: str) -> None:
    low, high = _limits(np.concatenate([a[:, along], b[:, along]]))
    pixel = float((high - low).max()) / _PIXELS
    columns, rows = (max(int(np.ceil(size / pixel)), 1) for size in high - low)
    masks = [_hit(points[:, along], low, pixel, rows, columns) for points in (a, b)]
    image = np.ones((rows, columns, 3))
    for mask, colour in zip(masks, (REFERENCE, QUERY), strict=True):
        image[mask] = to_rgb(colour)
    image[masks[0] & masks[1]] = 0.15
    extent = (low[0], low[0] + columns * pixel, low[1], low[1] + rows * pixel)
    axes.imshow(image, extent=extent, origin="lower", interpolation="none", aspect="equal")
    for k, (name, colour) in enumerate((("A", REFERENCE), ("B", QUERY), ("both", "#262626"))):
        axes.text(0.01 + 0.05 * k, 0.98, name, color=colour, transform=axes.transAxes, va="top", fontweight="bold",
                  bbox={"fc": "white", "ec": "none", "pad": 1})  # fmt: skip
    axes.set_title(title, fontsize=9)
    axes.set_xlabel(f"{'xyz'[along[0]]} of A (m)")
    axes.set_ylabel(f"{'xyz'[along[1]]} of A (m)")


def _limits(points: Array) -> tuple[Array, Array]:
    """Lower and upper corner (2,) of the picture; a few far points do not shrink it."""
    low, high = np.percentile(points, [1, 99], axis=0)
    margin = _MARGIN * max(float((high - low).max()), 1e-6)
    return low - margin, high + margin


def _hit(points: Array, low: Array, pixel: float, rows: int, columns: int) -> Mask:
    at = np.floor((points - low) / pixel).astype(np.int64)
    inside = np.all((at >= 0) & (at < (columns, rows)), axis=1)
    out = np.zeros((rows, columns), dtype=bool)
    out[at[inside, 1], at[inside, 0]] = True
    return out


def write_residuals(path: Path, registration: CloudRegistration) -> None:
    """Draw histograms of the distances of either cloud's points from the other's surfaces."""
    write_figure(path, (8, 4), lambda figure: _draw_residuals(figure, registration))


def _draw_residuals(figure: Figure, registration: CloudRegistration) -> None:
    axes = figure.subplots()
    every = np.concatenate(registration.residuals_m)
    shown = float(np.percentile(np.abs(every), 97)) if every.size else 1.0
    factor, unit = (100.0, "cm") if shown >= 0.01 else (1000.0, "mm")
    sides = ((0, QUERY, "B's points to A's surfaces", "-"), (1, REFERENCE, "A's points to B's surfaces", "--"))
    for k, colour, name, style in sides:
        values = registration.residuals_m[k]
        if not values.size:
            continue
        sigma, middle = factor * robust_sigma(values, np.ones_like(values)), factor * float(np.median(values))
        edges = (np.linspace(-shown, shown, 81) * factor).tolist()
        weights = np.full(values.size, 100 / values.size)
        axes.hist(factor * values, edges, weights=weights, histtype="step", color=colour, linestyle=style,
                  linewidth=1.5,
                  label=f"{name}\nrobust sigma {sigma:.2f} {unit}, median {middle:+.2f} {unit}")  # fmt: skip
    if every.size:
        axes.legend(fontsize=8, frameon=False, loc="upper left")
    axes.axvline(0, color="#999999", linewidth=0.6)
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_xlabel(f"distance ({unit}), positive towards the sensor or the inside")
    axes.set_ylabel("% of points")
    axes.set_title("distances of points from the other cloud's surfaces, at the pose found", fontsize=10)

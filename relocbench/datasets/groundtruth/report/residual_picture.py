"""``residuals.png``: distances of points of one drive from the planes of the other, at the poses of the graph.

For each registration of the graph, the block of either drive is compared with the planes of the other, all points with
the same weight. The picture shows what the registrations were based on, and what changed between the drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.icp.icp import IcpOptions, linearise
from relocbench.datasets.groundtruth.pose_graph.selection import evenly_spaced
from relocbench.datasets.groundtruth.report.figures import QUERY, REFERENCE, shortened, write_figure
from relocbench.datasets.groundtruth.report.inspected import InspectedSet
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions
from relocbench.datasets.groundtruth.submaps.submaps import SubmapWindow
from relocbench.geometry import invert, robust_sigma

_REACH_M = 0.3
_SCALE_M = 0.05
_OPTIONS = PlaneOptions(thinning_m=(0.0,), reach_m=(_REACH_M,), samples=(1500,), near_m=(1e9,))
_AROUND_M = 6.0
"""length of road before and after a block whose planes it is compared with"""
_PLACES = 40
_SHOWN_M = 0.1


@dataclass(frozen=True, eq=False)
class Residuals:
    """Signed distances of points from planes, positive on the side of the lidar."""

    to_reference_m: Array
    """(N,) of the query's points from the reference's planes"""
    to_query_m: Array
    """(M,) of the reference's points from the query's planes"""
    places: int
    """number of registrations that were used"""

    @property
    def sigmas_m(self) -> tuple[float, float]:
        """Robust standard deviations of both; nan if there are no distances."""
        return _sigma(self.to_reference_m), _sigma(self.to_query_m)


def _sigma(residuals: Array) -> float:
    return robust_sigma(residuals, np.ones_like(residuals))


def measure_residuals(inspected: InspectedSet) -> Residuals:
    """Measure the residuals of up to 40 registrations of the graph, evenly along the drive.

    Raises:
        DatasetError: a block is missing or damaged.
    """
    kept = [
        n for n, verdict in sorted(inspected.query.verdicts.items()) if not verdict and inspected.query.connected[n]
    ]
    some = [kept[row] for row in evenly_spaced(len(kept), _PLACES)]
    blocks = [inspected.window(side, 0.1) for side in (0, 1)]
    around = [inspected.window(side, _AROUND_M) for side in (0, 1)]
    centres = inspected.reference.T_world_node[:, :3, 3]
    forward, backward = [np.zeros(0)], [np.zeros(0)]
    for j in some:
        i = int(np.argmin(np.linalg.norm(centres - inspected.query.T_world_node[j][:3, 3], axis=1)))
        T_ref_query = invert(inspected.reference.T_world_node[i]) @ inspected.query.T_world_node[j]
        forward.append(_distances(around[0], i, blocks[1], j, T_ref_query))
        backward.append(_distances(around[1], j, blocks[0], i, invert(T_ref_query)))
    return Residuals(np.concatenate(forward), np.concatenate(backward), len(some))


def _distances(planes: SubmapWindow, to: int, points: SubmapWindow, of: int, T_to_of: Array) -> Array:
    level = PlaneMap(planes.at(to), _OPTIONS).level(0)
    sample = PlaneMap(points.at(of), _OPTIONS).sample(0)
    return linearise(level, sample, T_to_of, _REACH_M, _SCALE_M, IcpOptions(drift_per_m=0.0)).residuals


def write_residuals(path: Path, measured: Sequence[tuple[InspectedSet, Residuals]]) -> None:
    """Draw a row for each pair set: a histogram of the distances, and their cumulative distribution."""
    write_figure(path, (11, 0.8 + 2.6 * len(measured)), lambda figure: _draw(figure, measured))


def _draw(figure: Figure, measured: Sequence[tuple[InspectedSet, Residuals]]) -> None:
    figure.suptitle("distances from points to the other drive's planes, at the poses of the graph", fontsize=11)
    rows = figure.subplots(len(measured), 2, squeeze=False, width_ratios=(1.6, 1))
    for (left, right), (found, residuals) in zip(rows, measured, strict=True):
        directions = (
            (residuals.to_reference_m, QUERY, "query's points to the reference's planes", "-"),
            (residuals.to_query_m, REFERENCE, "reference's points to the query's planes", "--"),
        )
        for values, colour, name, style in directions:
            if not values.size:
                continue
            edges = np.linspace(-_SHOWN_M, _SHOWN_M, 101)
            weights = np.full(values.size, 100 / values.size)
            sigma, middle = 100 * _sigma(values), 100 * float(np.median(values))
            label = f"{name}\nrobust sigma {sigma:.2f} cm, median {middle:+.2f} cm"
            left.hist(100 * values, 100 * edges, weights=weights, histtype="step", color=colour, linestyle=style,
                      linewidth=1.5, label=label)  # fmt: skip
            ordered = 100 * np.sort(np.abs(values))
            right.plot(ordered, 100 * np.arange(1, len(ordered) + 1) / len(ordered), style, color=colour)
        title = f"{found.conditions}: {shortened(found.name, 60)}\n{residuals.places} registrations"
        left.set_title(title, fontsize=9, loc="left")
        left.set_xlim(-100 * _SHOWN_M, 100 * _SHOWN_M)
        left.set_ylabel("% of points")
        if left.get_legend_handles_labels()[0]:
            left.legend(fontsize=7, frameon=False, loc="upper left")
        left.axvline(0, color="#999999", linewidth=0.6)
        right.set_xlim(0, 100 * _REACH_M)
        right.set_ylim(0, 101)
        right.set_ylabel("% within")
        for axes in (left, right):
            axes.grid(True, color="#dddddd", linewidth=0.6)
    rows[-1][0].set_xlabel("distance (cm), positive towards the lidar")
    rows[-1][1].set_xlabel(f"distance without sign (cm); found up to {100 * _REACH_M:.0f}")

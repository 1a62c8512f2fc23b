"""``map.png``: pairs on the road and along the drive, with their sigmas, and where and why pairs were rejected."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.groundtruth.pairs.reasons import by_kind, common, kind_of
from relocbench.datasets.groundtruth.report.figures import (
    ACCEPTED,
    AXES,
    QUERY,
    REFERENCE,
    reason_colours,
    shortened,
    write_figure,
)
from relocbench.datasets.groundtruth.report.inspected import InspectedSet, Spot, reason_of

_BAND_M = 1.5
"""largest length of the bar of a pair, which reaches half-way to its neighbours"""


def write_map(path: Path, inspected: InspectedSet, spots: list[Spot]) -> None:
    """Draw the map, and below it strips along the drive. ``spots`` are in the order of the overlays' numbers."""
    road = inspected.reference.T_world_node[:, :2, 3]
    wide, high = np.ptp(road @ _flat(road), axis=0).tolist()
    tall = float(np.clip(11 * high / max(wide, 1.0) + 1.5, 2.5, 7.0))
    write_figure(path, (12, tall + 7.5), lambda figure: _draw(figure, inspected, spots, tall))


def _draw(figure: Figure, inspected: InspectedSet, spots: list[Spot], tall: float) -> None:
    pairs = inspected.pair_set.all_pairs
    colours = reason_colours(by_kind(reason_of(p) for p in pairs if not p.accepted))
    rows = figure.subplots(5, 1, height_ratios=(tall, 1.9, 1.5, 1.5, 1.1))
    accepted = sum(p.accepted for p in pairs)
    title = f"{inspected.name}\n{inspected.conditions}: {accepted} of {len(pairs)} pairs accepted"
    figure.suptitle(title, fontsize=11)
    _map(figure, rows[0], inspected, spots, colours)
    strips: list[Axes] = list(rows[1:])
    for axes in strips[1:]:
        axes.sharex(strips[0])
    positions = np.array([inspected.query.arc_length_at(p.query_timestamp_ns) for p in pairs])
    _bands(strips[:3], pairs, positions, colours)
    _sigmas(strips[0], inspected, pairs, positions)
    _rotations(strips[1], inspected, pairs, positions)
    _overlaps(strips[2], inspected)
    _verdicts(strips[3], inspected, pairs, positions, colours)
    for axes in strips[:3]:
        axes.tick_params(labelbottom=False)
        axes.grid(True, axis="y", color="#dddddd", linewidth=0.6)
    strips[3].set_xlabel("metres driven by the query")
    length = inspected.query.travelled_m[-1]
    strips[0].set_xlim(-0.01 * length, 1.01 * length)


def _map(figure: Figure, axes: Axes, inspected: InspectedSet, spots: list[Spot], colours: dict[str, str]) -> None:
    road = inspected.reference.T_world_node[:, :2, 3]
    turn = _flat(road)
    axes.plot(*(road @ turn).T, color="#bbbbbb", linewidth=5, solid_capstyle="round", zorder=1)
    connected = inspected.query.connected
    driven = np.where(connected[:, None], inspected.query.T_world_node[:, :2, 3], np.nan) @ turn
    axes.plot(*driven.T, color=QUERY, linewidth=1, zorder=2)
    pairs = inspected.pair_set.all_pairs
    places = np.array([_place(inspected, p) for p in pairs]).reshape(-1, 2) @ turn
    good = np.array([p.accepted for p in pairs], dtype=bool)
    sigma = np.array([np.nan if p.sigma_translation_m is None else 100 * p.sigma_translation_m for p in pairs])
    dots = axes.scatter(
        places[good, 0], places[good, 1], c=sigma[good], cmap="viridis", s=26, zorder=4, vmin=0, plotnonfinite=True
    )
    stated = "" if all(p.has_calibrated_sigmas for p in pairs) else ", not calibrated"
    figure.colorbar(dots, ax=axes, label=f"sigma of the position (cm){stated}", shrink=0.85, pad=0.01)
    for kind, colour in colours.items():
        these = np.array([not p.accepted and kind_of(reason_of(p)) == kind for p in pairs])
        axes.scatter(places[these, 0], places[these, 1], marker="x", color=colour, s=34, linewidths=1.5, zorder=5)
    for number, spot in enumerate(spots, start=1):
        x, y = (_place(inspected, spot.pair) @ turn).tolist()
        axes.annotate(
            str(number),
            (x, y),
            (0, 16 if number % 2 else -20),
            textcoords="offset points",
            fontsize=8,
            zorder=6,
            ha="center",
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "#444444", "lw": 0.6},
            arrowprops={"arrowstyle": "-", "lw": 0.6, "color": "#444444"},
        )
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.04, 0.12)
    axes.set_ylabel("m, turned so that\nthe road lies flat")
    handles: list[Artist] = [
        Line2D([], [], color="#bbbbbb", linewidth=5, label=f"reference {shortened(inspected.reference.name, 30)}"),
        Line2D([], [], color=QUERY, linewidth=1, label=f"query {shortened(inspected.query.name, 30)}"),
        Line2D([], [], color="#21918c", marker="o", linestyle="", label=f"{good.sum()} accepted"),
    ]
    for kind, members in by_kind(reason_of(p) for p in pairs if not p.accepted).items():
        label = f"{len(members)} rejected: {shortened(common(members), 100)}"
        handles.append(Line2D([], [], color=colours[kind], marker="x", linestyle="", label=label))
    _legend_below(axes, handles, 2 if colours else 3, 3)


def _flat(road: Array) -> Array:
    """(2, 2) R such that ``road @ R``, of a road (N, 2), has its longest direction horizontal, driven to the right."""
    centred = road - road.mean(axis=0)
    first = np.linalg.svd(centred, full_matrices=False)[2][0]
    if first @ (road[-1] - road[0]) < 0:
        first = -first
    return np.array([[first[0], -first[1]], [first[1], first[0]]])


def _place(inspected: InspectedSet, pair: Pair) -> Array:
    """(2,) where a pair is drawn: at its query, or at its keyframe if the graph does not connect the query."""
    if inspected.connected(pair):
        return np.asarray(inspected.query.at(pair.query_timestamp_ns)[:2, 3])
    return np.asarray(inspected.reference.at(pair.ref_timestamp_ns)[:2, 3])


def _bands(strips: list[Axes], pairs: list[Pair], positions: Array, colours: dict[str, str]) -> None:
    for axes in strips:
        for pair, (begin, end) in zip(pairs, _bars(positions), strict=True):
            if not pair.accepted:
                axes.axvspan(begin, end, color=colours[kind_of(reason_of(pair))], alpha=0.15, linewidth=0)


def _bars(positions: Array) -> list[tuple[float, float]]:
    """Begin and end of the bar of each pair."""
    order = np.argsort(positions, kind="stable")
    half = np.minimum(np.diff(positions[order]), _BAND_M) / 2
    begins, ends = np.empty(len(positions)), np.empty(len(positions))
    begins[order] = positions[order] - np.concatenate([[_BAND_M / 2], half])[: len(positions)]
    ends[order] = positions[order] + np.concatenate([half, [_BAND_M / 2]])[: len(positions)]
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


def _sigmas(axes: Axes, inspected: InspectedSet, pairs: list[Pair], positions: Array) -> None:
    values = np.array([[np.nan if s is None else 100 * s for s in p.axis_sigmas] for p in pairs]).reshape(-1, 3)
    for k, (name, marker) in enumerate((("along", "o"), ("across", "x"), ("height", "+"))):
        axes.plot(positions, values[:, k], marker, color=AXES[k], markersize=3 + k, label=name)
    _limit(axes, values, None if inspected.limit_m is None else 100 * inspected.limit_m)
    axes.set_ylabel("sigma (cm)")
    axes.legend(fontsize=8, loc="upper left", ncols=4, frameon=False)


def _rotations(axes: Axes, inspected: InspectedSet, pairs: list[Pair], positions: Array) -> None:
    values = np.array([np.nan if p.sigma_rotation_deg is None else p.sigma_rotation_deg for p in pairs])
    axes.plot(positions, values, ".", color="#000000", markersize=5)
    _limit(axes, values, inspected.limit_deg)
    axes.set_ylabel("sigma (deg)\nof rotation")


def _limit(axes: Axes, values: Array, limit: float | None) -> None:
    """Draw a limit as a line, and fit the axis to it; the largest value is stated if it is far above."""
    known = values[np.isfinite(values)]
    highest = float(known.max()) if known.size else 1.0
    if limit is None:
        axes.set_ylim(0, 1.15 * highest)
        return
    axes.axhline(limit, color="#CC3311", linestyle="--", linewidth=1, label="limit")
    top = min(max(highest, limit), 3 * limit)
    axes.set_ylim(0, 1.3 * top)
    if highest > 1.3 * top:
        axes.text(1, 1.02, f"up to {highest:.3g}", transform=axes.transAxes, ha="right", fontsize=8)


def _overlaps(axes: Axes, inspected: InspectedSet) -> None:
    tried = [r for r in inspected.registrations if 0 <= r.query < len(inspected.query)]
    positions = inspected.query.travelled_m[[r.query for r in tried]] if tried else np.zeros(0)
    for side, colour, name in (("ref", REFERENCE, "of the reference"), ("query", QUERY, "of the query")):
        values = [100 * getattr(r.evidence, f"overlap_{side}") for r in tried]
        axes.plot(positions, values, ".", color=colour, markersize=5, label=name)
    axes.set_ylim(0, 108)
    axes.set_ylabel("overlap of\nsubmaps (%)")
    axes.legend(fontsize=8, loc="lower left", ncols=2, frameon=False)


def _verdicts(
    axes: Axes, inspected: InspectedSet, pairs: list[Pair], positions: Array, colours: dict[str, str]
) -> None:
    for pair, (begin, end) in zip(pairs, _bars(positions), strict=True):
        colour = ACCEPTED if pair.accepted else colours[kind_of(reason_of(pair))]
        axes.axvspan(begin, end, 0.55, 0.95, color=colour, linewidth=0)
    travelled = inspected.query.travelled_m
    step = float(np.median(np.diff(travelled))) if len(travelled) > 1 else 1.0
    for node, verdict in inspected.query.verdicts.items():
        axes.axvspan(travelled[node] - step / 2, travelled[node] + step / 2, 0.05, 0.45,
                     color="#CC3311" if verdict else ACCEPTED, alpha=0.75, linewidth=0)  # fmt: skip
    axes.set_ylim(0, 1)
    axes.set_yticks([0.25, 0.75], ["registrations", "pairs"])
    handles = [
        Patch(color=ACCEPTED, label="accepted"),
        Patch(color="#CC3311", alpha=0.75, label="registration refused"),
    ]
    _legend_below(axes, handles, 2, 5)


def _legend_below(axes: Axes, handles: Sequence[Artist], columns: int, away: float) -> None:
    """Draw a legend below the axes, ``away`` font heights from them, so that it clears their ticks and label."""
    axes.legend(
        handles=handles,
        fontsize=8,
        loc="upper center",
        bbox_to_anchor=(0.5, 0),
        borderaxespad=away,
        frameon=False,
        ncols=columns,
    )

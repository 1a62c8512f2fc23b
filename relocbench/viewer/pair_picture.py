"""A picture of one pair: images, the keyframe warped into the query at the truth and at an answer, residuals, poses."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from relocbench.arrays import Array, Floats, Image, Mask
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import as_grey, as_rgb
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.inspect.drawing import match_brightness
from relocbench.datasets.inspect.overlay import warp_image
from relocbench.geometry import invert
from relocbench.pages.figures import png_of
from relocbench.tracking import Query, Reference
from relocbench.viewer.answers import ShownAnswer
from relocbench.viewer.pictures import keyframe_points

_TRUE, _ANSWER, _KEYFRAME = "#009E73", "#D55E00", "#444444"
"""colours of Okabe and Ito, "Color Universal Design" (2008)"""
_LARGEST_RESIDUAL = 3.0
"""standard deviations at which the colours of residuals end"""
_AROUND = 1 / 40
"""standard deviation of the neighbourhood in which brightness and contrast are taken out, as a share of the width"""
_LEAST_CONTRAST = 4.0
"""grey levels that are added to the local contrast, so that noise on a plain wall does not count like an edge"""
_POINTS = 3000
"""points of the keyframe in the plans"""
_TITLE = 46
"""characters of a line of a title"""
_LEGEND = 20
"""characters of a line of the legend"""
_LONGEST = 60
"""characters of a line of text"""


@dataclass(frozen=True, eq=False)
class Warp:
    """The keyframe as the query would see it under a pose."""

    image: Image
    """(H, W, 3) with the query's brightness and contrast"""
    known: Mask
    """(H, W)"""
    residual: Floats
    """(H, W) absolute difference to the query after local brightness and contrast were taken out of both, in standard
    deviations of the neighbourhood; NaN where not known"""

    @property
    def mean_residual(self) -> float | None:
        """Mean over the known pixels; None where there are none."""
        return float(np.nanmean(self.residual)) if self.known.any() else None


def warp_at(reference: Reference, query: Query, T_query_ref: Array) -> Warp:
    """The keyframe warped into the query by its depth and a pose (4, 4)."""
    warped, known = warp_image(reference, query.camera, T_query_ref)
    image = match_brightness(as_rgb(warped), as_rgb(query.image), known)
    residual = np.abs(_without_light(image, known) - _without_light(query.image, known))
    residual[~known] = np.nan
    image = image.copy()
    image[~known] = 0
    return Warp(image, known, residual)


def _without_light(image: Image, known: Mask) -> Floats:
    """(H, W) grey levels less their local mean, over their local standard deviation: about the same in any light."""
    grey, weight = as_grey(image).astype(np.float32), known.astype(np.float32)
    sigma = max(1.0, _AROUND * image.shape[1])

    def mean(values: Floats) -> Floats:
        total = cv2.GaussianBlur(values * weight, (0, 0), sigma)
        return np.asarray(total / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-6), dtype=np.float32)

    less = grey - mean(grey)
    return np.asarray(less / (np.sqrt(mean(less * less)) + _LEAST_CONTRAST), dtype=np.float32)


def numbers(
    dataset: Dataset, pair_set: PairSet, pair: Pair, method: str | None, answer: ShownAnswer | None
) -> dict[str, Any]:
    """The numbers of the picture, for scripts; None where there is no value."""
    reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
    poses = {"truth": pair.T_query_ref, "answer": None if answer is None else answer.T_query_ref}
    poses["keyframe_pose"] = np.eye(4)
    warps = {name: None if T is None else warp_at(reference, query, T).mean_residual for name, T in poses.items()}
    return {
        "pair_set": pair_set.name,
        "ref_timestamp_ns": pair.ref_timestamp_ns,
        "query_timestamp_ns": pair.query_timestamp_ns,
        "distance_m": pair.distance_m,
        "angle_deg": pair.angle_deg,
        "method": method,
        "answered": None if answer is None else answer.T_query_ref is not None,
        "translation_error_m": None if answer is None else answer.translation_error_m,
        "rotation_error_deg": None if answer is None else answer.rotation_error_deg,
        "confidence": None if answer is None else answer.confidence,
        **{f"residual_at_{name}": value for name, value in warps.items()},
    }


def draw_pair(dataset: Dataset, pair_set: PairSet, pair: Pair, method: str | None, answer: ShownAnswer | None) -> bytes:
    """The picture as PNG. Without a method, the keyframe's own pose stands in the place of its answer.

    Args:
        answer: what ``method`` answered to the pair.
    """
    reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
    T_answer = np.eye(4) if answer is None else answer.T_query_ref
    title = "" if method is None else _short(method)
    none = "" if answer is None else answer.words

    def draw(figure: Figure) -> None:
        panels = figure.subplots(3, 3)
        _show(panels[0, 0], reference.image, _titled(f"keyframe, {dataset.traversal(pair_set.reference).condition}"))
        _show(panels[0, 1], query.image, _titled(f"query, {dataset.traversal(pair_set.query).condition}"))
        truth = None if pair.T_query_ref is None else warp_at(reference, query, pair.T_query_ref)
        found = None if T_answer is None else warp_at(reference, query, T_answer)
        _show_warp(panels[1, 0], panels[2, 0], truth, "the true pose", "the truth is withheld")
        _show_warp(panels[1, 1], panels[2, 1], found, "its own pose" if method is None else title, none)
        _draw_plan(panels[0, 2], reference, pair.T_query_ref, T_answer if answer is not None else None, title)
        _draw_from_side(panels[1, 2], reference, pair.T_query_ref, T_answer if answer is not None else None)
        _write_numbers(panels[2, 2], pair_set, pair, method, answer, truth, found)

    size = 15, 3.2 + 9.6 * query.camera.height / query.camera.width
    return png_of(size, draw, dpi=100, font_size=9, title_size=10)


def _show(axes: Axes, image: Image, title: str) -> None:
    axes.imshow(image, cmap="gray" if image.ndim == 2 else None, vmin=0, vmax=255, interpolation="nearest")
    axes.set_title(title)
    axes.set_axis_off()


def _show_warp(above: Axes, below: Axes, warp: Warp | None, title: str, why_not: str) -> None:
    """The warped keyframe and its residual, or why there is none."""
    if warp is None:
        for axes in (above, below):
            axes.set_axis_off()
        above.set_title(_titled(f"keyframe warped by {title}"))
        above.text(0.5, 0.5, _wrapped(why_not), ha="center", va="center", transform=above.transAxes)
        return
    _show(above, warp.image, _titled(f"keyframe warped by {title}"))
    drawn = below.imshow(warp.residual, cmap="magma", vmin=0, vmax=_LARGEST_RESIDUAL, interpolation="nearest")
    below.set_facecolor("#d0d0d0")
    below.set_xticks([])
    below.set_yticks([])
    mean = warp.mean_residual
    below.set_title(f"difference to the query without light, mean {'none' if mean is None else f'{mean:.2f}'}")
    assert below.figure is not None
    below.figure.colorbar(drawn, ax=below, shrink=0.8, extend="max")


def _draw_plan(axes: Axes, reference: Reference, T_true: Array | None, T_answer: Array | None, title: str) -> None:
    """From above: x to the right and z ahead of the keyframe's camera."""
    _draw_poses(axes, reference, T_true, T_answer, (0, 2), title)
    axes.set_title("from above, in the keyframe's frame")
    axes.set_xlabel("right, m")
    axes.set_ylabel("ahead, m")
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), fontsize=8, frameon=False, borderaxespad=0.0)


def _draw_from_side(axes: Axes, reference: Reference, T_true: Array | None, T_answer: Array | None) -> None:
    _draw_poses(axes, reference, T_true, T_answer, (2, 1), "")
    axes.invert_yaxis()
    axes.set_title("from the side")
    axes.set_xlabel("ahead, m")
    axes.set_ylabel("down, m")


def _draw_poses(
    axes: Axes, reference: Reference, T_true: Array | None, T_answer: Array | None, plane: tuple[int, int], title: str
) -> None:
    """Camera centres with viewing directions over the keyframe's points, cut to the surroundings of the cameras."""
    # Later ones are smaller, and the truth is hollow: cameras at one place are all seen.
    poses: list[tuple[str, Array, str, dict[str, Any], float]] = [
        ("keyframe", np.eye(4), _KEYFRAME, {"marker": "o", "markersize": 10}, 4.0)
    ]
    if T_true is not None:
        hollow = {"marker": "s", "markersize": 12, "markerfacecolor": "none", "markeredgewidth": 2}
        poses.append(("query, true", invert(T_true), _TRUE, hollow, 2.5))
    if T_answer is not None:
        small = {"marker": "X", "markersize": 7, "markeredgecolor": "white", "markeredgewidth": 0.7}
        name = textwrap.fill(f"query by {title}", _LEGEND)
        poses.append((name, invert(T_answer), _ANSWER, small, 1.0))
    centres = np.array([T[:3, 3] for _, T, *_ in poses])[:, plane]
    middle = (centres.min(axis=0) + centres.max(axis=0)) / 2
    reach = max(1.0, 0.8 * float(np.max(np.ptp(centres, axis=0))))
    cloud = keyframe_points(reference, _POINTS).positions[:, plane]
    axes.scatter(cloud[:, 0], cloud[:, 1], s=2, color="#bbbbbb", linewidths=0, zorder=1)
    for order, (name, T_ref_cam, colour, marker, width) in enumerate(poses, start=2):
        at, ahead = T_ref_cam[:3, 3][list(plane)], T_ref_cam[:3, 2][list(plane)]
        axes.plot(*at, linestyle="none", color=colour, label=name, zorder=order, **marker)
        tip = at + 0.35 * reach * ahead
        axes.plot([at[0], tip[0]], [at[1], tip[1]], color=colour, linewidth=width, zorder=order)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(middle[0] - reach, middle[0] + reach)
    axes.set_ylim(middle[1] - reach, middle[1] + reach)
    axes.grid(visible=True, linewidth=0.4)


def _write_numbers(
    axes: Axes,
    pair_set: PairSet,
    pair: Pair,
    method: str | None,
    answer: ShownAnswer | None,
    truth: Warp | None,
    found: Warp | None,
) -> None:
    axes.set_axis_off()
    lines = [
        _short(pair_set.name),
        f"keyframe  {pair.ref_timestamp_ns}",
        f"query     {pair.query_timestamp_ns}",
    ]
    if pair.distance_m is not None:
        lines.append(f"keyframe off by    {pair.distance_m:.3f} m, {pair.angle_deg:.3f}°")
    if pair.sigma_translation_m:
        stated = "" if pair.has_calibrated_sigmas else ", not calibrated"
        lines.append(f"sigma of the truth {pair.sigma_translation_m:.3g} m{stated}")
    if pair.is_negative:
        lines.append("a pair of different places")
    lines.append(f"residual, truth    {_levels(truth)}")
    if method is None or answer is None:
        lines.append(f"residual, keyframe {_levels(found)}")
    else:
        lines.append(f"residual, answer   {_levels(found)}")
        lines += ["", _short(method), *_wrapped(answer.words).splitlines()]
        if answer.confidence is not None:
            lines.append(f"confidence {answer.confidence:.2f}")
    axes.text(0.0, 1.0, "\n".join(lines), va="top", family="monospace", transform=axes.transAxes)


def _levels(warp: Warp | None) -> str:
    mean = None if warp is None else warp.mean_residual
    return "none" if mean is None else f"{mean:.3f}"


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"


def _titled(text: str) -> str:
    """A title of at most two lines that stays above its panel."""
    return textwrap.fill(text, _TITLE, max_lines=2, placeholder="…")


def _wrapped(text: str) -> str:
    return "\n".join(textwrap.wrap(text, 46))

"""How far the images of a pair are apart where the true pose says that they show the same, in whatever light.

Grey levels of one surface differ between noon, night and snow; the directions of its edges mostly do not. Every point
of the keyframe that the query sees takes the direction of the edge there along into the query, as the true pose moves
it. In each region of the query, the map of these directions is then shifted over the query's own: with a(p) and b(p)
the weight times ``exp(2 i angle)`` of the edge at pixel p, so that an edge is the same whichever side is brighter,

    S(d) = Re sum_p conj(a(p)) b(p + d)

is highest at the shift d where edges lie on edges (orientation correlation, Fitch et al., BMVC 2002, of doubled
angles). A shift is measured where its peak stands out from what other shifts give, by chance or because structure
repeats, and a wrong pose is only told by shifts that are alike in neighbouring regions. If the truth is right, shifts
are about zero; if too few are measured, nothing is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.core.images import as_grey
from relocbench.datasets.pairs.visibility import DepthView, ReferencePoints, see, warp
from relocbench.geometry import Camera
from relocbench.tracking import Query, Reference

Verdict = Literal["agree", "apart", "cannot tell", "unseen"]

_WIDTH = 640
"""pixels; larger images are reduced to this width"""
_REDUCTIONS = (1, 2)
"""further factors by which images are reduced, the next one where one tells nothing"""
_REACH = 36
"""pixels of the reduced image by which directions are shifted to either side"""
_SMOOTH = 1.5
"""standard deviation in pixels of the blur before gradients"""
_AROUND = 12.0
"""that of the blur which says how strong edges are in the neighbourhood: weak ones count as much where all are"""
_SIDE = 96
"""pixels of the reduced image along a side of a region, about"""
_SPARSE = 0.05
"""share of pixels with depth below which every point stands for the pixels around it"""
_PATCH_RADIUS = 5
"""pixels of the keyframe, of 640 across, that a point of a sparse keyframe stands for to every side at most"""
_LEAST_POINTS = 0.03
"""share of a region's pixels that must have a point of the keyframe"""
_LEAST_EDGES = 0.05
"""share of a region's pixels that must lie on edges of the query"""
_ON_EDGE = 0.1
"""weight from which a pixel does"""
_LEAST_SIDE = 48
"""pixels of the reduced image, of its shorter side"""
_PEAK_RADIUS = 4.0
"""pixels around a peak that belong to it"""
_CLEAR = 6.0
"""standard deviations of S over other shifts by which a peak stands out"""
_UNIQUE = 0.8
"""greatest height of the second peak, as a share of the first"""
_LEAST_REGIONS = 3
"""regions that must be measured"""
_RIGHT_PX = 1.0
"""pixels of the reduced image, median shift up to which the images agree"""
_ALIKE = 0.5
"""greatest difference of the shifts of two neighbouring regions as a share of their length; at least 2 pixels"""

NO_DEPTH = "the keyframe has no depth: nothing can be compared"
UNSEEN = "the query sees no point of the keyframe by the true pose: check the true pose"


@dataclass(frozen=True)
class ImageAgreement:
    """How far two images are apart where the true pose says that they show the same."""

    verdict: Verdict
    regions: int
    """number of regions of the query that show enough of the keyframe"""
    measured: int
    """number of these whose shift was measured"""
    shift_px: float
    """median length of the measured shifts, in pixels of the query; NaN where nothing is told"""
    towards_px: tuple[float, float]
    """median shift right and down, by which the keyframe's points would have to move"""
    words: str
    """what was found, in words"""


def measure_agreement(reference: Reference, query: Query, T_query_ref: Array) -> ImageAgreement:
    """Measure by how much edges of the query lie beside those of the keyframe under ``T_query_ref`` (4, 4)."""
    points = _enlarged(ReferencePoints.of(reference), reference.camera)
    if not len(points):
        return _nothing("cannot tell", NO_DEPTH)
    view = DepthView(reference.camera, reference.depth, reference.depth_sigma)
    seen = see(points, T_query_ref, view, DepthView(query.camera))
    if not np.any(seen.inside):
        return _nothing("unseen", UNSEEN)
    shown, uv_query = points.take(seen.visible), seen.uv_query[seen.visible]
    found = _nothing("cannot tell", "")
    for reduction in _REDUCTIONS:
        scale = min(1.0, _WIDTH / query.camera.width) / reduction
        found = _measured(shown, uv_query, reference, query, T_query_ref, scale)
        if found.verdict != "cannot tell":
            break
    return found


def _nothing(verdict: Verdict, words: str, regions: int = 0, measured: int = 0) -> ImageAgreement:
    return ImageAgreement(verdict, regions, measured, np.nan, (np.nan, np.nan), words)


def _undecided(why: str, regions: int = 0, measured: int = 0) -> ImageAgreement:
    return _nothing("cannot tell", f"whether the images agree cannot be told: {why}", regions, measured)


def _enlarged(points: ReferencePoints, camera: Camera) -> ReferencePoints:
    """The points; those of a sparse keyframe with the pixels around them, as if these were as far away."""
    if not len(points) or len(points) >= _SPARSE * camera.width * camera.height:
        return points
    free = (np.sqrt(camera.width * camera.height / len(points)) - 1) / 2  # patches fill the image at most once
    radius = int(max(1, min(round(_PATCH_RADIUS * camera.width / _WIDTH), free)))
    steps = np.stack(np.meshgrid(*[np.arange(-radius, radius + 1)] * 2), axis=-1).reshape(-1, 2)
    uv = np.rint(points.uv[:, None] + steps).reshape(-1, 2)
    inside = camera.contains(uv)
    depth, sigma = (np.repeat(values, len(steps))[inside] for values in (points.depth, points.sigma))
    return ReferencePoints(uv[inside], depth, sigma)


def _measured(
    points: ReferencePoints, uv_query: Array, reference: Reference, query: Query, T_query_ref: Array, scale: float
) -> ImageAgreement:
    """The agreement at a scale of the query."""
    to_reference = min(1.0, scale * query.camera.fx / reference.camera.fx)
    edges_ref, edges = _edges(reference.image, to_reference), _edges(query.image, scale)
    carried = _carried(points, edges_ref, to_reference, reference.camera, query.camera, T_query_ref)
    height, width = edges.shape
    if min(height, width) < _LEAST_SIDE:
        return _undecided("the query is too small")
    u, v = np.rint(((uv_query + 0.5) * scale - 0.5).T).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    total = np.zeros((height, width), dtype=np.complex64)
    count = np.zeros((height, width), dtype=np.float32)
    np.add.at(total, (v[inside], u[inside]), carried[inside])
    np.add.at(count, (v[inside], u[inside]), 1.0)
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    shifts, centres, regions = [], [], 0
    for rows, columns in _regions(height, width):
        if np.mean(count[rows, columns] > 0) < _LEAST_POINTS:
            continue
        regions += 1
        if np.mean(np.abs(edges[rows, columns]) > _ON_EDGE) < _LEAST_EDGES:
            continue
        shift = _shift(_correlation(mean, edges, rows, columns))
        if shift is not None:
            shifts.append(shift)
            centres.append((columns.start + columns.stop, rows.start + rows.stop))
    return _judged(np.array(shifts), np.array(centres) / 2, regions, scale)


def _judged(shifts: Array, centres: Array, regions: int, scale: float) -> ImageAgreement:
    """What the shifts (N, 2) at places (N, 2) of the reduced image say."""
    among = f"measured in {len(shifts)} of {regions} regions of the image"
    if regions < _LEAST_REGIONS:
        return _undecided("too little of the query shows points of the keyframe", regions, len(shifts))
    if len(shifts) < _LEAST_REGIONS:
        return _undecided(f"edges were {among}, which is too few", regions, len(shifts))
    lengths = np.linalg.norm(shifts, axis=1)
    length = float(np.median(lengths))
    right, down = (np.median(shifts, axis=0) / scale).tolist()
    px = f"{length / scale:.1f} px"
    if length <= _RIGHT_PX:
        words = f"the images agree at the true pose: edges are {px} apart, {among}"
        return ImageAgreement("agree", regions, len(shifts), length / scale, (right, down), words)
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    differences = np.linalg.norm(shifts - shifts[np.argmin(apart, axis=1)], axis=1)
    if np.mean(differences <= np.maximum(2.0, _ALIKE * lengths)) < 0.5:
        return _undecided(f"shifts of edges, {among}, differ from one region to the next", regions, len(shifts))
    across = f"{abs(right):.1f} px to the {'right' if right >= 0 else 'left'}"
    where = f"{across} and {abs(down):.1f} px {'down' if down >= 0 else 'up'}"
    words = f"CHECK THE TRUE POSE: edges are {px} apart, the keyframe's points should lie {where}, {among}"
    return ImageAgreement("apart", regions, len(shifts), length / scale, (right, down), words)


def _edges(image: Image, scale: float) -> NDArray[np.complex64]:
    """(H, W) of the image at a scale: the weight of each pixel's edge, times ``exp(2 i angle)`` of its gradient."""
    grey = as_grey(image).astype(np.float32)
    if scale < 1.0:
        grey = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.float32)
    smooth = cv2.GaussianBlur(grey, (0, 0), _SMOOTH)
    gradient = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) + 1j * cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    strength = np.abs(gradient).astype(np.float32)
    usual = cv2.GaussianBlur(strength, (0, 0), _AROUND) + 1.0
    weight = np.minimum(strength / usual, 2.0)
    return np.asarray(weight * (gradient / np.maximum(strength, 1e-6)) ** 2, dtype=np.complex64)


def _carried(
    points: ReferencePoints,
    edges: NDArray[np.complex64],
    scale: float,
    camera_ref: Camera,
    camera_query: Camera,
    T_query_ref: Array,
) -> NDArray[np.complex64]:
    """(N,) the edges at the keyframe's points as the query's camera sees them: turned as it sees their directions."""
    u, v = np.rint(((points.uv + 0.5) * scale - 0.5).T).astype(int)
    at = edges[np.clip(v, 0, edges.shape[0] - 1), np.clip(u, 0, edges.shape[1] - 1)]
    along = np.exp(0.5j * np.angle(at) + 0.5j * np.pi)  # the edge is across the gradient
    step = np.column_stack([along.real, along.imag])
    ends = [
        warp(np.column_stack([points.uv + half, points.depth]), camera_ref, camera_query, T_query_ref)[0]
        for half in (0.5 * step, -0.5 * step)
    ]
    moved = ends[0] - ends[1]
    seen = moved[:, 0] + 1j * moved[:, 1]
    turned = -(seen**2) / np.maximum(np.abs(seen) ** 2, 1e-12)  # back from the edge to its gradient
    return np.asarray(np.abs(at) * np.nan_to_num(turned), dtype=np.complex64)


def _regions(height: int, width: int) -> list[tuple[slice, slice]]:
    """The regions of an image, about squares."""
    rows, columns = (np.linspace(0, side, max(2, round(side / _SIDE)) + 1).astype(int) for side in (height, width))
    return [
        (slice(top, bottom), slice(left, right)) for top, bottom in pairwise(rows) for left, right in pairwise(columns)
    ]


def _correlation(a: NDArray[Any], b: NDArray[Any], rows: slice, columns: slice) -> Floats:
    """S(d) of a region of ``a``, (2 reach + 1, 2 reach + 1) over shifts down and right."""
    region = a[rows, columns]
    around = np.zeros((region.shape[0] + 2 * _REACH, region.shape[1] + 2 * _REACH), dtype=np.complex64)
    top, left = rows.start - _REACH, columns.start - _REACH
    y0, x0 = max(top, 0), max(left, 0)
    y1, x1 = min(rows.stop + _REACH, b.shape[0]), min(columns.stop + _REACH, b.shape[1])
    around[y0 - top : y1 - top, x0 - left : x1 - left] = b[y0:y1, x0:x1]
    size = [fft.next_fast_len(side) for side in around.shape]
    product = np.conj(fft.fft2(region, size)) * fft.fft2(around, size)
    return np.asarray(fft.ifft2(product)[: 2 * _REACH + 1, : 2 * _REACH + 1].real, dtype=np.float32)


def _shift(correlation: Floats) -> Array | None:
    """The shift (2,) right and down of the peak, to a fraction of a pixel; None if it does not stand out."""
    y, x = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    last = len(correlation) - 1
    if x in (0, last) or y in (0, last):  # the true peak may lie beyond
        return None
    down, right = np.mgrid[: correlation.shape[0], : correlation.shape[1]]
    others = correlation[np.hypot(down - y, right - x) > _PEAK_RADIUS]
    middle = np.median(others)
    # Where few edges meet, most sums are zero, and the median deviation says nothing of the rest.
    spread = max(1.4826 * float(np.median(np.abs(others - middle))), float(np.std(others)), 1e-9)
    height, second = (correlation[y, x] - middle) / spread, (others.max() - middle) / spread
    if height < _CLEAR or second > _UNIQUE * height:
        return None
    return np.array([x + _vertex(correlation[y, :], x), y + _vertex(correlation[:, x], y)]) - _REACH


def _vertex(values: Floats, at: int | np.integer[Any]) -> float:
    """The offset of the vertex of the parabola through a peak and its neighbours; 0 at an end."""
    if not 0 < at < len(values) - 1:
        return 0.0
    before, peak, after = (float(values[at + step]) for step in (-1, 0, 1))
    curvature = before - 2 * peak + after
    return 0.0 if curvature >= 0 else 0.5 * (before - after) / curvature

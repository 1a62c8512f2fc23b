"""Pictures for checking the truth of a pair by eye.

Four panels show the keyframe with its points, coloured by depth; the query with the same points projected by the true
pose; and the keyframe warped into the query by the true pose, once in squares that alternate with the query (for a
sparse keyframe, in patches on the query) and once in red over the query in cyan. If the truth is right, numbered
corners are on the same objects, edges are continuous, and the last panel has no coloured fringes.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Floats, Image, Mask
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import as_grey, as_rgb, write_image
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.inspect.agreement import ImageAgreement, measure_agreement
from relocbench.datasets.inspect.clock import pair_residual
from relocbench.datasets.inspect.drawing import (
    RED,
    WHITE,
    YELLOW,
    Colour,
    compose,
    depth_colours,
    draw_points,
    enlarge,
    match_brightness,
    mixed,
    red_cyan,
)
from relocbench.datasets.pairs.correspondences import spread_sample
from relocbench.datasets.pairs.visibility import DepthView, ReferencePoints, reference_z_buffer, see, warp
from relocbench.geometry import Camera, invert
from relocbench.progress import Reporter
from relocbench.tracking import Query, Reference

_POINTS = 3000
"""points that are drawn at most; more would hide the image"""
_CORNERS = (5, 3)
"""columns and rows of cells with one numbered corner each"""
_SPARSE = 0.3
"""share of pixels with depth below which a keyframe counts as sparse and patches are drawn"""
_PATCH_RADIUS = 5
"""pixels in an image 1000 pixels wide"""
_PANEL_WIDTH = 640


@dataclass(frozen=True)
class Picture:
    """One picture with the facts about its pair."""

    file: str
    pair_set: str
    ref_timestamp_ns: int
    query_timestamp_ns: int
    distance_m: float | None
    angle_deg: float | None
    overlap: float | None
    source: str
    agreement: ImageAgreement
    residual_deg: float | None
    """angle from the true pose to that which images and depth give by themselves; None where they give none"""
    residual_mm: float | None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for scripts: one mapping, the agreement's values among the others."""
        values = asdict(self)
        agreement = values.pop("agreement")
        return {**values, **agreement}


def write_pictures(
    dataset: Dataset, pair_sets: list[PairSet], folder: Path, count: int, seed: int, reporter: Reporter
) -> list[Picture]:
    """Write ``PAIRSET_REF_QUERY.png`` for ``count`` pairs of each set, spread evenly along the drive.

    Args:
        seed: seed of the choice of points.

    Raises:
        DatasetError: a pair set has no images, or one of them is damaged.
    """
    dataset.require_images(pair_sets, "there is nothing to draw points in; the map of `relocbench report` needs none")
    chosen = [(s, pair) for s in pair_sets for pair in spread_pairs(s.pairs, count)]
    pictures = []
    with reporter.stage("drawing pairs", len(chosen)) as advance:
        for pair_set, pair in chosen:
            pictures.append(_write_picture(dataset, pair_set, pair, folder, seed))
            advance(1)
    return pictures


def spread_pairs(pairs: list[Pair], count: int) -> list[Pair]:
    """Up to ``count`` pairs with known truth, evenly spread over the set and including the first and the last."""
    known = [p for p in pairs if p.T_query_ref is not None]
    rows = np.unique(np.rint(np.linspace(0, len(known) - 1, min(count, len(known)))).astype(int))
    return [known[row] for row in rows]


def write_pair(path: Path, dataset: Dataset, pair_set: PairSet, pair: Pair, name: str, seed: int) -> ImageAgreement:
    """Draw the keyframe's points of a pair with known truth in its query image, under a title that begins with name."""
    assert pair.T_query_ref is not None
    reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
    traversal = dataset.traversal(pair_set.query)
    depth = traversal.depth(pair_set.query_camera, pair.query_timestamp_ns)
    view = DepthView(query.camera, depth, traversal.file.cameras[pair_set.query_camera].depth_sigma)
    rng = np.random.default_rng([seed, *(time % 2**64 for time in pair.key)])
    agreement = measure_agreement(reference, query, pair.T_query_ref)
    title = f"{name}   keyframe {pair.ref_timestamp_ns}   query {pair.query_timestamp_ns}"
    write_image(path, draw_pair(reference, query, view, pair, agreement, title, rng))
    return agreement


def _write_picture(dataset: Dataset, pair_set: PairSet, pair: Pair, folder: Path, seed: int) -> Picture:
    path = folder / f"{pair_set.name}_{pair.ref_timestamp_ns}_{pair.query_timestamp_ns}.png"
    agreement = write_pair(path, dataset, pair_set, pair, pair_set.name, seed)
    assert pair.T_query_ref is not None  # spread_pairs has chosen it
    left = pair_residual(
        (dataset.traversal(pair_set.reference), pair_set.reference_camera, pair.ref_timestamp_ns),
        (dataset.traversal(pair_set.query), pair_set.query_camera, pair.query_timestamp_ns),
        pair.T_query_ref,
    )
    return Picture(
        path.name,
        pair_set.name,
        *pair.key,
        pair.distance_m,
        pair.angle_deg,
        pair.overlap,
        pair.source,
        agreement,
        left.deg if left else None,
        left.mm if left and np.isfinite(left.mm) else None,
    )


def warp_image(reference: Reference, query: Camera, T_query_ref: Array) -> tuple[Image, Mask]:
    """The keyframe as the query would see it, (H, W[, 3]), and where it is known, (H, W).

    The keyframe's depth is drawn into the query; each query pixel q with depth z then gets the keyframe's colour at
    ``pi(T_ref_query pi^-1(q, z))``.
    """
    depth = _filled_depth(reference)
    z = reference_z_buffer(T_query_ref, DepthView(reference.camera, depth), DepthView(query))
    v, u = np.nonzero(np.isfinite(z))
    uv, _, valid = warp(np.column_stack([u, v, z[v, u]]), query, reference.camera, invert(T_query_ref))
    valid &= reference.camera.contains(uv)
    where = np.full((*z.shape, 2), -1.0, dtype=np.float32)
    where[v[valid], u[valid]] = uv[valid]
    image = cv2.remap(reference.image, where[..., 0], where[..., 1], cv2.INTER_LINEAR)
    return np.asarray(image), where[..., 0] >= 0


def is_sparse(reference: Reference) -> bool:
    """Whether a keyframe is so sparse that only patches around its points can be warped."""
    inverse = reference.inverse_depth_map
    return bool(np.count_nonzero(inverse) < _SPARSE * inverse.size)


def _filled_depth(reference: Reference) -> Floats:
    """Depth for warping; sparse points are dilated to patches, where the nearest surface wins."""
    inverse = reference.inverse_depth_map
    if is_sparse(reference):
        radius = max(1, round(_PATCH_RADIUS * reference.camera.width / 1000))
        patch = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        inverse = np.asarray(cv2.dilate(inverse, patch), dtype=np.float32)
    depth = np.zeros_like(inverse)
    np.divide(1.0, inverse, out=depth, where=inverse > 0)
    return depth


def draw_pair(
    reference: Reference,
    query: Query,
    view: DepthView,
    pair: Pair,
    agreement: ImageAgreement,
    title: str,
    rng: np.random.Generator,
) -> Image:
    """The four panels with their captions, (H, W, 3)."""
    assert pair.T_query_ref is not None
    points = ReferencePoints.of(reference)
    points = points.take(spread_sample(points.uv, reference.camera, _POINTS, rng))
    seen = see(points, pair.T_query_ref, DepthView(reference.camera, reference.depth, reference.depth_sigma), view)
    colours = depth_colours(points.depth)
    corners = _corner_rows(reference.image, points.uv, seen.visible)
    everywhere = np.ones(len(points), dtype=np.bool_)
    warped, known = warp_image(reference, query.camera, pair.T_query_ref)
    other = as_rgb(query.image)
    warped = match_brightness(as_rgb(warped), other, known)
    near, far = np.percentile(points.depth, [5, 95]) if len(points) else (np.nan, np.nan)
    scale = max(1, round(_PANEL_WIDTH / query.camera.width))
    panels = [
        (
            f"keyframe: points, red {near:.3g} m to blue {far:.3g} m",
            draw_points(as_rgb(reference.image), points.uv, colours, everywhere, corners, scale),
        ),
        (
            f"query: the same points by the true pose; {np.count_nonzero(seen.visible)} visible, "
            f"{np.count_nonzero(seen.inside & ~seen.visible)} hidden (grey)",
            draw_points(other, seen.uv_query, colours, seen.visible, corners, scale, seen.inside),
        ),
        mixed(warped, known, other, scale, patches=is_sparse(reference)),
        ("keyframe warped in red, query in cyan; no fringes", enlarge(red_cyan(warped, known, other), scale)),
    ]
    return compose(panels, _captions(pair, agreement, title))


def _captions(pair: Pair, agreement: ImageAgreement, title: str) -> list[tuple[str, Colour]]:
    facts = [f"{pair.distance_m:.3f} m", f"{pair.angle_deg:.2f} deg"]
    if pair.overlap is not None:
        facts.append(f"overlap {pair.overlap:.2f}")
    if pair.sigma_translation_m is not None:
        facts.append(f"sigma {pair.sigma_translation_m:.3g} m")
    if pair.source:
        facts.append(f"truth: {pair.source}")
    colour = {"agree": WHITE, "cannot tell": YELLOW}.get(agreement.verdict, RED)
    return [(title, WHITE), (", ".join(facts), WHITE), (agreement.words, colour)]


def _corner_rows(image: Image, uv: Array, visible: Mask) -> list[int]:
    """Rows of the most recognisable points: the best corner in each cell of the keyframe."""
    grey = cv2.GaussianBlur(as_grey(image), (0, 0), 1.0).astype(np.float32)
    response = _sample(cv2.cornerMinEigenVal(grey, 5), uv)
    columns, rows = _CORNERS
    height, width = grey.shape
    cell = np.floor(uv[:, 1] * rows / height) * columns + np.floor(uv[:, 0] * columns / width)
    border = 0.03 * width
    central = (uv[:, 0] > border) & (uv[:, 0] < width - border) & (uv[:, 1] > border) & (uv[:, 1] < height - border)
    found = []
    for index in range(columns * rows):
        candidates = np.nonzero((cell == index) & visible & central)[0]
        if candidates.size:
            found.append(int(candidates[np.argmax(response[candidates])]))
    return found


def _sample(image: NDArray[Any], uv: Array) -> Array:
    """Bilinear samples (N,) of an image at pixels (N, 2)."""
    v, u = np.clip(uv[:, 1], 0, image.shape[0] - 1), np.clip(uv[:, 0], 0, image.shape[1] - 1)
    v0, u0 = np.minimum(v.astype(int), image.shape[0] - 2), np.minimum(u.astype(int), image.shape[1] - 2)
    fv, fu = v - v0, u - u0
    top = image[v0, u0] * (1 - fu) + image[v0, u0 + 1] * fu
    bottom = image[v0 + 1, u0] * (1 - fu) + image[v0 + 1, u0 + 1] * fu
    return np.asarray(top * (1 - fv) + bottom * fv, dtype=np.float64)

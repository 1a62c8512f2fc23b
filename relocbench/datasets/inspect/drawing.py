"""Drawing for pictures of pairs: points on an image, two images in one, captions, panels."""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Array, Image, Mask
from relocbench.datasets.core.images import as_grey

Colour = tuple[int, int, int]

WHITE, YELLOW, RED = (255, 255, 255), (255, 225, 60), (255, 90, 70)
_MARGIN = 6


def depth_colours(depth: Array) -> Image:
    """RGB colours (N, 3) from red for near to blue for far, linear in inverse depth."""
    if len(depth) == 0:
        return np.zeros((0, 3), dtype=np.uint8)
    inverse = 1.0 / depth
    low, high = np.percentile(inverse, [5, 95])
    share = np.clip((inverse - low) / max(high - low, 1e-12), 0, 1)
    levels = np.rint(25 + 215 * share).astype(np.uint8)[:, None]
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO))[:, 0, ::-1]


def draw_points(
    image: Image,
    uv: Array,
    colours: Image,
    shown: Mask,
    corners: list[int],
    scale: int,
    also_hidden: Mask | None = None,
) -> Image:
    """Draw points as dots on a dimmed image, hidden points as small grey dots, and number the corners."""
    canvas = enlarge((image * 0.65).astype(np.uint8), scale)
    at = np.where(np.isfinite(uv), (uv + 0.5) * scale - 0.5, -1e4)
    radius = max(1, canvas.shape[1] // 640)
    if also_hidden is not None:
        for place in at[also_hidden & ~shown]:
            cv2.circle(canvas, _pixel(place), 1, (150, 150, 150), -1, cv2.LINE_AA)
    for place, colour in zip(at[shown], colours[shown].tolist(), strict=True):
        cv2.circle(canvas, _pixel(place), radius, colour, -1, cv2.LINE_AA)
    for number, place in enumerate(at[corners], start=1):
        _draw_number(canvas, _pixel(place), str(number))
    return canvas


def _draw_number(canvas: Image, at: tuple[int, int], number: str) -> None:
    size = max(6, canvas.shape[1] // 110)
    for colour, thickness in (((0, 0, 0), 4), (WHITE, 2)):
        cv2.circle(canvas, at, size, colour, thickness, cv2.LINE_AA)
    place = (at[0] + size + 2, at[1] - size + 2)
    for colour, thickness in (((0, 0, 0), 4), (YELLOW, 1)):
        cv2.putText(canvas, number, place, cv2.FONT_HERSHEY_SIMPLEX, size / 14, colour, thickness, cv2.LINE_AA)


def mixed(warped: Image, known: Mask, query: Image, scale: int, *, patches: bool) -> tuple[str, Image]:
    """Caption and image: a chessboard of warped keyframe and query, or ``patches`` of the keyframe on the query."""
    out = query.copy()
    if patches:
        out[known] = warped[known]
        return "patches of the keyframe warped onto the query; edges must be continuous", enlarge(out, scale)
    side = max(8, query.shape[1] // 16)
    v, u = np.indices(known.shape)
    of_keyframe = (u // side + v // side) % 2 == 0
    out[of_keyframe & known] = warped[of_keyframe & known]
    out[of_keyframe & ~known] //= 3
    return "squares: keyframe warped / query; edges must be continuous", enlarge(out, scale)


def red_cyan(warped: Image, known: Mask, query: Image) -> Image:
    red, cyan = (as_grey(image) for image in (warped, query))
    out: Image = np.stack([red, cyan, cyan], axis=-1).astype(np.uint8)
    out[~known] = cyan[~known, None] // 2
    return out


def match_brightness(warped: Image, query: Image, known: Mask) -> Image:
    """The warped keyframe with the query's mean brightness and contrast."""
    if not np.any(known):
        return warped
    a, b = warped[known].astype(np.float64), query[known].astype(np.float64)
    gain = b.std() / a.std() if a.std() > 0 else 1.0
    out: Image = np.clip((warped - a.mean()) * gain + b.mean(), 0, 255).astype(np.uint8)
    return out


def compose(panels: list[tuple[str, Image]], captions: list[tuple[str, Colour]]) -> Image:
    """Two by two panels, each below its caption, all below the head lines."""
    labelled = [np.vstack([_bar([(text, WHITE)], image.shape[1]), image]) for text, image in panels]
    height = max(image.shape[0] for image in labelled)
    width = max(image.shape[1] for image in labelled)
    grid = [_padded(image, height, width) for image in labelled]
    gap = np.full((height, _MARGIN, 3), 255, dtype=np.uint8)
    rows = [np.hstack([grid[i], gap, grid[i + 1]]) for i in (0, 2)]
    line = np.full((_MARGIN, rows[0].shape[1], 3), 255, dtype=np.uint8)
    return np.vstack([_bar(captions, rows[0].shape[1]), line, rows[0], line, rows[1]])


def _bar(lines: list[tuple[str, Colour]], width: int) -> Image:
    """Lines of text, scaled down where necessary to fit the width."""
    out = np.zeros((22 * len(lines) + 4, width, 3), dtype=np.uint8)
    for index, (text, colour) in enumerate(lines):
        plain = text.encode("ascii", "replace").decode()
        size = 0.5
        needed = cv2.getTextSize(plain, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0]
        size *= min(1.0, (width - 12) / max(needed, 1))
        cv2.putText(out, plain, (6, 22 * index + 17), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
    return out


def _padded(image: Image, height: int, width: int) -> Image:
    out = np.zeros((height, width, 3), dtype=np.uint8)
    out[: image.shape[0], : image.shape[1]] = image
    return out


def enlarge(image: Image, scale: int) -> Image:
    if scale == 1:
        return np.ascontiguousarray(image)
    enlarged = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    return np.asarray(enlarged).astype(np.uint8, copy=False)


def _pixel(at: Array) -> tuple[int, int]:
    return round(float(at[0])), round(float(at[1]))

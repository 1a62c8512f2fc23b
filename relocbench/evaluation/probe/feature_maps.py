"""Pictures of feature maps: one place in several conditions, its first three principal components as RGB.

Features that do not change with the weather have the same colours in every row. Components and colour scale are
computed from all images of a place together, separately for each level: rows can be compared, columns cannot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from relocbench.arrays import Floats, Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import as_rgb, write_image
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.errors import MethodError
from relocbench.evaluation.isolation.views import read_only
from relocbench.evaluation.isolation.worker import CONSTRUCTOR
from relocbench.execution import MANY_TIMES, Loss, step
from relocbench.geometry import Camera
from relocbench.methods import MethodSpec
from relocbench.tracking import SupportsFeatures

COMPONENTS = 3
_SPREAD = (1.0, 99.0)
"""percentiles of a component that become its darkest and brightest value"""
_NOISE = 1e-5
"""of the largest value; a component that varies less is float32 rounding"""
_BAR = 22


@dataclass(frozen=True, eq=False)
class Place:
    """Images of about one place, the keyframe first."""

    name: str
    images: tuple[tuple[str, Image, Camera], ...]
    """title, image (H, W[, 3]) and camera of each"""


def principal_components(maps: Sequence[Floats]) -> list[Image]:
    """Render maps (H_i, W_i, D) as pictures (H_i, W_i, 3) by the first principal components of all their pixels.

    The sign of a component is chosen so that its largest entry is positive. Missing components, where D is less than
    three or a component does not vary, are grey.
    Raises:
        ValueError: no maps, or maps of different D.
    """
    if not maps or len({m.shape[2] for m in maps}) > 1:
        raise ValueError(f"expected maps (H, W, D) of one D, got {[m.shape for m in maps]}")
    pixels = np.concatenate([m.reshape(-1, m.shape[2]) for m in maps]).astype(np.float64)
    centre = pixels.mean(axis=0)
    pixels -= centre
    variances, axes = np.linalg.eigh(pixels.T @ pixels / len(pixels))
    order = np.argsort(variances)[::-1][:COMPONENTS]
    axes = axes[:, order]
    axes *= np.sign(axes[np.abs(axes).argmax(axis=0), np.arange(axes.shape[1])])
    parts = pixels @ axes
    low, high = np.percentile(parts, _SPREAD, axis=0)
    scaled = np.full((len(parts), COMPONENTS), 0.5)
    seen = high - low > _NOISE * np.abs(pixels).max()
    scaled[:, : len(order)][:, seen] = np.clip((parts - low)[:, seen] / (high - low)[seen], 0, 1)
    out, start = [], 0
    for m in maps:
        count = m.shape[0] * m.shape[1]
        out.append(np.rint(255 * scaled[start : start + count]).astype(np.uint8).reshape(*m.shape[:2], COMPONENTS))
        start += count
    return out


def feature_sheet(place: Place, method: SupportsFeatures, label: str) -> Image:
    """A picture with a row for each image: the image, then its features on each level, finest first, at equal size.

    Raises:
        MethodError: the method cannot process the images.
    """
    seen = [_levels(method, label, image, camera) for _, image, camera in place.images]
    height, width = place.images[0][1].shape[:2]
    levels = [
        (round(np.log2(width / seen[0][k].shape[1])), principal_components([maps[k] for maps in seen]))
        for k in range(min(map(len, seen)))
    ]
    rows = []
    for index, (title, image, _) in enumerate(place.images):
        panels = [(title, as_rgb(image))]
        panels += [(f"{label}, level {level}: 3 components", pictures[index]) for level, pictures in levels]
        rows.append(np.hstack([_panel(text, picture, width, height) for text, picture in panels]))
    return np.vstack(rows)


def has_features(method: Any) -> bool:
    """Whether a method's ``features`` can be called; a parameter may have the same name."""
    return isinstance(method, SupportsFeatures) and callable(method.features)


def places_of(dataset: Dataset, pair_sets: Sequence[PairSet], count: int) -> list[Place]:
    """Keyframes paired with queries of the most conditions, with the nearest query of each, spread along the drive."""
    looked_at: dict[tuple[str, str, int], dict[str, tuple[float, PairSet, Pair]]] = {}
    for pair_set in pair_sets:
        condition = str(dataset.traversal(pair_set.query).condition)
        for pair in pair_set.pairs:
            nearest = looked_at.setdefault((pair_set.reference, pair_set.reference_camera, pair.ref_timestamp_ns), {})
            distance = float(np.linalg.norm(pair.T_query_ref[:3, 3])) if pair.T_query_ref is not None else np.inf
            if condition not in nearest or distance < nearest[condition][0]:
                nearest[condition] = (distance, pair_set, pair)
    if not looked_at:
        return []
    most = max(map(len, looked_at.values()))
    best = sorted(key for key, nearest in looked_at.items() if len(nearest) == most)
    count = min(count, len(best))
    rows = [(2 * i + 1) * len(best) // (2 * count) for i in range(count)]  # the middle of each part of the drive
    return [_place(dataset, best[row], looked_at[best[row]]) for row in rows]


def write_feature_maps(place: Place, method: Any, label: str, folder: Path) -> Path:
    """Write ``features_LABEL_PLACE.png``.

    Raises:
        MethodError: the method shows no features.
    """
    if not has_features(method):
        raise MethodError(f"method '{label}' offers no feature maps (it has no features())")
    path = folder / f"features_{label}_{place.name}.png"
    write_image(path, feature_sheet(place, method, label))
    return path


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of features that a worker is to draw."""

    spec: MethodSpec
    place: Place
    folder: Path


def draw(picture: Picture) -> tuple[Path | None, str]:
    """Draw a picture in a worker; returns the file, or None and the reason. Raises MethodError."""
    label = picture.spec.label
    tracker = _tracker_of(picture.spec)
    if not has_features(tracker):
        return None, f"{label} offers no feature maps (it has no features())"
    with step("", times=MANY_TIMES):
        return write_feature_maps(picture.place, tracker, label, picture.folder), ""


_made: dict[str, Any] = {}


def _tracker_of(spec: MethodSpec) -> Any:
    """The tracker of a picture, made once for each process. Nothing is scored here, so that it need not be isolated."""
    if repr(spec) not in _made:
        with step(CONSTRUCTOR, times=MANY_TIMES):
            _made[repr(spec)] = spec.create()
    return _made[repr(spec)]


def lost_picture(picture: Picture, loss: Loss) -> tuple[Path | None, str]:
    """The result for a picture whose worker was lost."""
    return None, f"no picture of the features of {picture.spec.label} at {picture.place.name}: {loss.how}"


def _levels(method: SupportsFeatures, label: str, image: Image, camera: Camera) -> list[Floats]:
    """A method's maps (H, W, D), finest first. Raises MethodError for anything else."""
    maps = [level.map for level in method.features(read_only(image), camera).levels]
    wrong = [np.shape(m) for m in maps if not isinstance(m, np.ndarray) or m.ndim != 3 or not np.isfinite(m).all()]
    if wrong or not maps:
        message = f"{wrong[0]} or not finite" if wrong else "none"
        raise MethodError(f"the features of '{label}' are {message}, expected finite maps (H, W, D)")
    return maps


def _place(dataset: Dataset, key: tuple[str, str, int], nearest: dict[str, tuple[float, PairSet, Pair]]) -> Place:
    name, camera, time = key
    traversal = dataset.traversal(name)
    keyframe = traversal.query(camera, time)
    images = [(f"keyframe, {traversal.condition}", keyframe.image, keyframe.camera)]
    for condition, (_, pair_set, pair) in sorted(nearest.items()):
        query = dataset.query(pair_set, pair)
        images.append((f"query, {condition}", query.image, query.camera))
    return Place(f"{name}_{camera}_{time}", tuple(images))


def _panel(text: str, picture: Image, width: int, height: int) -> Image:
    if picture.shape[:2] != (height, width):
        picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
    bar = np.zeros((_BAR, width, 3), dtype=np.uint8)
    plain = text.encode("ascii", "replace").decode()
    needed = cv2.getTextSize(plain, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)[0][0]
    size = 0.45 * min(1.0, (width - 8) / max(needed, 1))
    cv2.putText(bar, plain, (4, 16), cv2.FONT_HERSHEY_SIMPLEX, size, (255, 255, 255), 1, cv2.LINE_AA)
    return np.vstack([bar, picture])

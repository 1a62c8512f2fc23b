"""The scale of a scene, so that methods whose lengths are those of a street also work for rooms and for objects.

Reaches, voxels and tolerances of registration are lengths that suit a street: decimetres to metres. A smaller scene is
enlarged to the size of a street before, and poses, information and evidence are reduced after. Both are exact: with
points enlarged by s, a translation and its sigma are s times as large and rotations stay, so that information of
xi = (rho, phi) becomes ``D I D`` with ``D = diag(s, s, s, 1, 1, 1)``.

How much a scene may be enlarged is limited by the noise of its points, which is enlarged as well, and by their spacing.
``groundtruth/scale.yaml`` states the scale of a build's drives, beside what is in enlarged metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from relocbench.arrays import Array
from relocbench.datasets.core.schema import Strict
from relocbench.datasets.groundtruth.verification.evidence import Evidence
from relocbench.datasets.groundtruth.voxels.thinning import first_in_voxels
from relocbench.errors import DatasetError
from relocbench.files import dump_yaml, load_yaml, write_text

SCALE_FILE = "scale.yaml"
STREET_RADIUS_M = 25.0
"""radius of what a submap of a street shows"""
_NOISE_M, _SPACING_M = 0.02, 0.25
"""largest noise and spacing of an enlarged scene, which the tolerances of registration allow for"""
_AS_IT_IS = (0.45, 1.8)
"""a scene whose factor is in this range is left as it is: it has the size of a street"""
_CELLS = 50
"""the radius is measured on points thinned to this many voxels along the scene"""
_WITHIN = 0.8
"""share of the thinned points within the radius"""
_LOOKED_AT = 4000
"""points whose neighbours are looked at"""
_NEIGHBOURS = 30
_FLAT = 0.3
"""largest ratio of thickness to breadth of neighbours that lie on one surface"""
_FEWEST = 200


@dataclass(frozen=True)
class SceneSize:
    """What decides the scale of a scene, in metres."""

    radius_m: float
    """radius around the median within which most of the scene lies, thinned evenly"""
    spacing_m: float
    """median distance of a point to its nearest neighbour, after thinning to a hundredth of the radius"""
    noise_m: float
    """lower quartile of the standard deviation of points from their surfaces, which edges and leaves do not enlarge"""


@dataclass(frozen=True)
class SceneScale:
    """The factor by which a scene is enlarged."""

    factor: float
    reason: str
    """in words, for people"""
    radius_m: float = STREET_RADIUS_M
    """radius of the scene in metres, before it is enlarged"""

    @property
    def detail(self) -> float:
        """Size of the enlarged scene relative to a street, at most 1: lengths that depend on the size alone, such as
        the voxels of features, are multiplied by it where noise keeps the scene from being enlarged further."""
        return float(np.clip(self.radius_m * self.factor / STREET_RADIUS_M, 0.05, 1.0))

    def enlarged(self, T: Array) -> Array:
        """A pose (..., 4, 4) in enlarged metres."""
        return scaled(T, self.factor)

    def reduced(self, T: Array) -> Array:
        """A pose (..., 4, 4) of enlarged clouds, in metres."""
        return scaled(T, 1 / self.factor)

    def reduced_information(self, information: Array) -> Array:
        """Information (6, 6) of xi = (rho, phi) of an enlarged pose, in metres."""
        D = np.repeat([self.factor, 1.0], 3)
        return np.asarray(D[:, None] * information * D)

    def reduced_evidence(self, evidence: Evidence) -> Evidence:
        """Evidence of enlarged clouds, in metres; shares and angles do not change."""
        return replace(
            evidence,
            residual_ref_m=evidence.residual_ref_m / self.factor,
            residual_query_m=evidence.residual_query_m / self.factor,
            weakest_sigma_m=evidence.weakest_sigma_m / self.factor,
        )


def scaled(T: Array, factor: float) -> Array:
    """Poses (..., 4, 4) whose translations are multiplied by a factor."""
    out = np.array(T, dtype=np.float64)
    out[..., :3, 3] *= factor
    return out


def scene_size(points: Array) -> SceneSize:
    """The size of a scene of points (N, 3). Raises DatasetError if they are too few or all in one place."""
    if len(points) < _FEWEST:
        raise DatasetError(f"has {len(points)} points; registration needs at least {_FEWEST}")
    low, high = np.percentile(points, [1, 99], axis=0)
    extent = float(np.max(high - low))
    if not extent > 0:
        raise DatasetError("has all its points in one place")
    even = points[first_in_voxels(points, extent / _CELLS)]
    away = np.linalg.norm(even - np.median(even, axis=0), axis=1)
    radius = float(np.quantile(away, _WITHIN))
    thinned = points[first_in_voxels(points, radius / 100)]
    if len(thinned) < _FEWEST:
        thinned = points
    some = thinned[np.linspace(0, len(thinned) - 1, min(_LOOKED_AT, len(thinned))).astype(np.int64)]
    count = min(_NEIGHBOURS, len(thinned))
    # Not the very nearest points: those of one ring or one step of a depth image have the same error.
    distances, rows = cKDTree(thinned).query(some, k=count, workers=1)
    spacing = float(np.median(np.asarray(distances)[:, 1]))
    group = thinned[np.asarray(rows)]
    centred = group - group.mean(axis=1, keepdims=True)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.einsum("nki,nkj->nij", centred, centred) / count), 0.0))
    flat = (spread[:, 0] < _FLAT * spread[:, 1]) & (spread[:, 1] > 0.1 * spread[:, 2])
    noise = float(np.percentile(spread[flat, 0], 25)) if np.count_nonzero(flat) > 20 else radius / 1000
    return SceneSize(radius, spacing, noise)


def scale_of(
    sizes: Sequence[SceneSize],
    factor: float | None = None,
    noise_m: float = _NOISE_M,
    spacing_m: float = _SPACING_M,
    wanted_m: float = STREET_RADIUS_M,
) -> SceneScale:
    """The common scale of scenes that are registered to each other.

    Args:
        factor: given by hand; None: chosen by the sizes.
        noise_m, spacing_m: largest noise and spacing of the enlarged scene.
        wanted_m: its radius.
    """
    radius = min(size.radius_m for size in sizes)
    spacing, noise = (max(getattr(size, name) for size in sizes) for name in ("spacing_m", "noise_m"))
    if factor is not None:
        return SceneScale(factor, f"enlarged {factor:g} times, as given", radius)
    by_size, by_noise, by_spacing = wanted_m / radius, noise_m / max(noise, 1e-12), spacing_m / spacing
    wanted = by_size if by_size < 1 else max(min(by_size, by_noise, by_spacing), 1.0)
    if by_size < 1:
        # A large scene is measured as a street is where its points are dense enough, or reduced where they are not.
        wanted = float(np.clip(by_spacing, by_size, 1.0))
    size = f"a scene of {_length(radius)} radius, points {_length(spacing)} apart"
    if _AS_IT_IS[0] <= wanted <= _AS_IT_IS[1]:
        return SceneScale(1.0, f"{size}: as large as a street", radius)
    limited = "" if wanted in (by_size, 1.0) else f", limited by {'noise' if by_noise < by_spacing else 'spacing'}"
    limited += f" of {_length(noise)}" if limited.endswith("noise") else ""
    verb = "enlarged" if wanted > 1 else "reduced"
    times = wanted if wanted > 1 else 1 / wanted
    return SceneScale(wanted, f"{size}: {verb} {times:.3g} times to the size of a street{limited}", radius)


def _length(metres: float) -> str:
    """A length in a unit that suits it."""
    if metres >= 1:
        return f"{metres:.3g} m"
    return f"{100 * metres:.2g} cm" if metres >= 0.01 else f"{1000 * metres:.2g} mm"


class ScaleFile(Strict):
    """The content of ``scale.yaml``: by how much all lengths in the folder of ground truth are enlarged."""

    factor: float = Field(1.0, gt=0)
    reason: str = ""
    max_sigma_m: float | None = None
    """largest sigma of an accepted pair's position, in metres that are not enlarged"""


def write_scale(folder: Path, scale: SceneScale, max_sigma_m: float) -> None:
    """Write ``scale.yaml`` into the folder of ground truth; without it, nothing is enlarged."""
    file = ScaleFile(factor=scale.factor, reason=scale.reason, max_sigma_m=max_sigma_m)
    write_text(folder / SCALE_FILE, dump_yaml(file.model_dump(mode="json")))


def read_scale(folder: Path) -> ScaleFile:
    """The scale of a folder of ground truth; 1 if it has no ``scale.yaml``. Raises DatasetError with the file."""
    path = folder / SCALE_FILE
    return load_yaml(path, ScaleFile, "the scale of the scene", DatasetError) if path.exists() else ScaleFile()

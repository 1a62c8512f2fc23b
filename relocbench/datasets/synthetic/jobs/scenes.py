"""Districts, renderers and scenes that a worker keeps in memory for the next images and pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.core.salt import without_salt
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs.latest import latest, latest_renderer
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.datasets.synthetic.renderer.render import Frame, Renderer
from relocbench.datasets.synthetic.town.moving import Moving, moving_mesh
from relocbench.datasets.synthetic.town.town import District, compose, make_district
from relocbench.geometry import Camera


@dataclass(frozen=True)
class DistrictSpec:
    """The parameters that determine a district."""

    seed: int
    split: str
    extent_m: float

    @property
    def named_seed(self) -> int:
        """The seed as files name it, without what a salt adds."""
        return without_salt(self.seed)


def district(place: DistrictSpec) -> District:
    """The district with these parameters."""
    return latest("district", place, lambda: make_district(place.seed, place.split, place.extent_m))


def renderer(place: DistrictSpec, factors: Factors, moving: Sequence[Moving] = ()) -> Renderer:
    """The renderer of a district in a condition, with what moves at one moment."""

    def make() -> Renderer:
        town = district(place)
        # The surfaces' patterns depend on the district's seed only, so that they are the same in all traversals.
        return Renderer(compose(town, factors), factors, town.lamps, place.seed)

    return latest_renderer((place, factors), moving, make)


@lru_cache(maxsize=2)
def static_scene(place: DistrictSpec, factors: Factors) -> LidarScene:
    """The scene of all static objects in a condition, for casting rays; those of a reference and a query are kept."""
    return LidarScene(compose(district(place), factors))


def moving_scene(moving: Sequence[Moving]) -> LidarScene | None:
    """The scene of what moves alone; None if nothing does."""
    return LidarScene(moving_mesh(moving)) if moving else None


def frame_seed(seed: int, traversal: int, step: int, camera: int) -> int:
    """Seed of the noise, rain and snow of one image, independent of what was rendered before."""
    return int(np.random.SeedSequence([seed, 7, traversal, step, camera]).generate_state(1)[0])


def pixel_rays(camera: Camera, T_world_cam: Array, pixels: Array) -> tuple[Array, Array, Array]:
    """Rays of pixels (N, 2): origins (N, 3) and unit directions (N, 3) in the world, and lengths (N,) at depth 1 m."""
    rays, _ = camera.unproject(pixels)
    lengths = np.linalg.norm(rays, axis=1)
    directions = rays @ T_world_cam[:3, :3].T / lengths[:, None]
    return np.broadcast_to(T_world_cam[:3, 3], directions.shape).copy(), directions, lengths


def changed_since(
    place: DistrictSpec, reference: Factors, factors: Factors, frame: Frame, camera: Camera, T_world_cam: Array
) -> Mask:
    """Mask (H, W) of pixels that show another object than the reference condition does, or one that was repainted.

    Season, months, parked cars and what moves change objects; light, wetness and snow do not.

    Args:
        factors: the condition of the frame.
    """
    v, u = np.mgrid[: camera.height, : camera.width]
    origins, directions, lengths = pixel_rays(
        camera, T_world_cam, np.column_stack([u.ravel(), v.ravel()]).astype(float)
    )
    hits = static_scene(place, reference).hits(origins, directions)
    hit = np.isfinite(hits.range)
    before = np.where(hit, hits.range / lengths, 0.0).reshape(frame.depth.shape)
    objects = np.where(hit, hits.instance, 0).reshape(frame.depth.shape)
    moved = np.abs(before - frame.depth) > 0.01 + 1e-3 * before
    changed = moved | ((objects != frame.instance) & (before > 0))
    if factors.months != reference.months:
        now = static_scene(place, factors).hits(origins, directions)
        other = (hits.material != now.material) | (hits.variant != now.variant)
        changed |= (other & (hits.instance == now.instance)).reshape(changed.shape)
    return np.asarray(changed)

"""Rendering of the missing images. Each town is prepared once per condition and then rendered from many cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from relocbench.datasets.core import images
from relocbench.datasets.cross_view.rendered.details import with_aerial_details
from relocbench.datasets.cross_view.rendered.plan import Photo, Views
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.latest import latest
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.renderer.render import Renderer, Surroundings
from relocbench.datasets.synthetic.renderer.sky import make_sky
from relocbench.datasets.synthetic.town.town import compose
from relocbench.execution import Run, chunks, run_units
from relocbench.progress import Reporter

_IMAGES_PER_UNIT = 96
"""many, because preparing another town or condition takes as long as rendering dozens of images"""
_WORTH_WORKERS = 12
_FOG_OPTICAL_DEPTH = 1.0
"""greatest optical depth of fog at the flight's farthest point; nobody would fly in denser fog"""


@dataclass(frozen=True, eq=False)
class PhotoUnit:
    """Images of one town in one condition, rendered by one worker."""

    root: Path
    views: Views
    condition: Factors
    photos: tuple[Photo, ...]

    def __str__(self) -> str:
        return f"{len(self.photos)} images from {self.photos[0].keys[0]} on"


def seen_by(view: str, factors: Factors, views: Views) -> Factors:
    """The condition adapted to a view.

    No camera here has headlights. Satellite images are taken in clear moments: without falling rain or snow, drops or
    fog, but with the condition's wet or white ground. Drones fly only in fog that they can see through.
    """
    changed: dict[str, object] = {"headlights": False}
    if view == "satellite":
        changed |= {"fog_density": 0.0, "rain_mm_h": 0.0, "snowfall_mm_h": 0.0, "lens_drops": 0.0, "vignetting": 0.0}
    elif view == "drone":
        changed |= {"fog_density": min(factors.fog_density, _FOG_OPTICAL_DEPTH / views.far_m)}
    return factors.model_copy(update=changed)


def render_missing(
    root: Path, photos: Sequence[Photo], conditions: dict[str, Factors], views: Views, reporter: Reporter, run: Run
) -> None:
    """Render the images that are missing or truncated."""
    missing = [photo for photo in photos if not images.is_whole(root / photo.keys[0])]
    units = []
    order = sorted(missing, key=lambda p: (p.town.split, p.town.seed, p.condition, p.view, p.label))
    for (_, condition), group in groupby(order, key=lambda p: (p.town, p.condition)):
        for part in chunks(list(group), _IMAGES_PER_UNIT):
            units.append(PhotoUnit(root, views, conditions[condition], tuple(part)))
    run = run if len(missing) >= _WORTH_WORKERS else run.single_process()
    with reporter.stage("rendering", len(missing)) as advance:
        for _, count in run_units(render_unit, units, run):
            advance(count)


def render_unit(unit: PhotoUnit) -> int:
    """Render and write the images of a unit; returns their number."""
    for photo in unit.photos:
        renderer = renderer_of(photo.town, unit.condition, seen_by(photo.view, unit.condition, unit.views))
        frame = renderer.render(unit.views.optics.camera(photo.view), photo.T_world_cam, photo.seed)
        images.write_image(unit.root / photo.keys[0], frame.rgb)
    return len(unit.photos)


def renderer_of(town: DistrictSpec, condition: Factors, seen: Factors) -> Renderer:
    """The renderer of a town under a view's factors; objects and skylight are those of the condition itself."""

    def make() -> Renderer:
        district = latest("aerial district", town, lambda: with_aerial_details(scenes.district(town)))
        mesh = compose(district, seen)
        skylight = latest(
            "skylight",
            (town, condition),
            lambda: Renderer(mesh, condition, district.lamps, town.seed).surroundings.skylight,
        )
        return Renderer(mesh, seen, district.lamps, town.seed, Surroundings(make_sky(seen, town.seed), skylight))

    return latest("aerial renderer", (town, seen), make)

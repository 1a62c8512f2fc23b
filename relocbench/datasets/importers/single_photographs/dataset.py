"""Kind ``photographs``: single photographs, each seen again by a camera that moved, in other light; the truth is exact.

Each photograph becomes a keyframe with a made-up surface behind its pixels. What a moved camera sees of a surface is
known exactly, so that every pose has its view of a real photograph. Only what the photographs show is real: depth,
motion and the change of light are made up. A camera that only turns sees the same whatever the depth, so that such
queries of a cube map, which shows all sides of a place, have nothing made up but their light.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Self

from pydantic import Field, model_validator

from relocbench.datasets.core.build_options import ImageSize, ImportOptions, width_height
from relocbench.datasets.core.salt import SALT_FILE, salted
from relocbench.datasets.moved_views.kinds import SURFACES, WORDS, Change, SurfaceKind, Viewpoint
from relocbench.execution import Run
from relocbench.files import fitting_name
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.writer import DatasetWriter
    from relocbench.datasets.importers.single_photographs.photographs import Photograph
    from relocbench.datasets.importers.single_photographs.work import Made, Place, Recipe


class Options(ImportOptions):
    """Options of ``relocbench build-dataset photographs``."""

    PATHS = ("salt_file",)

    name: str = Field("", description="name of the dataset; default: made from the folders")
    licence: str = Field("unknown", description="licence of the photographs, kept in dataset.yaml")
    size: ImageSize = Field(
        "512x384", description="pixels of keyframes and queries, WIDTHxHEIGHT, or one number for both"
    )
    keyframes: int = Field(
        1, ge=1, le=100, description="keyframes of each photograph, each a part with a surface and motions of its own"
    )
    surfaces: tuple[SurfaceKind, ...] = Field(
        SURFACES,
        description="made-up surfaces: 'plane', slanted; 'street', a road with houses in front and beside; 'relief', "
        "smooth hills that may hide each other",
    )
    changes: tuple[Change, ...] = Field(
        ("exposure", "shading", "night"),
        description="changes of light, a query of each keyframe for each: exposure, shading, night, lamplight, fog, "
        "snow, low-sun or none",
    )
    viewpoint: Viewpoint = Field(
        "normal",
        description="size of motions; strong: up to 45 degrees around what a photograph shows, up to twice as near or "
        "far; in cube maps up to 60 degrees to the side, up to twice the focal length; both rolled by up to 40 degrees",
    )
    translation: float = Field(
        0.25,
        ge=0,
        le=0.5,
        description="farthest query as a share of the keyframe's median depth; if strong, only of cube maps",
    )
    max_distance: float = Field(5.0, gt=0, description="farthest query in metres; if strong, only of cube maps")
    max_angle: float = Field(
        10.0, ge=0, le=45, description="widest pair in degrees; half for forward motions; not if strong"
    )
    forward: float = Field(
        0.5,
        ge=0,
        le=1,
        description="share of motions along the viewing direction, as a car's; not if strong",
    )
    validation: float = Field(
        0.1, ge=0, lt=1, description="share of each folder's places in the split 'validation', by name before test"
    )
    test: float = Field(0.0, ge=0, lt=1, description="share of each folder's places in the split 'test', the last")
    salt_file: Path | None = Field(None, description=SALT_FILE)

    @model_validator(mode="after")
    def _something_of_each(self) -> Self:
        for name in ("surfaces", "changes"):
            values = getattr(self, name)
            if not values or len(set(values)) != len(values):
                raise ValueError(f"{name} must hold at least one, and each once")
        return self


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Make a dataset of single photographs. Raises as :class:`Importer`.

    Args:
        sources: folders of photographs, whose folders are searched too.
    """
    from relocbench.datasets.core.build import Build
    from relocbench.datasets.core.writer import DatasetWriter
    from relocbench.datasets.importers.assembly import configuration
    from relocbench.datasets.importers.single_photographs.photographs import digest_of, divided, find_photographs
    from relocbench.datasets.importers.single_photographs.work import make_views, query_traversal, write_pairs
    from relocbench.datasets.moved_views.drawing import least_side, least_size

    assert isinstance(options, Options)
    size = width_height(options.size)
    folders = find_photographs(sources, least_size(size), least_side(size), reporter)
    splits = divided(folders, options.validation, options.test)
    options.check_conditions([t for s in splits for t in (s, *(query_traversal(s, c) for c in options.changes))])
    # A folder whose photographs have changed is another dataset, which a resumed build must not mix with the first.
    record = configuration("photographs", sources, options) | {"photographs": digest_of(folders)}
    options = salted(options, "photographs", record, out, reporter)
    recipe = _recipe(options)
    titles = "-".join(source.resolve().name for source in sources)
    writer = DatasetWriter(out, options.name or fitting_name(f"photographs_{titles}"), record, options.licence)
    job = Build(writer, options, reporter, run)
    made = make_views(job, recipe, _places(splits, options.keyframes))
    pair_sets: dict[str, list[str]] = {}
    for split, photographs in splits.items():
        own = [one for one in made if one.place.split == split]
        source = f"{len(photographs)} photographs, made-up depth and motion"
        _write_traversals(writer, recipe, split, own, options, source)
        pair_sets[split] = [write_pairs(job, recipe, own, change) for change in recipe.changes]
    return writer.finish(pair_sets)


def _recipe(options: Options) -> Recipe:
    from relocbench.datasets.importers.single_photographs.work import Recipe
    from relocbench.datasets.moved_views.motions import Motions

    motions = Motions(options.translation, options.max_distance, options.max_angle, options.forward, options.viewpoint)
    return Recipe(width_height(options.size), options.surfaces, options.changes, motions, options.seed)


def _places(splits: dict[str, list[Photograph]], keyframes: int) -> list[Place]:
    """The keyframes of all splits, numbered through."""
    from relocbench.datasets.importers.single_photographs.work import STEP_NS, Place

    numbered = ((split, photograph, k) for split in splits for photograph in splits[split] for k in range(keyframes))
    return [Place(photograph, k, STEP_NS * n, split) for n, (split, photograph, k) in enumerate(numbered, start=1)]


def _write_traversals(
    writer: DatasetWriter, recipe: Recipe, split: str, made: Sequence[Made], options: Options, source: str
) -> None:
    """Describe the keyframes of a split and the queries of each change: cameras, poses and names."""
    import numpy as np

    from relocbench.datasets.core.names import write_names
    from relocbench.datasets.core.schema import CameraEntry, Condition, TraversalFile
    from relocbench.datasets.importers.single_photographs.work import CAMERA, query_traversal
    from relocbench.datasets.moved_views.drawing import View
    from relocbench.geometry import invert

    names = {
        one.place.time: one.place.photograph.name + (f"@{one.place.number + 1}" if options.keyframes > 1 else "")
        for one in made
    }
    views = {split: {one.place.time: View(one.keyframe.camera, np.eye(4)) for one in made}}
    words = {split: WORDS["none"]}
    for change in recipe.changes:
        name = query_traversal(split, change)
        views[name] = {one.place.time: one.views[change] for one in made}
        words[name] = WORDS[change]
    for name, own in views.items():
        condition = options.conditions.get(name, Condition(tags=(words[name],)))
        cameras = {time: view.camera for time, view in own.items()}
        usual = next(iter(cameras.values()))
        T_world_cam = {one.place.time: one.T_world_ref @ invert(own[one.place.time].T_query_ref) for one in made}
        entry = {CAMERA: CameraEntry.of(usual)}
        writer.traversal(TraversalFile(name=name, condition=condition, cameras=entry, source=source), T_world_cam)
        write_names(writer.layout.traversal(name).names, names)
        unusual = {time: camera for time, camera in cameras.items() if camera != usual}
        if unusual:
            writer.intrinsics(name, CAMERA, unusual)

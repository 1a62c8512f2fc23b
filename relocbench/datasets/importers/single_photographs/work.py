"""The keyframes and queries of photographs, each made by one worker, and the pairs of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from relocbench.arrays import Array, Image, Mask
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.core.layout import pair_set_name
from relocbench.datasets.core.pairfile import Pair, PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.importers.single_photographs.photographs import Photograph
from relocbench.datasets.moved_views.drawing import Keyframe, View, drawn_cube_keyframe, drawn_keyframe
from relocbench.datasets.moved_views.exact_correspondences import exact_correspondences
from relocbench.datasets.moved_views.kinds import Change, SurfaceKind
from relocbench.datasets.moved_views.light import changed
from relocbench.datasets.moved_views.motions import Motions, drawn_motion
from relocbench.datasets.moved_views.pictures import Reduced, sight_of, view_of
from relocbench.datasets.moved_views.weather import SCENERY, sky_of
from relocbench.datasets.pairs.correspondences import PairCorrespondences
from relocbench.datasets.pairs.writing import is_finished, write_measured
from relocbench.geometry import make_transform

CAMERA = "photo"
STEP_NS = 1_000_000_000
"""photographs have no times that mean anything: the N-th keyframe is given that of N seconds"""
_APART_M = 1000.0
"""between the places of two keyframes, so that no query shows what another keyframe does"""
_SURFACE, _KEYFRAME, _MOTION, _LIGHT, _CORRESPONDENCES = range(5)
_WORTH_WORKERS = 8
"""keyframes; fewer are made before other processes have started"""


@dataclass(frozen=True)
class Recipe:
    """How keyframes and queries are made."""

    size: tuple[int, int]
    """(width, height) in pixels"""
    surfaces: tuple[SurfaceKind, ...]
    """a keyframe has one of them"""
    changes: tuple[Change, ...]
    """a keyframe has a query of each"""
    motions: Motions
    seed: int

    def rng(self, photograph: Photograph, number: int, *what: int) -> np.random.Generator:
        """A stream of random numbers that depends on the photograph's content, whatever other photographs there are."""
        return np.random.default_rng([self.seed, int(photograph.digest[:16], 16), number, *what])

    def surface(self, place: Place) -> SurfaceKind:
        """The kind of a keyframe's surface; those of one photograph take turns."""
        first = int(self.rng(place.photograph, 0, _SURFACE).integers(len(self.surfaces)))
        return self.surfaces[(first + place.number) % len(self.surfaces)]


@dataclass(frozen=True, eq=False)
class Place:
    """A keyframe that is to be made, with its queries."""

    photograph: Photograph
    number: int
    """of the keyframe among those of the photograph"""
    time: int
    """nanoseconds"""
    split: str


@dataclass(frozen=True, eq=False)
class Made:
    """A keyframe with its queries."""

    place: Place
    keyframe: Keyframe
    views: dict[Change, View]

    @property
    def T_world_ref(self) -> Array:
        """(4, 4) where the keyframe stands: all of them in a row, looking the same way."""
        return make_transform(np.eye(3), [_APART_M * (self.place.time // STEP_NS), 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class _Unit:
    """One keyframe to make."""

    writer: DatasetWriter
    recipe: Recipe
    place: Place

    def __str__(self) -> str:
        return f"the views of {self.place.photograph.images[0].path}"


def query_traversal(split: str, change: Change) -> str:
    """The name of the traversal of a split's queries."""
    return f"{split}-{'unchanged' if change == 'none' else change}"


def make_views(job: Build[ImportOptions], recipe: Recipe, places: Sequence[Place]) -> list[Made]:
    """Draw everything that is made up, and write the images and depths that are missing.

    Raises:
        DatasetError: a photograph is damaged.
    """
    if len(places) < _WORTH_WORKERS:
        job = replace(job, run=job.run.single_process())
    return job.work("keyframes and their queries", _make, [_Unit(job.writer, recipe, place) for place in places])


def _make(unit: _Unit) -> Made:
    place, recipe, writer = unit.place, unit.recipe, unit.writer
    photograph = place.photograph
    keyframe = _keyframe(recipe, place)
    views: dict[Change, View] = {
        change: drawn_motion(keyframe, recipe.motions, recipe.rng(photograph, place.number, _MOTION, *change.encode()))
        for change in recipe.changes
    }
    split, time = place.split, place.time
    missing = [c for c in recipe.changes if writer.needs_image(query_traversal(split, c), CAMERA, time)]
    alone = writer.needs_image(split, CAMERA, time)
    if missing or alone:
        images = [image.read() for image in photograph.images]

        @cache
        def reduced(focal_px: float) -> Reduced:
            return Reduced.of(keyframe.faces, images, focal_px)

        if alone:
            writer.image(split, CAMERA, time, view_of(reduced(keyframe.camera.fx), keyframe))
        for change in missing:
            seen = view_of(reduced(views[change].camera.fx), keyframe, views[change])
            rng = recipe.rng(photograph, place.number, _LIGHT, *change.encode())
            image = changed(seen, change, rng, partial(sight_of, keyframe, views[change]))
            writer.image(query_traversal(split, change), CAMERA, time, image)
    if writer.needs_depth(split, CAMERA, time):
        writer.depth(split, CAMERA, time, keyframe.depth())
    return Made(place, keyframe, views)


def _keyframe(recipe: Recipe, place: Place) -> Keyframe:
    photograph = place.photograph
    rng = recipe.rng(photograph, place.number, _KEYFRAME)
    first = photograph.images[0]
    if photograph.faces:
        return drawn_cube_keyframe(photograph.faces, first.size[0], recipe.size, rng)
    return drawn_keyframe(first.size, first.exif.focal_px(first.size), recipe.size, recipe.surface(place), rng)


def write_pairs(job: Build[ImportOptions], recipe: Recipe, made: Sequence[Made], change: Change) -> str:
    """Write the pairs of one split and one change, with their correspondences; returns their set's name.

    A set that an earlier run of the same build has finished is kept.
    """
    layout, count = job.writer.layout, job.options.correspondences
    split = made[0].place.split
    pairs = [
        Pair(
            one.place.time,
            one.place.time,
            one.views[change].T_query_ref,
            sigma_translation_m=0.0,
            sigma_rotation_deg=0.0,
            source="made-up depth and motion",
        )
        for one in made
    ]
    name = pair_set_name(split, query_traversal(split, change), CAMERA)
    if is_finished(layout, name, pairs, with_correspondences=count > 0):
        return name
    reference, query = (Traversal(layout.traversal(t)) for t in (split, query_traversal(split, change)))
    with job.reporter.stage(f"correspondences of {name}", len(pairs)) as advance:

        def measured() -> Iterator[tuple[PairKey, PairCorrespondences]]:
            for pair, one in zip(pairs, made, strict=True):
                place = one.place
                rng = recipe.rng(place.photograph, place.number, _CORRESPONDENCES, *change.encode())
                keyframe = reference.reference(CAMERA, place.time), query.image(CAMERA, place.time)
                sky = _sky(one.keyframe, keyframe[0].image) if change in SCENERY else None
                yield pair.key, exact_correspondences(one.keyframe, *keyframe, one.views[change], count, rng, sky)
                advance(1)

        write_measured(layout, name, pairs, measured(), with_correspondences=count > 0)
    return name


def _sky(keyframe: Keyframe, image: Image) -> Mask:
    """(H, W) what is taken for sky, which made-up weather paints over."""
    sight = sight_of(keyframe, View(keyframe.camera, np.eye(4)))
    return np.asarray(sky_of(image.astype(np.float32) / np.float32(255), sight) > 0.5)

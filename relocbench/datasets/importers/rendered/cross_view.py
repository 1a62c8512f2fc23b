"""Kind ``cross-view``: buildings of procedural towns from a drone, a satellite and the street. Nothing is downloaded.

The layout is University-1652's, so that programs which read that can read this. The towns of the train and test places
share no street.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, field_validator

from relocbench.datasets.core.salt import SALT_FILE, salted
from relocbench.datasets.core.schema import Strict
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.conditions.presets import conditions_of, refuse_imaging
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.cross_view import CrossViewSet


class Options(Strict):
    """Options of ``relocbench build-dataset cross-view``."""

    name: str = Field("", description="name of the set; default: cross-view-SPLIT")
    licence: str = Field("CC0-1.0", description="licence, kept in dataset.yaml")
    split: Literal["train", "test", "all"] = Field("all", description="folders to make; train and test share no town")
    places: int = Field(60, ge=2, description="places (classes) in each split")
    distractors: int = Field(0, ge=0, description="test places that are in the galleries but have no query")
    towns: int | None = Field(None, ge=1, le=1000, description="towns per split; default: one per 50 places")
    conditions: tuple[str, ...] = Field(
        ("Sunny", "Overcast", "Rain", "Snow"),
        description="condition of the satellite images, then those that drone and street images take in turn; the "
        "first may be repeated there; a single condition is used for all",
    )
    factors: dict[str, Factors] = Field({}, description="conditions of your own, name -> factors; YAML only")
    drone_views: int = Field(54, ge=1, le=1000, description="drone images per place, along three descending circles")
    street_views: int = Field(0, ge=0, le=20, description="street images per place")
    size: int = Field(256, ge=32, le=2048, description="pixels, WIDTHxHEIGHT with both equal, or one number for both")
    far: float = Field(
        110.0,
        ge=60,
        le=300,
        description="distance in metres at which the drone's flight begins; it ends at 0.475 times that",
    )
    satellite_side: float = Field(80.0, ge=30, le=200, description="metres of ground that a satellite image covers")
    satellite_heading: Literal["north", "random"] = Field("north", description="up direction of satellite images")
    spacing: float = Field(25.0, ge=10, le=200, description="least distance between places in metres")
    extent: float = Field(350.0, ge=190, le=1000, description="side of a town in metres")
    seed: int = Field(0, ge=0, description="seed of every random choice")
    salt_file: Path | None = Field(None, description=SALT_FILE)

    @field_validator("size", mode="before")
    @classmethod
    def _square(cls, size: object) -> object:
        width, x, height = str(size).partition("x")
        if x and height != width:
            raise ValueError("images are square; expected a number or two equal ones, as in 256x256")
        return width if x else size

    @field_validator("conditions")
    @classmethod
    def _some(cls, conditions: tuple[str, ...]) -> tuple[str, ...]:
        if not conditions or len(set(conditions[1:])) != len(conditions[1:]):
            raise ValueError("conditions are the satellite's, then those of the other views, each of these once")
        return conditions


def build_places(sources: list[Path], options: Strict, out: Path, reporter: Reporter, run: Run) -> CrossViewSet:
    """Render a cross-view set.

    Args:
        sources: must be empty.

    Raises:
        ConfigError: sources are given, a condition is unknown or has a camera of its own, the towns have too little
            room for the places, or the salt cannot be used.
        DatasetError: ``out`` holds something else.
    """
    from relocbench.datasets.core.writer import DatasetWriter
    from relocbench.datasets.cross_view.opening import open_cross_view
    from relocbench.datasets.cross_view.rendered import writing
    from relocbench.datasets.cross_view.rendered.flight import Optics
    from relocbench.datasets.cross_view.rendered.plan import Views, choose_places, photos_of
    from relocbench.datasets.cross_view.rendered.work import render_missing
    from relocbench.datasets.synthetic.renderer.revision import RENDERER_REVISION

    assert isinstance(options, Options)
    if sources:
        raise ConfigError(f"cross-view is rendered and takes no recordings, got {sources[0]}")
    if options.distractors and options.split == "train":
        raise ConfigError("--distractors applies to the test split only")
    satellite_condition, other_conditions = options.conditions[0], options.conditions[1:] or options.conditions
    named = conditions_of(tuple(dict.fromkeys(options.conditions)), options.factors, None, 0)
    refuse_imaging(named, "cross-view sets")
    factors = {name: condition.factors for name, condition in named.items()}
    asked = options.model_dump(mode="json", exclude={"salt_file"})
    record: dict[str, Any] = {"kind": "cross-view", "sources": [], "options": asked}
    record["renderer"] = RENDERER_REVISION
    record["factors"] = {name: f.model_dump(mode="json") for name, f in factors.items()}
    options = salted(options, options.split, record, out, reporter)
    name = options.name or f"cross-view-{options.split}"
    writer = DatasetWriter(out, name, record, options.licence)
    if writer.complete:
        try:
            return open_cross_view(out, reporter)
        except DatasetError as bad:
            reporter.note(f"{bad}; missing images are rendered again")
    views = Views(
        Optics(options.size, options.satellite_side),
        options.drone_views,
        options.street_views,
        options.far,
        options.satellite_heading == "random",
        satellite_condition,
        other_conditions,
    )
    places, photos = [], []
    for split in ("train", "test") if options.split == "all" else (options.split,):
        distractors = options.distractors if split == "test" else 0
        chosen = choose_places(
            split,
            options.places,
            distractors,
            options.towns,
            options.spacing,
            options.extent,
            options.seed,
            reporter,
        )
        for place, network in chosen:
            places.append(place)
            photos += photos_of(place, network, views, split, options.seed)
    writing.refuse_other_files(out, photos)
    render_missing(out, photos, factors, views, reporter, run)
    writing.link_other_names(out, photos)
    writing.write_poses(out, photos)
    writing.write_places(out, places)
    made = {
        "towns": sorted({f"{p.town.split}-{p.town.named_seed}" for p in places}),
        "places": {split: sum(p.town.split == split for p in places) for split in ("train", "test")},
        "images": len(photos),
        "satellite_up": "north" if options.satellite_heading == "north" else "random",
        "cameras": {v: views.optics.camera(v).to_dict() for v in ("drone", "satellite", "street")},
    }
    writing.finish(out, name, options.licence, writer.configuration, made, photos)
    return open_cross_view(out, reporter)

"""Kind ``synthetic``: a procedural town, driven through in any weather. Nothing is downloaded; the truth is exact.

Every split has a district of its own. In each, the same route is driven in every condition, ``traversals`` times; the
first traversal of the first condition is the map whose keyframes the others ask about. With ``recording``, drives are
written as a car would record them, in the layout of a real data set; from those no dataset is made here.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.conditions.presets import PRESETS, SPLITS, ExtraKind, conditions_of
from relocbench.errors import ConfigError
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.recording_folder import RecordingFolder
    from relocbench.datasets.synthetic.jobs.plan import TraversalPlan


_RECORDING_FRAMES = 160
"""unless a preset other than ``demo`` has its own number"""
_OF_RECORDINGS = ("route", "recording_cameras", "image_scale", "rings", "azimuths", "motion_distorted")
_OF_KITTI = ("rings", "azimuths", "motion_distorted")
_OF_DATASETS = (
    "name", "licence", "pair_rule", "pair_step", "max_distance", "max_angle", "correspondences", "copy_images",
    "cameras", "size", "distance", "reference", "extras",
)  # fmt: skip


class Options(ImportOptions):
    """Options of ``relocbench build-dataset synthetic``; what is not given is the preset's."""

    preset: Literal["smoke", "demo", "carla", "oxford"] = Field("demo", description="what the other options start from")
    conditions: tuple[str, ...] = Field(  # type: ignore[assignment]  # here they are chosen, not told
        ("Sunny", "Overcast", "WetNoon", "Night"), description="conditions to drive in, the reference's first"
    )
    factors: dict[str, Factors] = Field({}, description="conditions of your own, name -> factors; YAML only")
    sweep: str | None = Field(
        None, description="a sweep instead of conditions: one factor alone changes, such as light"
    )
    sweep_steps: int = Field(5, ge=2, le=100, description="conditions that a sweep is made of")
    traffic: float | None = Field(
        None, ge=0, le=10, description="moving cars per 100 m of lane, in all conditions; default: each condition's own"
    )
    cameras: Literal["front", "stereo", "wide-stereo", "six"] = Field("front", description="the rig")
    size: str = Field("320x240", description="pixels, WIDTHxHEIGHT, or one number for both")
    steps: int = Field(
        16,
        ge=2,
        le=100_000,
        description="steps of a traversal, ten a second; of a recording: frames, by default 160, 16 (robotcar) or 10 "
        "(kitti) a second",
    )
    traversals: int = Field(1, ge=1, le=100, description="traversals in each condition and split")
    split: Literal["train", "validation", "test", "all"] = Field("test", description="whose district is driven in")
    extent: float = Field(250.0, ge=190, le=1000, description="side of a district in metres")
    speed: float = Field(8.0, gt=0, le=40, description="mean speed in m/s")
    lateral: float = Field(0.6, ge=0, le=4, description="how far drives keep from the lane's middle at most, in metres")
    heading: float = Field(
        2.0, ge=0, le=45, description="how far rigs are turned from the direction of travel, degrees"
    )
    distance: float = Field(1.6, gt=0, le=100, description="mean distance of pairs in metres (default pair rule)")
    max_distance: float = Field(10.0, gt=0, description="farthest pair in metres")
    max_angle: float = Field(30.0, gt=0, le=180, description="widest pair in degrees")
    pair_rule: Literal["step", "nearest"] | None = Field(
        None,
        description="'step': frame i with frame i + k of the same traversal; 'nearest': each query with the nearest "
        "keyframe; default: a keyframe whose distance is drawn about --distance",
    )
    reference: Literal["first", "all"] = Field(
        "first", description="'first': all traversals ask the first one of their split; 'all': all ask all"
    )
    correspondences: int = Field(
        500, ge=0, description="ground-truth correspondences to keep a pair, drawn over the image; 0 for none"
    )
    extras: tuple[ExtraKind, ...] = Field(
        (), description="pictures to write to OUT/extras: normals, instance, semantic, changed"
    )

    recording: Literal["robotcar", "kitti"] | None = Field(
        None,
        description="record drives (camera, lidar, odometry, GNSS) in this layout instead of making a dataset; one for "
        "each split, condition, route and traversal",
    )
    route: tuple[Literal["common", "detour", "crossing", "periodic"], ...] = Field(
        ("common",),
        description="recording: what is driven: the common route; a detour from it over other streets and back; "
        "through one of its crossings another way; along the street with repeating facades",
    )
    recording_cameras: tuple[str, ...] = Field(
        (),
        description="recording: cameras, such as stereo/left,mono_rear or image_0, or none; default: all six of "
        "robotcar, the two grey ones of kitti",
    )
    image_scale: float = Field(
        0.5, ge=0.05, le=1, description="recording: size of the images over that of the real cameras"
    )
    rings: int = Field(64, ge=16, le=64, description="kitti recording: rings of the lidar")
    azimuths: int = Field(2000, ge=100, le=10_000, description="kitti recording: directions of each ring in a turn")
    motion_distorted: bool = Field(
        False, description="kitti recording: leave the car's own motion in the lidar's scans, which KITTI takes out"
    )

    @model_validator(mode="before")
    @classmethod
    def _start_from_preset(cls, values: Any) -> Any:
        if not isinstance(values, dict):
            return values
        _refuse_what_has_no_effect(values)
        frames = {"steps": _RECORDING_FRAMES} if values.get("recording") else {}
        return {**frames, **PRESETS.get(str(values.get("preset", "demo")), {}), **values}

    @field_validator("size")
    @classmethod
    def _plain_size(cls, size: str) -> str:
        found = re.fullmatch(r"(\d+)(?:x(\d+))?", size)
        sides = [int(side) for side in found.groups() if side] if found else []
        if not sides or not all(32 <= side <= 4096 for side in sides):
            raise ValueError("size is WIDTHxHEIGHT or one number, 32 to 4096 pixels")
        return f"{sides[0]}x{sides[-1]}"

    @property
    def width_height(self) -> tuple[int, int]:
        """Pixels."""
        width, height = self.size.split("x")
        return int(width), int(height)


def _refuse_what_has_no_effect(values: dict[str, Any]) -> None:
    """Raises PydanticCustomError on an option that was given and would change nothing."""
    layout = values.get("recording")
    refused: tuple[str, ...] = _OF_RECORDINGS
    why = "is of recordings (--recording)"
    if layout is not None:
        refused, why = _OF_DATASETS, "is of datasets; a recording (--recording) has none"
    found = [name for name in refused if name in values]
    if not found and layout == "robotcar":
        found, why = [name for name in _OF_KITTI if name in values], "is of --recording kitti"
    if found:
        raise PydanticCustomError("no_effect", f"--{found[0].replace('_', '-')} {why}")


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """A rendered dataset; it takes no sources.

    Raises:
        ConfigError: sources were named, or a condition or sweep that there is not.
    """
    from relocbench.datasets.core.writer import DatasetWriter
    from relocbench.datasets.importers.assembly import configuration
    from relocbench.datasets.synthetic.drives.drive import DriveStyle
    from relocbench.datasets.synthetic.drives.rig import rig_named
    from relocbench.datasets.synthetic.jobs.pair_sets import write_pair_sets
    from relocbench.datasets.synthetic.jobs.pairs import DistanceSpread
    from relocbench.datasets.synthetic.jobs.plan import make_plans
    from relocbench.datasets.synthetic.jobs.rendering import render_all
    from relocbench.datasets.synthetic.renderer.revision import RENDERER_REVISION

    assert isinstance(options, Options)
    _no_sources(sources)
    if options.recording is not None:
        raise ConfigError(f"--recording {options.recording} makes recordings, not a dataset")
    conditions = conditions_of(options.conditions, options.factors, options.sweep, options.sweep_steps, options.traffic)
    record = configuration("synthetic", [], options)
    # Pictures that no score depends on can be asked for later.
    for name in ("extras", "recording", *_OF_RECORDINGS):
        del record["options"][name]
    record["renderer"] = RENDERER_REVISION
    record["factors"] = {name: c.factors.model_dump(mode="json") for name, c in conditions.items()}
    licence = "CC0-1.0" if options.licence == "unknown" else options.licence
    writer = DatasetWriter(out, options.name or f"synthetic-{options.preset}", record, licence)
    cameras = rig_named(options.cameras).cameras(*options.width_height)
    plans = make_plans(
        SPLITS if options.split == "all" else (options.split,),
        conditions,
        options.traversals,
        options.steps,
        DriveStyle(options.speed, options.lateral, options.heading),
        seed=options.seed,
        extent_m=options.extent,
        reporter=reporter,
    )
    for plan in plans:
        writer.traversal(plan.file(cameras), dict(zip(plan.times, plan.drive.T_world_rig, strict=True)))
    render_all(plans, cameras, writer.layout, options.seed, options.extras, reporter, run)
    spread = DistanceSpread(options.distance, options.max_distance, options.max_angle)
    splits = write_pair_sets(asked(plans, options), cameras, writer.layout, options, spread, reporter, run)
    return writer.finish(splits)


def record(
    sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run
) -> RecordingFolder | None:
    """Recordings of drives; None where a dataset is asked for.

    Raises:
        ConfigError: sources were named, a condition, sweep or camera that there is not, a route too short for it.
        DatasetError: ``out`` holds something else.
    """
    assert isinstance(options, Options)
    if options.recording is None:
        return None
    from relocbench.datasets.synthetic.drives.drive import DriveStyle
    from relocbench.datasets.synthetic.jobs.field import check_folder, plan_drives, record_all
    from relocbench.datasets.synthetic.jobs.recording import DriveOptions

    _no_sources(sources)
    conditions = conditions_of(options.conditions, options.factors, options.sweep, options.sweep_steps, options.traffic)
    if len(set(options.route)) != len(options.route) or not options.route:
        raise ConfigError(f"--route: each at most once, and at least one, got {','.join(options.route) or 'none'}")
    cameras = None if not options.recording_cameras else tuple(c for c in options.recording_cameras if c != "none")
    if cameras is not None and len(set(cameras)) != len(cameras):
        raise ConfigError(f"--recording-cameras names one twice: {','.join(cameras)}")
    each = DriveOptions(
        layout=options.recording,
        seed=options.seed,
        frames=options.steps,
        scale=options.image_scale,
        cameras=cameras,
        style=DriveStyle(options.speed, options.lateral, options.heading),
        rings=options.rings,
        azimuths=options.azimuths,
        motion_distorted=options.motion_distorted,
    )
    each.target(out)
    unused = {*_OF_DATASETS, "preset", "conditions", "factors", "sweep", "sweep_steps", "traffic"}
    unused |= set() if options.recording == "kitti" else set(_OF_KITTI)
    settings = {"kind": "synthetic", "licence": "CC0-1.0", **options.model_dump(mode="json", exclude=unused)}
    settings["conditions"] = {name: c.factors.model_dump(mode="json") for name, c in conditions.items()}
    check_folder(out, settings)
    drives = plan_drives(
        SPLITS if options.split == "all" else (options.split,),
        tuple(conditions),
        options.route,
        options.traversals,
        each.path_length_m,
        seed=options.seed,
        extent_m=options.extent,
        reporter=reporter,
    )
    return record_all(drives, conditions, each, out, settings, reporter, run)


def _no_sources(sources: list[Path]) -> None:
    if sources:
        raise ConfigError(f"synthetic is rendered and takes no recordings, got {sources[0]}")


def asked(plans: list[TraversalPlan], options: Options) -> list[tuple[TraversalPlan, TraversalPlan]]:
    """(reference, query) traversals of every pair set.

    A condition is also asked about itself: by its second traversal, or else by the reference's own other frames.
    """
    found = []
    for split in dict.fromkeys(plan.split for plan in plans):
        members = [plan for plan in plans if plan.split == split]
        references = members if options.reference == "all" else members[:1]
        for reference in references:
            for query in members:
                itself = reference is query
                alone = options.traversals == 1
                if options.pair_rule == "step":
                    wanted = itself
                elif options.pair_rule == "nearest":
                    wanted = not itself
                else:
                    wanted = not itself or alone
                if wanted:
                    found.append((reference, query))
    if not found:
        raise ConfigError("--pair-rule nearest needs a second traversal; name more conditions or raise --traversals")
    return found

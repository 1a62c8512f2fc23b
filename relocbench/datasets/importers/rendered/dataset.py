"""Kind ``synthetic``: drives through procedural towns in any weather. Nothing is downloaded; the truth is exact.

Every split has its own district, a piece of town. In each district the same routes are driven ``traversals`` times in
every condition. The first traversal of the first condition and route is the map, whose keyframes are paired with the
frames of the others. With ``recording``, drives are written as a car records them, in the layout of a real data set.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import Field, model_validator

from relocbench.datasets.core.build_options import ImageSize, ImportOptions, RuleOptions, width_height
from relocbench.datasets.core.salt import SALT_FILE, salted
from relocbench.datasets.importers.rendered.scopes import (
    refuse_what_has_no_effect,
    without_effect_on_datasets,
    without_effect_on_recordings,
)
from relocbench.datasets.synthetic.conditions.condition import Factors, NamedCondition
from relocbench.datasets.synthetic.conditions.presets import (
    PRESETS,
    SPLITS,
    ExtraKind,
    References,
    RepeatingStreet,
    conditions_of,
    refuse_imaging,
)
from relocbench.datasets.synthetic.conditions.views import Views
from relocbench.datasets.synthetic.map_depth.kinds import DepthKind, MapDepth
from relocbench.errors import ConfigError
from relocbench.execution import Run
from relocbench.metrics.pose.tiers import Tier
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.recording_folder import RecordingFolder
    from relocbench.datasets.synthetic.jobs.plan import AskedDrives


_RECORDING_FRAMES = 160
"""default of ``steps`` for recordings, unless a preset sets it"""


class Options(RuleOptions):
    """Options of ``relocbench build-dataset synthetic``; the preset sets the others' defaults."""

    LATER = (
        *("imaging", "months", "people", "route", "views", "rolling_shutter", "min_distance", "min_angle"),
        *("camera_pairs", "tier", "pairs", "repeating_street"),
        *("depth", "depth_points", "depth_error"),
    )
    PATHS = ("salt_file",)

    preset: Literal["smoke", "demo", "carla", "oxford"] = Field(
        "demo", description="defaults of the other options; those that this help shows are demo's"
    )
    name: str = Field("", description="name of the dataset; default: synthetic-PRESET")
    licence: str = Field("CC0-1.0", description="licence of the dataset, kept in dataset.yaml")
    conditions: tuple[str, ...] = Field(  # type: ignore[assignment]  # names of conditions instead of descriptions
        ("Sunny", "Overcast", "WetNoon", "Night"), description="conditions to drive in, the reference's first"
    )
    factors: dict[str, Factors] = Field({}, description="conditions of your own, name -> factors; YAML only")
    sweep: str | None = Field(None, description="a sweep instead of conditions: only one factor changes, such as light")
    sweep_steps: int = Field(5, ge=2, le=100, description="number of conditions in a sweep")
    traffic: float | None = Field(
        None, ge=0, le=10, description="moving cars per 100 m of lane, in all conditions; default: each condition's own"
    )
    people: float | None = Field(None, ge=0, le=50, description="people per 100 m of pavement; default: by condition")
    months: float | None = Field(
        None, gt=0, le=24, description="months by which the street has aged, in all conditions but the first"
    )
    imaging: Literal["ideal", "varied"] = Field(
        "ideal",
        description="'varied': each traversal has a camera of its own, drawn from the seed: response, white balance, "
        "noise, blur, glare, dirt on the lens, sharpening, compression; 'ideal': all have the same clean camera",
    )
    rolling_shutter: float = Field(
        0.0, ge=0, le=0.1, description="seconds from an image's first row to its last; its pose is the middle row's"
    )
    views: Views = Field(
        "same",
        description="'varied': each traversal but the reference has a rig of its own, drawn from the seed: focal "
        "length, size of images, height, pitch, yaw, distortion of the lens; 'same': all have the same rig; views of "
        "conditions by hand, name -> view: YAML only",
    )
    cameras: Literal["front", "stereo", "wide-stereo", "six", "around"] = Field("front", description="the rig")
    camera_pairs: Literal["same", "across"] = Field(
        "same",
        description="'same': queries of each camera are paired with keyframes of that camera; 'across': with keyframes "
        "of whichever camera of the rig sees most of the same (default pair rule)",
    )
    size: ImageSize = Field("320x240", description="pixels, WIDTHxHEIGHT, or one number for both")
    steps: int = Field(
        16,
        ge=2,
        le=100_000,
        description="steps of a traversal, ten per second; for recordings: frames, by default 160, at 16 (robotcar) or "
        "10 (kitti) per second",
    )
    traversals: int = Field(1, ge=1, le=100, description="traversals per condition and split")
    split: Literal["train", "validation", "test", "all"] = Field("test", description="split whose district is driven")
    extent: float = Field(250.0, ge=190, le=1000, description="side of a district in metres")
    speed: float = Field(8.0, gt=0, le=40, description="mean speed in m/s")
    lateral: float = Field(0.6, ge=0, le=4, description="greatest distance of drives from the lane's middle in metres")
    heading: float = Field(
        2.0, ge=0, le=45, description="greatest angle in degrees between rig and direction of travel"
    )
    distance: float = Field(1.6, gt=0, le=100, description="mean distance of pairs in metres (default pair rule)")
    min_distance: float = Field(
        0.0,
        ge=0,
        description="nearest pair in metres (default pair rule); above 0, distances are spread evenly from there to "
        "--max-distance",
    )
    min_angle: float = Field(0.0, ge=0, lt=180, description="narrowest pair in degrees (default pair rule)")
    max_distance: float = Field(10.0, gt=0, description="farthest pair in metres (default and nearest rule)")
    max_angle: float = Field(30.0, gt=0, le=180, description="widest pair in degrees (default and nearest rule)")
    pair_rule: Literal["step", "nearest"] | None = Field(
        None,
        description="'step': frame i with frame i + k of the same traversal; 'nearest': each query with the nearest "
        "keyframe; default: a keyframe at a random distance with mean --distance",
    )
    reference: References = Field(
        "first",
        description="'first': a split's first traversal is the map of all; 'all': each; 'others': each, of others only",
    )
    correspondences: int = Field(
        500, ge=0, description="ground-truth correspondences kept for each pair, spread over the image; 0 for none"
    )
    tier: Tier | None = Field(
        None, description="keep only the pairs of this tier of difficulty; draw many, since most may be of another"
    )
    pairs: int | None = Field(None, ge=1, description="most pairs that a pair set keeps, evenly along the drive")
    repeating_street: RepeatingStreet = Field(
        "keep",
        description="pairs on the street whose houses repeat themselves: 'group' counts them apart, 'avoid' leaves "
        "them out, 'keep' treats them as all others",
    )
    extras: tuple[ExtraKind, ...] = Field(
        (), description="further images to write to OUT/extras: normals, instance, semantic, changed"
    )
    salt_file: Path | None = Field(None, description=SALT_FILE)
    depth: DepthKind = Field(
        "exact",
        description="what keyframes know of depth: 'exact'; 'points': a sparse map's corners; 'lidar': what the camera "
        "sees of a spinning lidar's points; 'stereo': depth images with the errors and holes of matching",
    )
    depth_points: int = Field(500, ge=20, le=20_000, description="--depth points: most points of a keyframe")
    depth_error: float = Field(
        0.5,
        ge=0.01,
        le=5,
        description="standard deviation in pixels of what depth is computed from: parallax over 1 m (--depth points), "
        "disparity over 0.54 m (--depth stereo)",
    )

    recording: Literal["robotcar", "kitti", "boreas"] | None = Field(
        None,
        description="record drives (camera, lidar, odometry, GNSS) in this layout instead of making a dataset: one per "
        "split, condition, route and traversal",
    )
    route: tuple[Literal["common", "detour", "crossing", "return", "periodic", "other-lane"], ...] = Field(
        ("common",),
        description="the routes to drive in each condition: the common one; a detour from it through other streets; "
        "one that takes one of its crossings in another direction; its return in the other lane; one along the street "
        "with repeating facades; the common one in the lane on the left, as a car that overtakes. The first of a "
        "dataset is the map's",
    )
    recording_cameras: tuple[str, ...] = Field(
        (),
        description="recording: cameras, such as stereo/left,mono_rear or image_0, or none; default: all six of "
        "robotcar, the two grey ones of kitti, the one of boreas",
    )
    image_scale: float = Field(0.5, ge=0.05, le=1, description="recording: image size relative to the real cameras")
    rings: int = Field(
        64, ge=16, le=64, description="kitti and boreas recordings, and --depth lidar: rings of the lidar"
    )
    azimuths: int = Field(2000, ge=100, le=10_000, description="kitti and boreas recordings: points per ring and turn")
    motion_distorted: bool = Field(
        False, description="kitti recording: write scans without motion compensation, unlike KITTI's own"
    )

    @model_validator(mode="before")
    @classmethod
    def _start_from_preset(cls, values: Any) -> Any:
        if not isinstance(values, dict):
            return values
        refuse_what_has_no_effect(values)
        frames = {"steps": _RECORDING_FRAMES} if values.get("recording") else {}
        return {**frames, **PRESETS.get(str(values.get("preset", "demo")), {}), **values}

    @model_validator(mode="after")
    def _one_thing_varies(self) -> Self:
        if self.imaging == "varied" and self.sweep is not None:
            raise ValueError("imaging 'varied' changes the cameras, but in a sweep a single factor differs")
        if self.months is not None and self.sweep is not None:
            raise ValueError("months changes all conditions but the first, but in a sweep a single factor differs")
        if self.views != "same" and self.sweep is not None:
            raise ValueError("views other than 'same' change the cameras, but in a sweep a single factor differs")
        return self

    @model_validator(mode="after")
    def _bounds_leave_room(self) -> Self:
        for what, unit in (("distance", "m"), ("angle", "degrees")):
            low, high = getattr(self, f"min_{what}"), getattr(self, f"max_{what}")
            if low and self.pair_rule is not None:
                raise ValueError(f"min_{what} applies to the default pair rule only, not to {self.pair_rule}")
            if low >= high:
                raise ValueError(f"min_{what} is {low:g} {unit}, expected less than max_{what}, {high:g} {unit}")
        return self

    @model_validator(mode="after")
    def _cameras_to_choose_from(self) -> Self:
        if self.camera_pairs == "same":
            return self
        from relocbench.datasets.synthetic.drives.rig import RIGS

        if len(RIGS[self.cameras].mounts) == 1:
            raise ValueError(f"camera_pairs across has no effect with the rig '{self.cameras}', which has one camera")
        if self.pair_rule is not None:
            raise ValueError(f"camera_pairs across applies to the default pair rule only, not to {self.pair_rule}")
        if self.elsewhere:
            raise ValueError("elsewhere applies to sets of one camera only, not to camera_pairs across")
        return self

    @model_validator(mode="after")
    def _negative_pairs_of_pairs_that_are_asked(self) -> Self:
        if self.elsewhere and (self.tier is not None or self.pairs is not None):
            option = "tier" if self.tier is not None else "pairs"
            raise ValueError(f"elsewhere exchanges queries of all pairs, of which {option} keeps only some")
        return self

    @property
    def width_height(self) -> tuple[int, int]:
        """Image size in pixels."""
        return width_height(self.size)


def _conditions(options: Options) -> dict[str, NamedCondition]:
    """The conditions to drive in. Raises ConfigError as :func:`conditions_of` does."""
    swept = options.sweep, options.sweep_steps
    return conditions_of(options.conditions, options.factors, *swept, options.traffic, options.months, options.people)


def _asked(options: Options, conditions: dict[str, NamedCondition]) -> AskedDrives:
    from relocbench.datasets.synthetic.jobs.plan import AskedDrives

    splits = SPLITS if options.split == "all" else (options.split,)
    return AskedDrives(splits, conditions, options.traversals, options.seed, options.route)


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Render a dataset.

    Args:
        sources: must be empty.

    Raises:
        ConfigError: sources are given, a condition, sweep or route is unknown, or the salt cannot be used.
        DatasetError: ``out`` holds something else, or a pair set would be empty.
    """
    from relocbench.datasets.core.build import Build
    from relocbench.datasets.core.writer import DatasetWriter
    from relocbench.datasets.importers.assembly import configuration
    from relocbench.datasets.synthetic.drives.drive import DriveStyle
    from relocbench.datasets.synthetic.drives.rig import rig_named
    from relocbench.datasets.synthetic.drives.routes import check_routes
    from relocbench.datasets.synthetic.jobs.pair_sets import plan_pair_sets, write_pair_sets
    from relocbench.datasets.synthetic.jobs.pairs import DistanceSpread
    from relocbench.datasets.synthetic.jobs.plan import drive_cameras, drive_views, evaluated_drives, make_plans
    from relocbench.datasets.synthetic.jobs.rendering import render_all
    from relocbench.datasets.synthetic.jobs.selection import Selection
    from relocbench.datasets.synthetic.renderer.revision import RENDERER_REVISION

    assert isinstance(options, Options)
    _no_sources(sources)
    if options.recording is not None:
        raise ConfigError(f"--recording {options.recording} makes recordings, not a dataset")
    conditions = _conditions(options)
    record = configuration("synthetic", [], options)
    # Extra images can be added to a finished dataset later, because no score depends on them.
    for name in {"extras", "recording", *without_effect_on_datasets(options.depth)}:
        del record["options"][name]
    record["renderer"] = RENDERER_REVISION
    record["factors"] = {name: c.factors.model_dump(mode="json") for name, c in conditions.items()}
    options = salted(options, options.split, record, out, reporter)
    check_routes(options.route)
    asked = _asked(options, conditions)
    own = drive_cameras(asked, varied=options.imaging == "varied")
    if options.imaging == "varied":
        record["imaging"] = {name: imaging.model_dump(mode="json") for name, imaging in own.items()}
    views = drive_views(asked, options.views, options.width_height)
    if views:
        record["views"] = {name: view.model_dump(mode="json", exclude_none=True) for name, view in views.items()}
    writer = DatasetWriter(out, options.name or f"synthetic-{options.preset}", record, options.licence)
    plans = make_plans(
        asked,
        options.steps,
        DriveStyle(options.speed, options.lateral, options.heading),
        extent_m=options.extent,
        reporter=reporter,
        rig=rig_named(options.cameras),
        size=options.width_height,
        imaging=own,
        views=views,
        depth=MapDepth(options.depth, options.depth_points, options.depth_error, options.rings),
        readout_s=options.rolling_shutter,
    )
    job = Build(writer, options, reporter, run)
    spread = DistanceSpread(
        options.distance, options.max_distance, options.max_angle, options.min_distance, options.min_angle
    )
    # A rule that no pair meets is refused before anything is written.
    selection, across = Selection(options.tier, options.pairs), options.camera_pairs == "across"
    drives = evaluated_drives(
        plans,
        references=options.reference,
        traversals=options.traversals,
        pair_rule=options.pair_rule,
    )
    pair_sets = plan_pair_sets(job, drives, spread, selection, options.repeating_street, across=across)
    for plan in plans:
        writer.traversal(plan.file(), dict(zip(plan.times, plan.drive.T_world_rig, strict=True)))
    render_all(job, plans, options.extras)
    return writer.finish(write_pair_sets(job, pair_sets))


def record(
    sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run
) -> RecordingFolder | None:
    """Record drives; returns None if the options ask for a dataset instead.

    Raises:
        ConfigError: sources are given, a condition, sweep or camera is unknown, a condition has a camera of its own, or
            a district has no such route.
        DatasetError: ``out`` holds something else.
    """
    assert isinstance(options, Options)
    if options.recording is None:
        return None
    from relocbench.datasets.synthetic.drives.drive import DriveStyle
    from relocbench.datasets.synthetic.drives.routes import check_routes
    from relocbench.datasets.synthetic.jobs.recording import DriveOptions
    from relocbench.datasets.synthetic.jobs.recording_set import check_folder, plan_drives, record_all

    _no_sources(sources)
    conditions = _conditions(options)
    refuse_imaging(conditions, "recordings")
    check_routes(options.route)
    cameras = None if not options.recording_cameras else tuple(c for c in options.recording_cameras if c != "none")
    if cameras is not None and len(set(cameras)) != len(cameras):
        raise ConfigError(f"--recording-cameras names a camera twice: {','.join(cameras)}")
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
    unused = {"preset", "conditions", "factors", "sweep", "sweep_steps", "traffic", "months", "people"}
    unused |= without_effect_on_recordings(options.recording)
    settings = {"kind": "synthetic", "licence": "CC0-1.0", **options.model_dump(mode="json", exclude=unused)}
    settings["conditions"] = {name: c.factors.model_dump(mode="json") for name, c in conditions.items()}
    check_folder(out, settings)
    drives = plan_drives(_asked(options, conditions), each.path_length_m, options.extent, reporter)
    return record_all(drives, conditions, each, out, settings, reporter, run)


def _no_sources(sources: list[Path]) -> None:
    if sources:
        raise ConfigError(f"synthetic is rendered and takes no recordings, got {sources[0]}")

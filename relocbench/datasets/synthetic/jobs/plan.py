"""The plan of a rendered dataset: route, motion and condition of each traversal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.schema import CameraEntry, ClockEntry, TraversalFile
from relocbench.datasets.pairs.posed_frames import PosedFrames
from relocbench.datasets.synthetic.conditions.condition import NamedCondition
from relocbench.datasets.synthetic.conditions.imaging import Imaging, draw_imaging
from relocbench.datasets.synthetic.conditions.presets import SPLITS, References
from relocbench.datasets.synthetic.conditions.views import CameraView, Views, draw_view
from relocbench.datasets.synthetic.drives.drive import RATE_HZ, STEP_NS, Drive, DriveStyle, drive, route_length
from relocbench.datasets.synthetic.drives.passers import all_that_moves
from relocbench.datasets.synthetic.drives.rig import RIGS, Rig
from relocbench.datasets.synthetic.drives.routes import ROUTES, RouteName, route
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.keyframe_depth import check_reach
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.map_depth.kinds import EXACT, MapDepth
from relocbench.datasets.synthetic.map_depth.matched import stored_sigma
from relocbench.datasets.synthetic.town.moving import Moving
from relocbench.errors import ConfigError, available
from relocbench.geometry import Camera
from relocbench.progress import Reporter

Cameras = Mapping[str, tuple[Camera, Array]]
"""name -> (camera, ``T_rig_cam`` (4, 4))"""

_FIRST_NS = 1_000_000_000_000
"""time between the starts of traversals"""


@dataclass(frozen=True, eq=False)
class TraversalPlan:
    """One traversal, before it is rendered."""

    name: str
    number: int
    """number in the order of (split, condition, route, traversal), on which seeds depend"""
    split: str
    place: DistrictSpec
    condition: NamedCondition
    reference: NamedCondition
    """condition of the split's reference traversal"""
    cameras: Cameras
    drive: Drive
    moving: tuple[tuple[Moving, ...], ...]
    """what moves, at each step"""
    imaging: Imaging | None = None
    """the drive's own camera, or None for the ideal one"""
    view: CameraView | None = None
    """by which ``cameras`` differ from the dataset's rig; None for no difference"""
    depth: MapDepth = EXACT
    """what the drive tells of depth, if it is the map"""
    readout_s: float = 0.0
    """time from the first row of an image to the last; 0 for a global shutter"""

    @property
    def times(self) -> tuple[int, ...]:
        """Times of the steps in nanoseconds."""
        start = (self.number + 1) * _FIRST_NS
        return tuple(start + i * STEP_NS for i in range(len(self.drive.along)))

    def file(self) -> TraversalFile:
        """The content of ``traversal.yaml``."""
        error_px = self.depth.error_px if self.depth.kind == "stereo" else 0.0
        entries = {
            name: CameraEntry.of(camera, T_rig_cam, stored_sigma(camera, error_px))
            for name, (camera, T_rig_cam) in self.cameras.items()
        }
        return TraversalFile(
            name=self.name,
            condition=self.condition.label,
            location=f"procedural town, {self.split} district, seed {self.place.named_seed}",
            rate_hz=RATE_HZ,
            cameras=entries,
            source=f"rendered, seed {self.place.named_seed}",
            clock=self._clock(),
        )

    def _clock(self) -> ClockEntry | None:
        """What is known of the time of images; nothing needs to be said of a global shutter."""
        if self.readout_s == 0:
            return None
        how = "rendered with a rolling shutter; the pose is that of the middle row"
        known = {"applied_s": 0.0, "offset_s": 0.0, "sigma_s": 0.0, "readout_s": self.readout_s}
        return ClockEntry.model_validate({**known, "verdict": "one clock", "how": how})

    def frames(self, camera: str) -> PosedFrames:
        """All frames of a camera, each of which has depth or points."""
        return PosedFrames(self.times, self.drive.T_world_rig @ self.cameras[camera][1], frozenset(self.times))


def traversal_name(split: str, condition: str, route: RouteName, number: int) -> str:
    """The name of a traversal, which names its route unless it is the common one."""
    return "-".join([split, condition, *([] if route == "common" else [route]), str(number)])


def drive_cameras(
    splits: Sequence[str],
    conditions: Mapping[str, NamedCondition],
    traversals: int,
    *,
    seed: int,
    varied: bool,
    routes: Sequence[RouteName] = ("common",),
) -> dict[str, Imaging]:
    """The cameras of traversals that have one of their own, by name: their condition's or, if ``varied``, a drawn one.

    The camera of a traversal does not depend on which other splits and routes are built with it.
    """
    found = {}
    for at, (split, name, way, number) in _each(splits, conditions, routes, traversals):
        imaging = conditions[name].factors.imaging
        if imaging is None and varied:
            imaging = draw_imaging(np.random.default_rng([seed, 9, *at]), dark=conditions[name].factors.dark)
        if imaging is not None:
            found[traversal_name(split, name, way, number)] = imaging
    return found


def drive_views(
    splits: Sequence[str],
    conditions: Mapping[str, NamedCondition],
    traversals: int,
    views: Views,
    *,
    seed: int,
    size: tuple[int, int],
    routes: Sequence[RouteName] = ("common",),
) -> dict[str, CameraView]:
    """The views of traversals that have one of their own, by name: their condition's or, if ``varied``, a drawn one.

    A drawn view does not depend on which other splits and routes are built. The reference traversal of a split has no
    drawn one.

    Args:
        size: (width, height) of the dataset's images in pixels.

    Raises:
        ConfigError: a view is given for a condition that is not built.
    """
    found: dict[str, CameraView] = {}
    if views == "same":
        return found
    by_hand = views if isinstance(views, dict) else {}
    for name in by_hand:
        if name not in conditions:
            raise ConfigError(f"views: no condition '{name}'{available(name, conditions)}")
    reference = next(iter(conditions)), routes[0], 0
    for at, (split, name, way, number) in _each(splits, conditions, routes, traversals):
        if name in by_hand:
            found[traversal_name(split, name, way, number)] = by_hand[name]
        elif views == "varied" and (name, way, number) != reference:
            drawn = draw_view(np.random.default_rng([seed, 57, *at]), size)
            found[traversal_name(split, name, way, number)] = drawn
    return found


def _each(
    splits: Sequence[str], conditions: Mapping[str, NamedCondition], routes: Sequence[RouteName], traversals: int
) -> Iterator[tuple[list[int], tuple[str, str, RouteName, int]]]:
    """What is drawn by beside the seed, and split, condition, route and number within these, of each traversal."""
    for split, (k, name), way, number in product(splits, enumerate(conditions), routes, range(traversals)):
        yield _drawn_by(split, k, way, number), (split, name, way, number)


def _drawn_by(split: str, condition: int, route: RouteName, number: int) -> list[int]:
    """What the random choices of a traversal depend on beside the seed."""
    on_other_route = [] if route == "common" else [ROUTES.index(route)]
    return [SPLITS.index(split), condition, number, *on_other_route]


def make_plans(
    splits: Sequence[str],
    conditions: Mapping[str, NamedCondition],
    traversals: int,
    steps: int,
    style: DriveStyle,
    *,
    seed: int,
    extent_m: float,
    reporter: Reporter,
    rig: Rig = RIGS["front"],
    size: tuple[int, int] = (320, 240),
    imaging: Mapping[str, Imaging] | None = None,
    routes: Sequence[RouteName] = ("common",),
    views: Mapping[str, CameraView] | None = None,
    depth: MapDepth = EXACT,
    readout_s: float = 0.0,
) -> list[TraversalPlan]:
    """Plan all traversals, ordered by split, condition, route and number.

    A traversal does not depend on which other splits are built with it.

    Args:
        size: (width, height) of images in pixels.
        imaging: of traversals that have a camera of their own, by name.
        views: of traversals that have a view of their own, by name.
        depth: what drives tell of depth.
        readout_s: time from the first row of an image to the last; 0 for a global shutter.

    Raises:
        ConfigError: errors leave hardly any depth, a district has no such route of this length, or two traversals would
            have the same name.
    """
    plans = []
    imaging, views = imaging or {}, views or {}
    scene = {name: c.model_copy(update={"factors": c.factors.scene}) for name, c in conditions.items()}
    first = next(iter(scene.values()))
    with reporter.stage("laying out districts", len(splits)) as advance:
        for split in splits:
            place = DistrictSpec(seed, split, extent_m)
            town, needed = scenes.district(place), route_length(steps, style)
            paths = {name: route(town.network, town.periodic.street, name, needed, seed) for name in routes}
            for k, (name, condition) in enumerate(scene.items()):
                for r, number in product(range(len(routes)), range(traversals)):
                    path = paths[routes[r]]
                    identity = ((SPLITS.index(split) * len(conditions) + k) * len(routes) + r) * traversals + number
                    own = traversal_name(split, name, routes[r], number)
                    rng = np.random.default_rng([seed, 5, *_drawn_by(split, k, routes[r], number)])
                    driven = drive(path, steps, style, rng)
                    look, view = imaging.get(own), views.get(own)
                    cameras = rig.cameras(*size, view)
                    for camera, _ in cameras.values():
                        check_reach(depth, camera)
                    moving = all_that_moves(town.footpaths, path, driven, condition.factors, rng)
                    plan = (own, identity, split, place, condition, first, cameras, driven, moving, look, view)
                    plans.append(TraversalPlan(*plan, depth, readout_s))
            advance(1)
    for name, times in Counter(plan.name for plan in plans).items():
        if times > 1:
            raise ConfigError(f"two traversals would be called '{name}'; give the condition another name")
    return plans


def evaluated_drives(
    plans: Sequence[TraversalPlan], *, references: References, traversals: int, pair_rule: str | None
) -> list[tuple[TraversalPlan, TraversalPlan]]:
    """The (reference, query) traversals of every pair set.

    The reference's condition is also a query condition: in its second traversal, or else in the reference itself; with
    "others", in a second traversal alone.

    Args:
        references: the first traversal of each split alone, or all of them.
        traversals: in each condition.

    Raises:
        ConfigError: rule or references need a second traversal.
    """
    found = []
    for split in dict.fromkeys(plan.split for plan in plans):
        members = [plan for plan in plans if plan.split == split]
        for reference in members[:1] if references == "first" else members:
            for query in members:
                itself = reference is query
                alone = traversals == 1
                if pair_rule == "step":
                    wanted = itself
                elif pair_rule == "nearest" or references == "others":
                    wanted = not itself
                else:
                    wanted = not itself or alone
                if wanted:
                    found.append((reference, query))
    if not found:
        option = "--pair-rule nearest" if pair_rule == "nearest" else "--reference others"
        raise ConfigError(f"{option} needs a second traversal; name more conditions or raise --traversals")
    return found

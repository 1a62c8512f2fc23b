"""The plan of a rendered dataset: route, motion and condition of each traversal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, product
from typing import NamedTuple

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
    """as in :class:`AskedDrive`"""
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


class AskedDrive(NamedTuple):
    """One traversal that is to be planned."""

    name: str
    """which names its route unless it is the common one"""
    number: int
    """in the order of (split, condition, route, traversal), on which seeds depend"""
    drawn_by: tuple[int, ...]
    """what its random choices depend on beside the seed; not which other splits and routes are built with it"""
    split: str
    condition: str
    route: RouteName
    traversal: int
    """number among those in the condition on the route"""


@dataclass(frozen=True)
class AskedDrives:
    """What is driven: in each split's district, in each condition, on each route, some traversals."""

    splits: Sequence[str]
    conditions: Mapping[str, NamedCondition]
    traversals: int
    seed: int
    routes: Sequence[RouteName] = ("common",)

    def of(self, split: str) -> Iterator[AskedDrive]:
        """The drives in one district; the first is its reference."""
        at = SPLITS.index(split)
        everything = product(enumerate(self.conditions), enumerate(self.routes), range(self.traversals))
        for (k, condition), (r, way), n in everything:
            others = [] if way == "common" else [way]
            name = "-".join([split, condition, *others, str(n)])
            number = ((at * len(self.conditions) + k) * len(self.routes) + r) * self.traversals + n
            yield AskedDrive(name, number, (at, k, n, *map(ROUTES.index, others)), split, condition, way, n)


def drive_cameras(asked: AskedDrives, *, varied: bool) -> dict[str, Imaging]:
    """The cameras of traversals that have one of their own, by name: their condition's or, if ``varied``, a drawn one.

    The camera of a traversal does not depend on which other splits and routes are built with it.
    """
    found = {}
    for one in chain.from_iterable(map(asked.of, asked.splits)):
        factors = asked.conditions[one.condition].factors
        if factors.imaging is not None:
            found[one.name] = factors.imaging
        elif varied:
            found[one.name] = draw_imaging(np.random.default_rng([asked.seed, 9, *one.drawn_by]), dark=factors.dark)
    return found


def drive_views(asked: AskedDrives, views: Views, size: tuple[int, int]) -> dict[str, CameraView]:
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
        if name not in asked.conditions:
            raise ConfigError(f"views: no condition '{name}'{available(name, asked.conditions)}")
    for split in asked.splits:
        for k, one in enumerate(asked.of(split)):
            if one.condition in by_hand:
                found[one.name] = by_hand[one.condition]
            elif views == "varied" and k > 0:
                found[one.name] = draw_view(np.random.default_rng([asked.seed, 57, *one.drawn_by]), size)
    return found


def make_plans(
    asked: AskedDrives,
    steps: int,
    style: DriveStyle,
    *,
    extent_m: float,
    reporter: Reporter,
    rig: Rig = RIGS["front"],
    size: tuple[int, int] = (320, 240),
    imaging: Mapping[str, Imaging] | None = None,
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
    scene = {name: c.model_copy(update={"factors": c.factors.scene}) for name, c in asked.conditions.items()}
    first = next(iter(scene.values()))
    with reporter.stage("laying out districts", len(asked.splits)) as advance:
        for split in asked.splits:
            place = DistrictSpec(asked.seed, split, extent_m)
            town, needed = scenes.district(place), route_length(steps, style)
            paths = {r: route(town.network, town.periodic.street, r, needed, asked.seed) for r in asked.routes}
            for one in asked.of(split):
                path, condition = paths[one.route], scene[one.condition]
                rng = np.random.default_rng([asked.seed, 5, *one.drawn_by])
                driven = drive(path, steps, style, rng)
                look, view = imaging.get(one.name), views.get(one.name)
                cameras = rig.cameras(*size, view)
                for camera, _ in cameras.values():
                    check_reach(depth, camera)
                moving = all_that_moves(town.footpaths, path, driven, condition.factors, rng)
                plan = (one.name, one.number, split, place, condition, first, cameras, driven, moving, look, view)
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

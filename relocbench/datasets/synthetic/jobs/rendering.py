"""Rendering of a build's missing frames by workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Floats
from relocbench.datasets.core import images
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import RuleOptions
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.synthetic.camera.rolling_shutter import Readout
from relocbench.datasets.synthetic.camera.shot import Shot, camera_twists
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.drives.drive import RATE_HZ
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.keyframe_depth import Keyframe, Scan
from relocbench.datasets.synthetic.jobs.plan import TraversalPlan
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.map_depth.kinds import EXACT, MapDepth
from relocbench.datasets.synthetic.renderer.render import Frame
from relocbench.datasets.synthetic.town.moving import Moving
from relocbench.execution import chunks, run_units
from relocbench.files import write_bytes
from relocbench.geometry import Camera

_STEPS_A_UNIT = 8
_WORTH_WORKERS = 8
"""images; fewer are rendered before other processes have started"""
_LIDAR = 1000
"""in place of a camera's number in the seed of a scan"""


@dataclass(frozen=True, eq=False)
class FrameWork:
    """One image of one camera, and which of its files are missing."""

    camera: Camera
    T_world_cam: Array
    seed: int
    missing: dict[str, Path]
    """kind -> path"""
    shot: Shot | None = None
    """of the drive's own camera, if it has one"""
    T_world_vehicle: Array | None = None
    """of the car with the headlights, where a view of the drive's own may look elsewhere"""
    distortion: float = 0.0
    """of the lens of the drive's own view"""
    scan: Scan | None = None
    """at its time, for maps of a lidar"""
    readout: Readout | None = None
    """of a rolling shutter"""


@dataclass(frozen=True, eq=False)
class StepWork:
    """The images of one moment."""

    moving: tuple[Moving, ...]
    frames: tuple[FrameWork, ...]


@dataclass(frozen=True, eq=False)
class RenderUnit:
    """Some steps of one traversal, rendered by one worker."""

    place: DistrictSpec
    factors: Factors
    reference: Factors
    steps: tuple[StepWork, ...]
    depth: MapDepth = EXACT
    """what the drive tells of depth"""

    @property
    def images(self) -> int:
        return sum(len(step.frames) for step in self.steps)

    def __str__(self) -> str:
        first = next(iter(self.steps[0].frames[0].missing.values()))
        return f"{self.images} images from {first} on"


def render_all(job: Build[RuleOptions], plans: Sequence[TraversalPlan], kinds: Sequence[str]) -> None:
    """Render what is missing."""
    steps = [(plan, missing_steps(plan, job.writer.layout, job.options.seed, kinds)) for plan in plans]
    units = [_unit(plan, part) for plan, missing in steps for part in chunks(missing, _STEPS_A_UNIT)]
    total = sum(unit.images for unit in units)
    run = job.run if total >= _WORTH_WORKERS else job.run.single_process()
    with job.reporter.stage("rendering", total) as advance:
        for _, count in run_units(render_unit, units, run):
            advance(count)


def missing_steps(plan: TraversalPlan, layout: DatasetLayout, seed: int, kinds: Sequence[str]) -> list[StepWork]:
    """The steps of a traversal with missing or truncated files."""
    target = layout.traversal(plan.name)
    twists = {name: camera_twists(plan.drive.T_world_rig @ T, 1 / RATE_HZ) for name, (_, T) in plan.cameras.items()}
    found = []
    for i, (timestamp, T_world_rig) in enumerate(zip(plan.times, plan.drive.T_world_rig, strict=True)):
        frames = []
        scan = None
        if plan.depth.kind == "lidar":
            scan_seed = scenes.frame_seed(seed, plan.number, i, _LIDAR)
            scan = Scan(plan.place, plan.condition.factors, plan.moving[i], T_world_rig, scan_seed)
        for c, (name, (camera, T_rig_cam)) in enumerate(plan.cameras.items()):
            known = target.depth if plan.depth.stored_as == "depth" else target.points
            files = {"image": target.image(name, timestamp), plan.depth.stored_as: known(name, timestamp)}
            files |= {k: extra_path(layout.root, plan.name, k, name, timestamp) for k in kinds}
            missing = {kind: path for kind, path in files.items() if not images.is_whole(path)}
            if missing:
                number = scenes.frame_seed(seed, plan.number, i, c)
                shot = Shot(plan.imaging, i / RATE_HZ, twists[name][i], c) if plan.imaging is not None else None
                car, bent = (None, 0.0) if plan.view is None else (T_world_rig, plan.view.distortion)
                readout = Readout(plan.readout_s, twists[name][i]) if plan.readout_s > 0 else None
                pose = T_world_rig @ T_rig_cam
                frames.append(FrameWork(camera, pose, number, missing, shot, car, bent, scan, readout))
        if frames:
            found.append(StepWork(plan.moving[i], tuple(frames)))
    return found


def _unit(plan: TraversalPlan, steps: Sequence[StepWork]) -> RenderUnit:
    return RenderUnit(plan.place, plan.condition.factors, plan.reference.factors, tuple(steps), plan.depth)


def render_unit(unit: RenderUnit) -> int:
    """Render and write the frames of a unit; returns their number."""
    for step in unit.steps:
        renderer = scenes.renderer(unit.place, unit.factors, step.moving)
        for work in step.frames:
            own = work.T_world_vehicle, work.shot, work.distortion, work.readout
            frame = renderer.render(work.camera, work.T_world_cam, work.seed, *own)
            for kind, path in work.missing.items():
                _WRITERS[kind](path, frame, work, unit)
    return unit.images


def _write_changed(path: Path, frame: Frame, work: FrameWork, unit: RenderUnit) -> None:
    """Write what has changed as 8-bit grey, 255 where it has."""
    camera = work.camera, work.T_world_cam
    changed = scenes.changed_since(unit.place, unit.reference, unit.factors, frame, *camera)
    images.write_image(path, np.where(changed, 255, 0).astype(np.uint8))


def _keyframe(frame: Frame, work: FrameWork) -> Keyframe:
    return Keyframe(frame, work.camera, work.T_world_cam, work.seed, work.scan)


_WRITERS: dict[str, Callable[[Path, Frame, FrameWork, RenderUnit], None]] = {
    "image": lambda path, frame, work, unit: images.write_image(path, frame.rgb),
    "depth": lambda path, frame, work, unit: images.write_depth(path, _keyframe(frame, work).depth(unit.depth)),
    "points": lambda path, frame, work, unit: images.write_points(path, _keyframe(frame, work).points(unit.depth)),
    "normals": lambda path, frame, work, unit: write_normals(path, frame.normal),
    "instance": lambda path, frame, work, unit: write_instance(path, frame.instance),
    "semantic": lambda path, frame, work, unit: images.write_image(path, frame.semantic),
    "changed": _write_changed,
}


def extra_path(root: Path, traversal: str, kind: str, camera: str, timestamp_ns: int) -> Path:
    """Path of an extra image below the dataset's folder, ``extras/TRAVERSAL/KIND/CAMERA/TIMESTAMP.png``.

    No score depends on extra images, so neither the manifest nor the fingerprint covers them.
    """
    return root / "extras" / traversal / kind / camera / f"{timestamp_ns}.png"


def write_normals(path: Path, normal: Floats) -> None:
    """Write unit normals (H, W, 3) in world axes as 16-bit RGB ``(n + 1) 32767.5``; the sky, (0, 0, 0), is mid grey."""
    stored = np.rint((np.clip(normal, -1, 1) + 1) * 32767.5).astype(np.uint16)[..., ::-1]
    data = cv2.imencode(".png", np.ascontiguousarray(stored), [cv2.IMWRITE_PNG_COMPRESSION, 4])[1]
    write_bytes(path, bytes(data))


def write_instance(path: Path, instance: NDArray[np.uint32]) -> None:
    """Write object numbers (H, W) as 8-bit RGB: ``R + 256 G + 65536 B``."""
    parts = [(instance >> shift & 255).astype(np.uint8) for shift in (0, 8, 16)]
    images.write_image(path, np.stack(parts, axis=-1))

"""A worker's part of a recording: rendering some images or simulating some scans."""

from __future__ import annotations

import pickle
import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from relocbench.arrays import Array, Image
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.jobs.latest import Reusable, forget_all, latest, latest_renderer
from relocbench.datasets.synthetic.layouts.recorded import CarTrack, Layout, SensorMotion, TrueTrajectory, cars_at
from relocbench.datasets.synthetic.lidar import lidar
from relocbench.datasets.synthetic.town.mesh import Mesh
from relocbench.datasets.synthetic.town.moving import Moving, moving_mesh
from relocbench.files import atomic_write
from relocbench.geometry import Camera

_CAR_RADIUS_M = 3.5


class RecordableDistrict(Protocol):
    """What can be recorded, such as :class:`relocbench.datasets.synthetic.town.town.District`; must be picklable."""

    @property
    def seed(self) -> int: ...

    @property
    def lamps(self) -> Array: ...


class Picture(Protocol):
    """What a renderer returns."""

    @property
    def rgb(self) -> Image: ...


class FrameRenderer(Reusable, Protocol):
    """A renderer of images, such as :class:`relocbench.datasets.synthetic.renderer.render.Renderer`."""

    def render(self, camera: Camera, T_world_cam: Array, frame_seed: int, /) -> Picture: ...


RendererFactory = Callable[[Mesh, Factors, Array, int], FrameRenderer]
"""called with mesh, factors, lamps (N, 3) and the seed of the surfaces' patterns"""
Composer = Callable[[Any, Factors], Mesh]
"""called with district and factors"""


def town_renderer(mesh: Mesh, factors: Factors, lamps: Array, seed: int) -> FrameRenderer:
    from relocbench.datasets.synthetic.renderer.render import Renderer

    return Renderer(mesh, factors, lamps, seed)


def town_compose(district: Any, factors: Factors) -> Mesh:
    from relocbench.datasets.synthetic.town.town import compose

    return compose(district, factors)


@dataclass(frozen=True, eq=False)
class DriveContext:
    """What all units of a drive share."""

    factors: Factors
    layout: Layout
    trajectory: TrueTrajectory
    tracks: Sequence[CarTrack]
    seed: tuple[int, int]
    district: Path = Path()
    """the pickled district, which each worker reads once; there is none before work begins"""
    make_renderer: RendererFactory = town_renderer
    compose: Composer = town_compose


@dataclass(frozen=True, eq=False)
class Unit:
    """Some images or some scans of a drive, as (sensor, index)."""

    drive: DriveContext
    work: Sequence[tuple[str, int]]

    def __str__(self) -> str:
        sensor, index = self.work[0]
        return f"{len(self.work)} files from {self.drive.layout.path(sensor, index)} on"


@contextmanager
def shared(district: RecordableDistrict, folder: Path) -> Iterator[Path]:
    """Pickle the district to a file that workers can read; it is removed afterwards, or by the next run."""
    pickled = folder / f".district.{secrets.token_hex(4)}.part"
    with atomic_write(pickled, "wb") as stream:
        pickle.dump(district, stream, protocol=pickle.HIGHEST_PROTOCOL)
    try:
        yield pickled
    finally:
        pickled.unlink(missing_ok=True)
        forget_all()


def _district(drive: DriveContext) -> Any:
    return latest("district", drive.district, lambda: pickle.loads(drive.district.read_bytes()))


def write_images(unit: Unit) -> int:
    """Render and write the images of a unit; returns their number."""
    drive, layout = unit.drive, unit.drive.layout
    for camera, index in unit.work:
        moment = int(layout.times[camera][index])
        present = cars_at(drive.tracks, moment)
        renderer = _renderer(drive, present)
        mount = layout.cameras[camera]
        pose = SensorMotion(drive.trajectory, mount.T_rig_cam)(np.array([moment]))[0]
        number = np.random.SeedSequence([*drive.seed, 5, sorted(layout.cameras).index(camera), index])
        picture = renderer.render(mount.camera, pose, int(number.generate_state(1)[0]))
        path = layout.path(camera, index)
        layout.write_image(camera, path, picture.rgb)
    return len(unit.work)


def _renderer(drive: DriveContext, present: Sequence[Moving]) -> FrameRenderer:
    def make() -> FrameRenderer:
        town = _district(drive)
        return drive.make_renderer(drive.compose(town, drive.factors), drive.factors, town.lamps, town.seed)

    return latest_renderer((drive.district, drive.factors), present, make)


def write_scans(unit: Unit) -> int:
    """Simulate and write the scans of a unit; returns their number."""
    drive, layout = unit.drive, unit.drive.layout
    scene = latest(
        "scene",
        (drive.district, drive.factors),
        lambda: lidar.LidarScene(drive.compose(_district(drive), drive.factors)),
    )
    others = latest("cars", (drive.district, drive.seed), lambda: _moving_objects(drive.tracks))
    for sensor, index in unit.work:
        mount = layout.lidars[sensor]
        rng = np.random.default_rng([*drive.seed, 7, sorted(layout.lidars).index(sensor), index])
        motion = SensorMotion(drive.trajectory, mount.T_rig_lidar)
        scan = lidar.scan(mount.lidar, scene, motion, int(layout.times[sensor][index]), drive.factors, rng, others)
        points = lidar.compensate(mount.lidar, scan, motion) if mount.compensated else scan.points
        path = layout.path(sensor, index)
        layout.write_scan(path, points, scan.reflectance, scan.returned)
    return len(unit.work)


def _moving_objects(tracks: Sequence[CarTrack]) -> list[lidar.MovingObject]:
    """The moving cars, each with its mesh in its own frame."""
    return [
        lidar.MovingObject(lidar.LidarScene(moving_mesh([Moving(np.eye(4), track.variant)])), track, _CAR_RADIUS_M)
        for track in tracks
    ]

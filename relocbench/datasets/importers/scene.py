"""Kind ``scene``: a small ray-cast street, driven three times under different light. Nothing is downloaded.

The keyframes are a bright morning's; an overcast noon and a dusk ask about them. Truth and depth are exact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from relocbench.datasets import images
from relocbench.datasets.dataset import Dataset
from relocbench.datasets.importers import Run
from relocbench.datasets.importers.assembly import check_conditions, configuration, write_pairs
from relocbench.datasets.importers.options import ImportOptions
from relocbench.datasets.importers.scene_render import Light, render, render_depth
from relocbench.datasets.schema import CameraEntry, Condition, TraversalFile
from relocbench.datasets.writer import DatasetWriter
from relocbench.errors import ConfigError
from relocbench.execution import run_units
from relocbench.geometry import Camera, make_transform, so3_exp
from relocbench.progress import Reporter

Array = NDArray[np.float64]

CAMERA = "front"
_RATE_HZ = 10.0
_LENGTH = 12.0
"""metres that each traversal drives"""
_EYE = 1.5
"""metres of the camera above the road"""
_DEPTH_SIGMA = (0.002, 0.0, 0.0)
"""metres: stored depth is rounded to 1/256 m"""


@dataclass(frozen=True)
class Drive:
    """One traversal: its light and the line it takes."""

    name: str
    condition: Condition
    light: Light
    lateral: float
    """metres to the right of the street's axis"""
    yaw_deg: float
    """of the camera on the car, to the right"""


DRIVES = (
    Drive(
        "bright",
        Condition(weather="sunny", season="summer", time_of_day="morning"),
        Light(sun=(-0.5, -1.0, -0.4), sun_strength=1.0, ambient=0.55),
        lateral=0.3,
        yaw_deg=0.0,
    ),
    Drive(
        "overcast",
        Condition(weather="overcast", season="autumn", time_of_day="noon"),
        Light(
            sun=(0.0, -1.0, 0.0), sun_strength=0.0, ambient=1.0, sky=(0.80, 0.82, 0.85), gain=0.9, bias=0.04, noise=0.01
        ),
        lateral=-0.1,
        yaw_deg=3.0,
    ),
    Drive(
        "dusk",
        Condition(weather="clear", season="autumn", time_of_day="dusk"),
        Light(
            sun=(0.9, -0.45, 0.3),
            sun_strength=0.40,
            ambient=0.20,
            colour=(1.0, 0.80, 0.65),
            sky=(0.35, 0.30, 0.40),
            gain=1.6,
            bias=0.03,
            gamma=0.7,
            vignetting=0.5,
            noise=0.02,
        ),
        lateral=0.8,
        yaw_deg=-4.0,
    ),
)


class Options(ImportOptions):
    """Options of ``relocbench build-dataset scene``."""

    pair_rule: Literal["step", "nearest"] | None = Field(
        None,
        description="'step': pairs within the bright traversal only; 'nearest': from it to the others only; "
        "default: both",
    )
    pair_step: tuple[int, ...] = Field((1, 2, 4, 8), description="frames between reference and query within 'bright'")
    frames: int = Field(16, ge=4, le=1000, description="frames of the reference traversal; the others have half")
    keyframe_every: int = Field(2, ge=1, description="each so-many-th frame of the reference is a keyframe with depth")
    width: int = Field(320, ge=32, le=4096, description="pixels")
    height: int = Field(240, ge=32, le=4096, description="pixels")
    traversals: int = Field(3, ge=1, le=3, description="bright alone, with overcast, or with overcast and dusk")


@dataclass(frozen=True, eq=False)
class _Unit:
    """A frame to render."""

    seed: int
    noise_seed: tuple[int, ...]
    camera: Camera
    T_world_cam: Array
    light: Light
    image: Path | None
    depth: Path | None


def _render_frame(unit: _Unit) -> None:
    if unit.image:
        rng = np.random.default_rng(unit.noise_seed)
        images.write_image(unit.image, render(unit.seed, unit.camera, unit.T_world_cam, unit.light, rng))
    if unit.depth:
        images.write_depth(unit.depth, render_depth(unit.seed, unit.camera, unit.T_world_cam))


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """A rendered dataset; it takes no sources.

    Raises:
        ConfigError: sources were named.
    """
    assert isinstance(options, Options)
    if sources:
        raise ConfigError(f"scene is rendered and takes no recordings, got {sources[0]}")
    drives = DRIVES[: options.traversals]
    check_conditions(options, [d.name for d in drives])
    licence = "CC0-1.0" if options.licence == "unknown" else options.licence
    writer = DatasetWriter(out, options.name or "scene", configuration("scene", [], options), licence)
    units: list[_Unit] = []
    for index, drive in enumerate(drives):
        units += _traversal(writer, drive, index, options)
    with reporter.stage("rendering", len(units)) as advance:
        for _ in run_units(_render_frame, units, workers=run.workers, scheduler=run.scheduler):
            advance(1)
    reference = drives[0].name
    splits: dict[str, list[str]] = {}
    for drive in drives:
        within = drive.name == reference
        if options.pair_rule not in (None, "step" if within else "nearest"):
            continue
        name = write_pairs(
            writer, reference, drive.name, CAMERA, options, source="rendered", where=out, reporter=reporter, run=run
        )
        splits.setdefault("within" if within else "across", []).append(name)
    if not splits:
        raise ConfigError("--pair-rule nearest needs a second traversal; --traversals is 1")
    return writer.finish(splits)


def _traversal(writer: DatasetWriter, drive: Drive, index: int, options: Options) -> list[_Unit]:
    """``traversal.yaml`` and poses of one drive; what is left to render."""
    camera = scene_camera(options.width, options.height)
    count = options.frames if index == 0 else max(options.frames // 2, 2)
    poses = trajectory(drive, count, np.random.default_rng([options.seed, 2, index]))
    first = (index + 1) * 1_000_000_000_000
    times = [first + round(i * 1e9 / _RATE_HZ) for i in range(count)]
    file = TraversalFile(
        name=drive.name,
        condition=options.conditions.get(drive.name, drive.condition),
        location="a rendered street",
        rate_hz=_RATE_HZ,
        cameras={CAMERA: CameraEntry.of(camera, depth_sigma=_DEPTH_SIGMA)},
        source=f"rendered, seed {options.seed}",
    )
    writer.traversal(file, dict(zip(times, poses, strict=True)))
    target = writer.layout.traversal(drive.name)
    units = []
    for i, (time, pose) in enumerate(zip(times, poses, strict=True)):
        # Depth of the others serves no method, but tells which correspondences are hidden.
        has_depth = index > 0 or i % options.keyframe_every == 0
        image = target.image(CAMERA, time) if writer.needs_image(drive.name, CAMERA, time) else None
        depth = target.depth(CAMERA, time) if has_depth and writer.needs_depth(drive.name, CAMERA, time) else None
        if image or depth:
            light = replace(drive.light, gain=drive.light.gain * (1 + 0.08 * np.sin(0.9 * i)))
            units.append(_Unit(options.seed, (options.seed, 3, index, i), camera, pose, light, image, depth))
    return units


def scene_camera(width: int, height: int) -> Camera:
    """A pinhole camera of about 70 degrees across."""
    focal = 0.72 * width
    return Camera("pinhole", width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def trajectory(drive: Drive, count: int, rng: np.random.Generator) -> Array:
    """(count, 4, 4) ``T_world_cam`` along the street: a smooth sway about the drive's own line."""
    s = np.linspace(0.0, 1.0, count)
    phases = rng.uniform(0, 2 * np.pi, size=4)
    z = _LENGTH * s + 0.15 * np.sin(2 * np.pi * s + phases[0])
    x = drive.lateral + 0.15 * np.sin(2.5 * np.pi * s + phases[1])
    yaw = np.radians(drive.yaw_deg) + np.radians(2.5) * np.sin(2 * np.pi * s + phases[2])
    pitch = np.radians(0.8) * np.sin(5 * np.pi * s + phases[3])
    zero = np.zeros_like(s)
    rotation = so3_exp(np.stack([zero, yaw, zero], axis=-1)) @ so3_exp(np.stack([pitch, zero, zero], axis=-1))
    return make_transform(rotation, np.stack([x, zero - _EYE, z], axis=-1))

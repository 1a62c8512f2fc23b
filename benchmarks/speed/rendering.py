"""The speed of the procedural renderer on two cores, compared with bare ray casting and with Mitsuba 3.

Two worker processes render 512x512 frames along a drive as a build does (`render_unit`: RGB and depth, encoded and
written to disk, among as many people as the condition has), first in `Sunny`, then in `WetNoon`, then in both with
everything on: a street after twelve months, traffic, a camera with every effect at the middle of what is drawn, a lens
that bends lines, and a rolling shutter. Times exclude the first images, for which the district, the ray tree and
compiled code are loaded. It is compared with:

- *bare rays*: in the same two processes, the time of Embree for one primary ray per pixel and one shadow ray for every
  surface that faces the sun, of the same frames, without edges, mirrors, colours and files.
- *Mitsuba 3*: the same triangles and cameras, the sun and a constant sky, direct illumination (`direct`), one grey
  diffuse material instead of textures, no mirrors and no files. Both cores work on one frame. Mitsuba samples
  illumination, which our renderer does not: the number of samples is the smallest for which the median noise over all
  surface pixels, after our exposure and tone curve, is no larger than the noise of our camera model. This favours
  Mitsuba: edges, where its noise is largest, do not change the median, and sampling noise as large as the camera's is
  accepted. The ratio at 16 samples, which are far too few, is also given, to show how much the conclusion depends on
  the number.

The peak memory of each worker, including set-up, is measured too. Ratios are of processor seconds, which other programs
hardly affect. Images per second are by wall-clock time; the number that two undisturbed cores would reach is also
given.

    python benchmarks/speed/rendering.py [--frames N] [--without-mitsuba]

The last line is JSON; `peak_mib` in it is the peak memory of the larger worker.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # in each worker; Mitsuba has its own thread pool

import argparse
import json
import math
import sys
import tempfile
import time
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.datasets.synthetic.camera.rolling_shutter import Readout
from relocbench.datasets.synthetic.camera.shot import Shot
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.conditions.imaging import RANGES, Imaging
from relocbench.datasets.synthetic.conditions.presets import previewed
from relocbench.datasets.synthetic.drives.drive import RATE_HZ, Drive
from relocbench.datasets.synthetic.drives.passers import passers
from relocbench.datasets.synthetic.drives.rig import rig_named
from relocbench.datasets.synthetic.drives.traffic import on_the_road
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.rendering import FrameWork, RenderUnit, StepWork, render_unit
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.renderer import samples as sampling
from relocbench.datasets.synthetic.renderer import shadows
from relocbench.datasets.synthetic.renderer.response import exposure_gain, tone_curve
from relocbench.datasets.synthetic.town.town import compose
from relocbench.execution.calling import pin_threads
from relocbench.geometry import Camera, invert

WORKERS = 2
SIZE = 512
PLACE = DistrictSpec(0, "test", 400.0)
ROUTE_M = 100.0
CAMERA = Camera("pinhole", SIZE, SIZE, 0.6 * SIZE, 0.6 * SIZE, (SIZE - 1) / 2, (SIZE - 1) / 2)
CONDITIONS = ("Sunny", "WetNoon")
EVERYTHING = {
    "months": 12.0,
    "traffic": 3.0,
    "imaging": Imaging.model_validate({name: (each.low + each.high) / 2 for name, each in RANGES.items()}),
}
TWIST = np.array([0, 0, 8.0, 0, 0.2, 0])
"""velocity of the camera, for what blurs and rolls: ahead at 8 m/s in a slight bend"""
DISTORTION = -0.1
READOUT_S = 0.03
TRIAL_SPP = 16
MITSUBA_FRAMES = 1
GREY = 0.3


def poses(count: int) -> list[Array]:
    """``T_world_cam`` of frames spread along the drive."""
    path = scenes.district(PLACE).network.drive(ROUTE_M, PLACE.seed)
    _, T_rig_cam = rig_named("front").cameras(SIZE, SIZE)["front"]
    return [path.pose(at) @ T_rig_cam for at in np.linspace(5, ROUTE_M - 5, count)]


def measured() -> dict[str, Factors]:
    """The conditions, and the same with everything on."""
    plain = previewed(CONDITIONS, everything=False, swept=None, steps=2)
    return plain | {f"{name}, everything on": f.model_copy(update=EVERYTHING) for name, f in plain.items()}


def unit_of(factors: Factors, shown: list[Array], folder: Path) -> RenderUnit:
    """The unit of work for these frames, as a build makes it."""
    steps = []
    town = scenes.district(PLACE)
    rigs = np.stack(shown) @ invert(rig_named("front").cameras(SIZE, SIZE)["front"][1])
    people = passers(town.footpaths, rigs, factors.people, np.random.default_rng(0))
    route = town.network.drive(ROUTE_M, PLACE.seed)
    driven = Drive(np.linspace(5, ROUTE_M - 5, len(shown)), rigs)
    cars = on_the_road(route, driven, factors.traffic, route.other_lane_m, np.random.default_rng(0))
    for i, T_world_cam in enumerate(shown):
        missing = {"image": folder / f"image-{i}.png", "depth": folder / f"depth-{i}.png"}
        frame = FrameWork(CAMERA, T_world_cam, scenes.frame_seed(0, 0, i, 0), missing)
        if factors.imaging is not None:
            shot, readout = Shot(factors.imaging, i / RATE_HZ, TWIST), Readout(READOUT_S, TWIST)
            frame = replace(frame, shot=shot, distortion=DISTORTION, readout=readout)
        steps.append(StepWork((*cars[i], *people[i]), (frame,)))
    return RenderUnit(PLACE, factors.scene, factors.scene, tuple(steps))


def bare_seconds(factors: Factors, shown: list[Array]) -> float:
    """Embree's processor time for primary and shadow rays of the frames, without the preparation of the rays."""
    renderer = scenes.renderer(PLACE, factors.scene)
    v, u = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    asked = np.ones(SIZE * SIZE, dtype=np.bool_)
    spent = 0.0
    for T in shown:
        view = sampling.View(T[:3, 3].copy(), T[:3, :3].copy(), CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
        samples = sampling.direct_samples(u.ravel(), v.ravel())
        rays = sampling.make_rays(view, samples)
        start = time.process_time()
        triangle = renderer._scene.closest(rays)
        spent += time.process_time() - start
        hits = renderer._surfaces(view, samples._replace(triangle=triangle))
        _, rays = shadows.shadow_rays(hits, asked, renderer._sky.to_sun, False, renderer._lamps)
        start = time.process_time()
        renderer._scene.occluded(rays)
        spent += time.process_time() - start
    return spent


def peak_mib() -> float:
    """The peak memory of this program. ru_maxrss would include what the parent held when it forked."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def work(number: int, frames: int, folder: Path, together: Barrier, answers: Queue[dict[str, Any]]) -> None:
    """One worker, which renders its frames while the other renders its own."""
    pin_threads()
    shown = poses(WORKERS * frames)[number::WORKERS]
    told: dict[str, Any] = {}
    for name, factors in measured().items():
        target = folder / f"{name}-{number}"
        target.mkdir()
        start = time.perf_counter()
        render_unit(unit_of(factors, shown[:2], target))
        setup = time.perf_counter() - start
        together.wait()
        start, cpu = time.perf_counter(), time.process_time()
        render_unit(unit_of(factors, shown, target))
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        together.wait()
        bare = bare_seconds(factors, shown)
        told[name] = {
            "setup_s": setup,
            "seconds": seconds,
            "cpu_s": cpu,
            "bare_cpu_s": bare,
            "bytes": sum(path.stat().st_size for path in target.iterdir()) / frames,
        }
        together.wait()
    told["peak_mib"] = peak_mib()
    answers.put(told)


def measure(frames: int, folder: Path) -> list[dict[str, Any]]:
    """The measurements of each worker."""
    context = get_context("spawn")
    together, answers = context.Barrier(WORKERS), context.Queue()
    workers = [context.Process(target=work, args=(k, frames, folder, together, answers)) for k in range(WORKERS)]
    for worker in workers:
        worker.start()
    told = [answers.get(timeout=600) for _ in workers]
    for worker in workers:
        worker.join()
    return told


class Mitsuba:
    """The district as a Mitsuba scene."""

    def __init__(self, factors: Factors, variant: str) -> None:
        import mitsuba as mi

        self._mi = mi
        self._factors = factors
        self._renderer = scenes.renderer(PLACE, factors)
        mi.set_variant(variant)
        self._scene = self._load()

    def _load(self) -> Any:
        mi = self._mi
        mesh = compose(scenes.district(PLACE), self._factors)
        grey = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": {"type": "rgb", "value": GREY}}}
        properties = mi.Properties()
        properties["material"] = mi.load_dict(grey)
        shape = mi.Mesh("town", len(mesh.vertices), len(mesh.triangles), props=properties)
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = mesh.vertices.ravel()
        parameters["faces"] = mesh.triangles.ravel()
        parameters.update()
        sky = self._renderer._sky
        return mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct"},
                "town": shape,
                "sky": {"type": "constant", "radiance": {"type": "rgb", "value": sky.ambient.tolist()}},
                "sun": {
                    "type": "directional",
                    "direction": (-sky.to_sun).tolist(),
                    # The unit of sunlight is the radiance of white paper that faces the sun.
                    "irradiance": {"type": "rgb", "value": (np.pi * sky.sun).tolist()},
                },
            }
        )

    def linear(self, T_world_cam: Array, spp: int, seed: int) -> Floats:
        """The radiance (H, W, 3) of one frame."""
        mi = self._mi
        # Mitsuba's cameras have x to the left and y up.
        to_world = mi.ScalarTransform4f((T_world_cam @ np.diag([-1.0, -1.0, 1.0, 1.0])).tolist())
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": math.degrees(2 * math.atan(SIZE / 2 / CAMERA.fx)),
                "near_clip": 0.05,
                "far_clip": 5000.0,
                "to_world": to_world,
                "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": spp},
            }
        )
        return np.array(mi.render(self._scene, sensor=sensor, spp=spp, seed=seed))[..., :3]

    def comparable_spp(self, T_world_cam: Array) -> tuple[int, float, float]:
        """The number of samples per pixel, and the median noise of Mitsuba and of our camera in grey levels."""
        frame = self._renderer.render(CAMERA, T_world_cam, 0)
        seen = frame.depth > 0
        level = frame.rgb.astype(np.float64).mean(axis=-1)[seen]
        f = self._factors
        camera = float(np.median(np.sqrt(f.read_noise**2 + (255 * f.shot_noise) ** 2 * level / 255)))
        pictures = [self.linear(T_world_cam, TRIAL_SPP, seed) for seed in (1, 2)]
        gain, curve = exposure_gain(np.mean(pictures, axis=0, dtype=np.float32), f), tone_curve(f.gamma)
        at = np.linspace(0, 1, len(curve)) ** 2 * 6.0
        a, b = (np.interp(picture * gain, at, curve) for picture in pictures)
        # The median of |x| of a normal variable is 0.6745 deviations.
        noise = float(np.median(np.abs(a - b)[seen]) / 0.6745 / math.sqrt(2))
        return max(1, math.ceil(TRIAL_SPP * (noise / camera) ** 2)), noise, camera

    def seconds(self, spp: int) -> tuple[float, float]:
        """Wall-clock and processor seconds of an image along the drive, after one image that compiles."""
        shown = poses(2 + MITSUBA_FRAMES)[1:-1]
        self.linear(shown[0], 1, 0)
        start, cpu = time.perf_counter(), time.process_time()
        for k, T_world_cam in enumerate(shown):
            self.linear(T_world_cam, spp, k)
        return (time.perf_counter() - start) / len(shown), (time.process_time() - cpu) / len(shown)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=20, help="images for each worker and condition")
    parser.add_argument(
        "--mitsuba-variant", default="scalar_rgb", help="llvm_ad_rgb where Mitsuba's LLVM backend works"
    )
    parser.add_argument("--without-mitsuba", action="store_true", help="measure the renderer and bare rays alone")
    arguments = parser.parse_args()
    frames, variant = arguments.frames, arguments.mitsuba_variant
    result: dict[str, Any] = {"benchmark": "rendering", "size": SIZE, "workers": WORKERS}
    with tempfile.TemporaryDirectory(prefix="relocbench-bench-") as scratch:
        told = measure(frames, Path(scratch))
    ours = {}
    for name in measured():
        rate = sum(frames / t[name]["seconds"] for t in told)
        ours[name] = float(np.mean([t[name]["cpu_s"] for t in told])) / frames
        bare = float(np.mean([t[name]["bare_cpu_s"] for t in told])) / frames
        print(
            f"{name}: {rate:.1f} images/s, {1e3 * ours[name]:.0f} ms an image of which rays {1e3 * bare:.0f}",
            file=sys.stderr,
        )
        result[name] = {
            "images_per_s": round(rate, 2),
            "images_per_s_of_two_free_cores": round(WORKERS / ours[name], 2),
            "cpu_ms": round(1e3 * ours[name], 1),
            "bare_cpu_ms": round(1e3 * bare, 1),
            "ratio_to_bare": round(bare / ours[name], 3),
            "kb_an_image": round(float(np.mean([t[name]["bytes"] for t in told])) / 1000),
            "setup_s": round(max(t[name]["setup_s"] for t in told), 1),
        }
    result["peak_mib"] = round(max(t["peak_mib"] for t in told))
    print(f"at most {result['peak_mib']} MiB a worker", file=sys.stderr)
    if not arguments.without_mitsuba:
        result["mitsuba_variant"] = variant
        compare(result, ours, variant)
    result["load_average"] = [round(x, 1) for x in os.getloadavg()]
    print(json.dumps(result))


def compare(result: dict[str, Any], ours: dict[str, float], variant: str) -> None:
    """Add Mitsuba's speed to the result, and the ratio of it to our processor seconds an image."""
    for name, factors in previewed(CONDITIONS, everything=False, swept=None, steps=2).items():
        mitsuba = Mitsuba(factors, variant)
        spp, noise, camera = mitsuba.comparable_spp(poses(3)[1])
        clock, cpu = mitsuba.seconds(spp)
        _, trial_cpu = mitsuba.seconds(TRIAL_SPP)
        print(f"{name}: Mitsuba {1 / clock:.2f} images/s at {spp} samples a pixel", file=sys.stderr)
        result[name] |= {
            "mitsuba_images_per_s": round(1 / clock, 3),
            "mitsuba_cpu_ms": round(1e3 * cpu),
            "mitsuba_spp": spp,
            "ratio_to_mitsuba": round(cpu / ours[name], 2),
            f"ratio_to_mitsuba_at_{TRIAL_SPP}_spp": round(trial_cpu / ours[name], 2),
            f"mitsuba_noise_at_{TRIAL_SPP}_spp": round(noise, 2),
            "camera_noise": round(camera, 2),
        }


if __name__ == "__main__":
    main()

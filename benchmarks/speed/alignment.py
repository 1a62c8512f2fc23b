"""The time of one direct alignment on one core, compiled and in plain NumPy.

A textured corridor (floor, ceiling, two walls and a back wall, ray-cast analytically) is seen by a 512x512 camera that
then moves forward by one metre. The reference is prepared beforehand; timed is all work for a query, which is its
pyramid and the coarse-to-fine alignment from the identity. Both implementations get the same arrays and must find the
same pose.

    python benchmarks/speed/alignment.py [--repeats N]
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported, the path before what tests share)
from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # one core; read when numpy is imported

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
import plain_alignment as plain

from baselines.alignment.direct.kernel import linearize
from baselines.alignment.direct.settings import Settings
from baselines.alignment.direct.solver import align
from baselines.alignment.shared.depth_map import LevelPoints
from baselines.alignment.shared.pyramid import camera_intrinsics, image_pyramid, with_gradients
from baselines.dso import Dso
from relocbench.arrays import Array, Floats, Image
from relocbench.geometry import Camera, invert, rotation_angle
from relocbench.tracking import Reference

CAMERA = Camera("pinhole", 512, 512, 380.0, 380.0, 255.5, 255.5)
STEP = 1.0  # metres between reference and query
WALLS = ((0, -3.0), (0, 4.0), (1, 1.6), (1, -2.5), (2, 24.0))  # (axis, coordinate): a corridor, metres
WAVES = 48


def render(T_cam_world: Array, rng_seed: int = 7) -> tuple[Image, Floats]:
    """Image and depth of the corridor, of which each wall has a texture of its own, a sum of seeded waves."""
    rng = np.random.default_rng(rng_seed)
    T_world_cam = invert(T_cam_world)
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float64)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
    directions, origin = rays @ T_world_cam[:3, :3].T, T_world_cam[:3, 3]
    depth = np.full(u.shape, np.inf)
    image = np.zeros(u.shape)
    for axis, coordinate in WALLS:
        # Wavelengths from 0.25 m to 8 m give texture on every pyramid level.
        wavelengths = np.exp(rng.uniform(np.log(0.25), np.log(8.0), WAVES))
        angles, phases = rng.uniform(0, 2 * np.pi, (2, WAVES))
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (coordinate - origin[axis]) / directions[..., axis]
        hit = (distance > 0) & (distance < depth)
        points = origin + directions[hit] * distance[hit, None]
        p, q = np.delete(points, axis, axis=-1).T
        wave_numbers = 2 * np.pi / wavelengths
        argument = np.outer(p, wave_numbers * np.cos(angles)) + np.outer(q, wave_numbers * np.sin(angles)) + phases
        # Waves too short for a pixel at this distance fade, as they do in a camera.
        fade = np.exp(-((distance[hit, None] / CAMERA.fx / wavelengths * 4) ** 2))
        image[hit] = 128 + 22 * np.sum(np.sin(argument) * np.sqrt(wavelengths) * fade, axis=-1) / np.sqrt(WAVES / 4)
        depth[hit] = distance[hit]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), depth.astype(np.float32)


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """The median wall time of one call in milliseconds, after one call that compiles."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def evaluation_ms(repeats: int, points: int = 2000) -> float:
    """The time of one evaluation of the normal equations with 2000 points on a 512x512 map, milliseconds."""
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 1, (CAMERA.height, CAMERA.width, 1)).astype(np.float32)
    level_map = with_gradients(image)
    pixels = np.sort(rng.choice(CAMERA.width * CAMERA.height, points, replace=False))
    v, u = np.divmod(pixels, CAMERA.width)
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    geometry = np.stack([x, y, rng.uniform(0.05, 0.3, points)]).astype(np.float32)
    H, g, gain_offset, intrinsics = np.zeros((8, 8)), np.zeros(8), np.array([1.0, 0.0]), camera_intrinsics(CAMERA)
    T = np.eye(4)
    T[0, 3] = 0.05
    values = image[v, u]
    return median_ms(
        lambda: linearize(level_map, geometry, values, intrinsics, T, gain_offset, 0.3, 2.0, H, g), repeats
    )


def corridor() -> tuple[tuple[LevelPoints, ...], Image, Array, Settings]:
    """The prepared reference, the query image, the true T_query_ref and the settings."""
    T_query_ref = np.eye(4)
    T_query_ref[2, 3] = -STEP
    image, depth = render(np.eye(4))
    query, _ = render(T_query_ref)
    dso = Dso(points=2000)
    prepared = dso.prepare(Reference("corridor", 0, image, CAMERA, depth=depth))
    if prepared.selected < 1900:
        raise RuntimeError(f"the scene gives {prepared.selected} points, expected about 2000")
    return prepared.levels, query, T_query_ref, dso.settings


def error(T: Array, truth: Array) -> tuple[float, float]:
    """The distance of the camera centres in metres, and the rotation in degrees."""
    delta = T @ invert(truth)
    centre = invert(T)[:3, 3] - invert(truth)[:3, 3]
    return float(np.linalg.norm(centre)), float(np.rad2deg(rotation_angle(delta[:3, :3])))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=25)
    repeats = parser.parse_args().repeats

    points, query, truth, settings = corridor()
    start = np.eye(4)

    def compiled() -> tuple[Array, list[int]]:
        found = align(points, image_pyramid(query, CAMERA), start, settings)
        return found.T_query_ref, [outcome.iterations for outcome in found.outcomes]

    def in_numpy() -> tuple[Array, list[int]]:
        T, _, _, iterations = plain.align(points, plain.image_pyramid(query, CAMERA), start, settings)
        return T, iterations

    (T_compiled, iterations), (T_plain, plain_iterations) = compiled(), in_numpy()
    metres, degrees = error(T_compiled, truth)
    apart_m, apart_deg = error(T_compiled, T_plain)
    if apart_m > 1e-3 or apart_deg > 1e-2:
        raise RuntimeError(f"the two solvers disagree by {apart_m:.2g} m, {apart_deg:.2g} deg")
    dso_ms = median_ms(compiled, repeats)
    numpy_ms = median_ms(in_numpy, max(3, repeats // 5))
    pyramid_ms = median_ms(lambda: image_pyramid(query, CAMERA), repeats)
    evaluation = evaluation_ms(10 * repeats)

    print(f"points carried to the levels  {[len(level) for level in points]}")
    print(f"iterations, coarsest first    compiled {iterations}, numpy {plain_iterations}")
    print(f"error against the truth       {metres:.4f} m, {degrees:.4f} deg")
    print(f"compiled against numpy        {apart_m:.2g} m, {apart_deg:.2g} deg")
    print(f"one alignment                 compiled {dso_ms:.2f} ms (pyramid {pyramid_ms:.2f}), numpy {numpy_ms:.1f} ms")
    print(f"one evaluation, 2000 points   {evaluation:.3f} ms")
    summary = {
        "benchmark": "alignment",
        "dso_ms": round(dso_ms, 3),
        "numpy_ms": round(numpy_ms, 2),
        "ratio": round(numpy_ms / dso_ms, 2),
        "pyramid_ms": round(pyramid_ms, 3),
        "iterations": sum(iterations),
        "numpy_iterations": sum(plain_iterations),
        "evaluation_ms": round(evaluation, 4),
        "error_m": round(metres, 5),
        "error_deg": round(degrees, 5),
        "apart_m": apart_m,
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main()

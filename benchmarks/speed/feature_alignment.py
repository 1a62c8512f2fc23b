"""The time of one alignment on feature maps on one core, compiled and in plain NumPy.

The corridor of ``benchmarks/speed/alignment.py`` carries D = 16 smooth features on its surfaces, on each of four levels
from 512x512 down with waves twice as long. 2000 pixels of the reference have depth. The query stands 1 m ahead and is
turned; its maps carry smooth noise, and a part of them shows something else. Only the tracking is timed: the maps of
both images are given, and the pose is solved for from the identity. Both implementations see the same arrays and must
find the same pose. Also timed are one evaluation, which takes gradients where the map is sampled, and what it would
cost to store the gradients of a query.

    python benchmarks/speed/feature_alignment.py [--repeats N]
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

import cv2
import numpy as np
import plain_feature_alignment as plain
from alignment import CAMERA, STEP, WALLS, error, median_ms

from baselines.alignment.features.kernel import linearize_features, workspace_for
from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.alignment.features.reference import ReferenceFeatures
from baselines.alignment.features.settings import FeatureSettings
from baselines.alignment.features.solver import align_features
from baselines.alignment.shared.levenberg import STATISTICS
from baselines.alignment.shared.pyramid import camera_intrinsics, level_camera, with_gradients
from baselines.alignment.shared.starts import Start, small_rotations
from relocbench.arrays import Array, Floats
from relocbench.geometry import Camera, invert, make_transform, so3_exp
from relocbench.tracking import KeyframePoints

LEVELS = 4
CHANNELS = 16
POINTS = 2000
WAVES = 6
SHORTEST = 0.7
"""m; the shortest wave of the finest level"""
TURN_DEG = (1.0, -2.0, 0.5)
NOISE = 0.3
"""standard deviation of the noise in each channel of the query, whose features have a mean square of 1/2"""
NOISE_GRID = 8
"""pixels"""
HIDDEN = (0.1, 0.5, 0.4, 0.9)
"""top, bottom, left and right of the part of the query that shows something else, as shares of its sides"""


def surface(T_cam_world: Array, camera: Camera) -> tuple[Array, Array]:
    """The world point (H, W, 3) and the depth (H, W) of each pixel of the corridor, metres."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    rays, _ = camera.unproject(np.stack([u, v], axis=-1))
    T_world_cam = invert(T_cam_world)
    directions, origin = rays @ T_world_cam[:3, :3].T, T_world_cam[:3, 3]
    depth = np.full(u.shape, np.inf)
    for axis, coordinate in WALLS:
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (coordinate - origin[axis]) / directions[..., axis]
        depth = np.where((distance > 0) & (distance < depth), distance, depth)
    return origin + directions * depth[..., None], depth


def features(points: Array, level: int) -> Floats:
    """D smooth functions (H, W, D) of world points (H, W, 3), each a sum of seeded waves with mean square 1/2."""
    rng = np.random.default_rng(100 + level)
    lengths = SHORTEST * 2.0**level * np.exp(rng.uniform(0, np.log(4), (CHANNELS, WAVES)))
    directions = rng.normal(size=(CHANNELS, WAVES, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    phases = rng.uniform(0, 2 * np.pi, (CHANNELS, WAVES))
    out = np.zeros((*points.shape[:2], CHANNELS), dtype=np.float32)
    for c in range(CHANNELS):
        for w in range(WAVES):
            argument = points @ (2 * np.pi / lengths[c, w] * directions[c, w]) + phases[c, w]
            out[..., c] += np.sin(argument.astype(np.float32)) / np.float32(np.sqrt(WAVES))
    return out


def pyramid(T_cam_world: Array, changed: bool) -> FeaturePyramid:
    """The features that a camera at this pose sees, each level rendered with its own camera."""
    rng = np.random.default_rng(11)
    maps = []
    for level in range(LEVELS):
        camera = level_camera(CAMERA, level)
        points, _ = surface(T_cam_world, camera)
        if changed:
            rows, columns = slice(*_span(HIDDEN[:2], camera.height)), slice(*_span(HIDDEN[2:], camera.width))
            points[rows, columns] += 50.0  # equally smooth, but unrelated
        values = features(points, level)
        if changed:
            values += NOISE * smooth_noise(values.shape, rng)
        maps.append(values)
    return FeaturePyramid.from_maps(maps, CAMERA)


def smooth_noise(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Noise (H, W, D) of variance 1, interpolated from every eighth pixel, as the errors of a network are smooth."""
    coarse = rng.standard_normal((shape[0] // NOISE_GRID, shape[1] // NOISE_GRID, shape[2]), dtype=np.float32)
    fine = cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(fine / fine.std(), dtype=np.float32)


def _span(shares: tuple[float, ...], side: int) -> tuple[int, int]:
    return round(shares[0] * side), round(shares[1] * side)


def keyframe_points() -> KeyframePoints:
    """2000 random pixels of the image with their exact inverse depth."""
    rng = np.random.default_rng(3)
    uv = np.rint(rng.uniform(4, [CAMERA.width - 5, CAMERA.height - 5], (POINTS, 2)))
    depth = surface(np.eye(4), CAMERA)[1][uv[:, 1].astype(int), uv[:, 0].astype(int)]
    return KeyframePoints(uv, 1.0 / depth, np.zeros(POINTS))


def evaluation_ms(reference: ReferenceFeatures, query: FeaturePyramid, repeats: int) -> float:
    """The time of one evaluation of the normal equations with all points on level 0, milliseconds."""
    points, level = reference.levels[0], query.levels[0]
    K, T, workspace = camera_intrinsics(level.camera), np.eye(4), workspace_for(points.points)
    H, g, statistics = np.zeros((6, 6)), np.zeros(6), np.zeros(STATISTICS)
    given = (
        level.map,
        points.points,
        points.values,
        points.weights,
        K,
        T,
        0.3,
        2.0,
        False,
        workspace,
        H,
        g,
        statistics,
    )
    return median_ms(lambda: linearize_features(*given), repeats)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=25)
    repeats = parser.parse_args().repeats

    truth = make_transform(so3_exp(np.deg2rad(TURN_DEG)), np.array([0.0, 0.0, -STEP]))
    keyframe, query = pyramid(np.eye(4), changed=False), pyramid(truth, changed=True)
    points = keyframe_points()
    reference = ReferenceFeatures.at_points(points, keyframe)
    settings, start = FeatureSettings(), np.eye(4)
    alone = [Start(start)]

    found = align_features(reference, query, alone, settings)
    T_plain, plain_iterations = plain.align(reference, query, start, settings)
    if found.failure:
        raise RuntimeError(found.failure)
    metres, degrees = error(found.T_query_ref, truth)
    apart_m, apart_deg = error(found.T_query_ref, T_plain)
    if apart_m > 1e-3 or apart_deg > 1e-2:
        raise RuntimeError(f"the two solvers disagree by {apart_m:.2g} m, {apart_deg:.2g} deg")
    iterations = [outcome.iterations for outcome in found.outcomes]

    compiled_ms = median_ms(lambda: align_features(reference, query, alone, settings), repeats)
    starts = [Start(start), *(Start(rotation @ start) for rotation in small_rotations())]
    starts_ms = median_ms(lambda: align_features(reference, query, starts, settings), max(3, repeats // 5))
    numpy_ms = median_ms(lambda: plain.align(reference, query, start, settings), max(3, repeats // 5))
    one_ms = evaluation_ms(reference, query, 10 * repeats)
    storing_ms = median_ms(lambda: [with_gradients(level.map) for level in query.levels], max(3, repeats // 5))

    print(f"points of the levels          {[len(level) for level in reference.levels]}")
    print(f"iterations, coarsest first    compiled {iterations}, numpy {plain_iterations}")
    print(f"error against the truth       {metres:.4f} m, {degrees:.4f} deg")
    print(f"compiled against numpy        {apart_m:.2g} m, {apart_deg:.2g} deg")
    print(f"one alignment                 compiled {compiled_ms:.2f} ms, numpy {numpy_ms:.0f} ms")
    print(f"  from {len(starts)} starts              {starts_ms:.1f} ms")
    print(f"one evaluation, D = {CHANNELS}        {one_ms:.3f} ms")
    print(f"storing gradients of a query  {storing_ms:.1f} ms")
    summary = {
        "benchmark": "feature_alignment",
        "alignment_ms": round(compiled_ms, 3),
        "numpy_ms": round(numpy_ms, 1),
        "ratio": round(numpy_ms / compiled_ms, 2),
        "starts_27_ms": round(starts_ms, 2),
        "iterations": sum(iterations),
        "numpy_iterations": sum(plain_iterations),
        "evaluation_ms": round(one_ms, 4),
        "storing_ms": round(storing_ms, 2),
        "error_m": round(metres, 6),
        "error_deg": round(degrees, 6),
        "apart_m": apart_m,
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main()

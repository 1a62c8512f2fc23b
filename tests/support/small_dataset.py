"""A small dataset for tests, rendered once a run: ``from small_dataset import make_small_dataset``.

It lies in ``tests/support``, which pytest puts on the path. The scene is a street corner of three
textured planes (ground, a house on the left, a house ahead), ray-cast exactly, so that images, depth and poses agree.
Traversal ``summer`` is the reference; ``winter`` is darker, of less contrast, noisier, and beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from built_once import built_once

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions, RuleOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.schema import CameraEntry, Condition, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.pairs.different_places import with_different_places
from relocbench.datasets.pairs.posed_frames import PosedFrames
from relocbench.datasets.pairs.writing import write_pair_set
from relocbench.execution import Run
from relocbench.geometry import Camera, invert, make_transform, so3_exp
from relocbench.progress import Silent
from relocbench.tracking import KeyframePoints, Query, Reference

CAMERA = "cam0"
START_NS = 1_600_000_000_000_000_000
STEP_NS = 100_000_000
ACROSS = "summer__winter__cam0"
WITHIN = "summer__summer__cam0"
FROM_POSES = "poses of the traversals"
_PLANES = (
    (np.array([0.0, 0.0, 1.0]), 7.0, (0, 1)),  # ahead
    (np.array([0.0, 1.0, 0.0]), 1.2, (0, 2)),  # ground; y points down
    (np.array([-1.0, 0.0, 0.0]), 2.5, (2, 1)),  # left
)
"""normal n and offset d of n x = d, and the world axes along the plane"""
_TEXELS_PER_METRE = 24.0


def time_of(view: Reference | Query) -> int:
    """The time of a view, for trackers of tests, which use it to know the pairs apart."""
    assert view.timestamp_ns is not None, "a tracker that declares uses_times"
    return view.timestamp_ns


def small_camera(width: int = 96, height: int = 72) -> Camera:
    """A pinhole camera of about 60 degrees."""
    return Camera("pinhole", width, height, 0.87 * width, 0.87 * width, (width - 1) / 2, (height - 1) / 2)


def small_pose(frame: int, *, lateral_m: float = 0.0, yaw_deg: float = 0.0, spacing_m: float = 0.15) -> Array:
    """(4, 4) ``T_world_rig`` of a frame: straight ahead."""
    return make_transform(so3_exp([0.0, np.radians(yaw_deg), 0.0]), [lateral_m, 0.0, spacing_m * frame])


def render(camera: Camera, T_world_cam: Array, seed: int = 0) -> tuple[Image, Floats]:
    """Image (H, W) grey and depth (H, W) metres of the scene."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays, _ = camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float64))
    directions, origin = rays @ T_world_cam[:3, :3].T, T_world_cam[:3, 3]
    depth = np.full(len(rays), np.inf)
    image = np.zeros(len(rays))
    for index, (normal, offset, axes) in enumerate(_PLANES):
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (offset - normal @ origin) / (directions @ normal)
        nearer = (z > 0) & (z < depth)
        at = (origin + z[nearer, None] * directions[nearer])[:, axes] * _TEXELS_PER_METRE
        image[nearer] = _bilinear(_texture(seed + index), at)
        depth[nearer] = z[nearer]
    shape = camera.height, camera.width
    depth[~np.isfinite(depth)] = 0.0
    return np.rint(image).astype(np.uint8).reshape(shape), depth.astype(np.float32).reshape(shape)


def photograph(camera: Camera, T_world_cam: Array) -> Image:
    """Image of a camera that may have distortion: each pixel takes what its ray sees in a wide pinhole image."""
    if not camera.distortion:
        return render(camera, T_world_cam)[0]
    wide = Camera("pinhole", 320, 240, 160.0, 160.0, 159.5, 119.5)
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays, _ = camera.unproject(np.stack([u, v], axis=-1))
    at = wide.project(rays)[0].astype(np.float32)
    return np.asarray(cv2.remap(render(wide, T_world_cam)[0], at[..., 0], at[..., 1], cv2.INTER_LINEAR))


@built_once(Dataset)
def make_small_dataset(
    root: Path,
    *,
    frames: int = 4,
    pairs: int | None = None,
    keyframes_a_query: int = 2,
    seed: int = 0,
    name: str = "small",
    size: tuple[int, int] = (96, 72),
    sparse: bool = False,
    query_depth: bool = True,
    truth: bool = True,
    within: bool = True,
    elsewhere: int = 0,
    rejected: int = 0,
    correspondences: int = 0,
    pose_fault: Array | None = None,
    sigma_translation_m: float | None = 0.01,
    splits: dict[str, list[str]] | None = None,
) -> None:
    """Two traversals of ``frames`` frames and two pair sets, :data:`ACROSS` and :data:`WITHIN`.

    Args:
        root: folder to write to.
        pairs: at most so many accepted pairs a set; default: every query with its keyframe and those before
            (across), every frame with the next ones (within, groups ``step_1`` and ``step_2``).
        keyframes_a_query: keyframes that each query is paired with across, as far as there are as many before it.
        size: width and height of the images.
        sparse: keyframe points instead of dense depth.
        query_depth: whether ``winter`` has depth too.
        truth: False withholds the poses of the pairs, as a challenge does.
        within: False leaves the second set out, so that no set asks the drive of the keyframes.
        elsewhere: so many pairs of different places across, whose cameras are 0.3 m apart or more.
        rejected: so many pairs of the set across are kept as rejected.
        correspondences: ground-truth correspondences a pair; 0 writes no file.
        pose_fault: (4, 4) put in front of every true ``T_query_ref`` across: a deliberately wrong truth.
        splits: name -> pair sets; default: ``test`` has the one across, ``all`` both.
    """
    configuration = {"kind": "small", "frames": frames, "seed": seed, "pairs": pairs, "sparse": sparse}
    writer = DatasetWriter(root, name, configuration, licence="CC0-1.0")
    camera = small_camera(*size)
    places = {"summer": (0.0, 0.0), "winter": (0.12, 2.0)}
    poses = {
        traversal: {
            START_NS + 10**15 * index + STEP_NS * i: small_pose(i, lateral_m=x, yaw_deg=yaw) for i in range(frames)
        }
        for index, (traversal, (x, yaw)) in enumerate(places.items())
    }
    for traversal in places:
        _write_traversal(writer, traversal, camera, poses[traversal], seed, sparse, query_depth)
    across = _across(poses["summer"], poses["winter"], sigma_translation_m, keyframes_a_query)
    if pose_fault is not None:
        across = [_with_pose(p, pose_fault @ p.T_query_ref) for p in across if p.T_query_ref is not None]
    kept_across = across[rejected:][:pairs]
    apart: list[Pair] = []
    if elsewhere:
        summer, winter = (PosedFrames(tuple(p), np.array(list(p.values())), frozenset(p)) for p in poses.values())
        chosen = RuleOptions(elsewhere=elsewhere, elsewhere_distance=0.3, max_distance=0.25, seed=seed)
        apart = with_different_places(kept_across, summer, winter, chosen, root)[len(kept_across) :]
    lost = [
        Pair(*p.key, None, group=p.group, source=p.source, accepted=False, reason="too few points agree")
        for p in across[:rejected]
    ]
    sets: list[tuple[list[Pair], list[Pair], str]] = [(across[rejected:], lost, "winter")]
    if within:
        sets.append((_within(poses["summer"]), [], "summer"))
    for sequence, extra, query in sets:
        kept = [*sequence[:pairs], *(apart if query == "winter" else [])]
        if not truth:
            kept = [_with_pose(p, None) for p in kept]
        options = ImportOptions(correspondences=correspondences, seed=seed)
        write_pair_set(Build(writer, options, Silent(), Run()), "summer", query, CAMERA, [*extra, *kept])
    writer.finish(splits or {"test": [ACROSS], "all": [ACROSS, WITHIN] if within else [ACROSS]})


def _write_traversal(
    writer: DatasetWriter,
    traversal: str,
    camera: Camera,
    poses: dict[int, Array],
    seed: int,
    sparse: bool,
    query_depth: bool,
) -> None:
    winter = traversal == "winter"
    condition = Condition(weather="snow" if winter else "sunny", season=traversal, time_of_day="day")
    entry = CameraEntry.of(camera, depth_sigma=(0.01, 0.0, 0.0))
    file = TraversalFile(
        name=traversal, condition=condition, location="corner", rate_hz=10.0, cameras={CAMERA: entry}, source="rendered"
    )
    writer.traversal(file, poses)
    rng = np.random.default_rng([seed, len(traversal), winter])
    for time, T_world_rig in poses.items():
        image, depth = render(camera, T_world_rig, seed)
        if winter:
            image = np.clip(0.6 * image + 10 + rng.normal(scale=2.0, size=image.shape), 0, 255).astype(np.uint8)
        writer.image(traversal, CAMERA, time, image)
        if winter and not query_depth:
            continue
        if sparse:
            writer.points(traversal, CAMERA, time, _sparse_points(depth, rng))
        else:
            writer.depth(traversal, CAMERA, time, depth)


def _sparse_points(depth: Floats, rng: np.random.Generator, count: int = 400) -> KeyframePoints:
    v, u = np.nonzero(depth > 0)
    rows = np.sort(rng.choice(len(u), min(count, len(u)), replace=False))
    z = depth[v[rows], u[rows]].astype(np.float64)
    return KeyframePoints(np.column_stack([u[rows], v[rows]]).astype(np.float64), 1.0 / z, 0.01 / z**2)


def _across(references: dict[int, Array], queries: dict[int, Array], sigma: float | None, keyframes: int) -> list[Pair]:
    """Every query with the keyframe at its place, then with the one before, and so on."""
    ref_times, query_times = list(references), list(queries)
    out = []
    for back in range(keyframes):
        for i in range(back, len(query_times)):
            ref, query = ref_times[i - back], query_times[i]
            T_query_ref = invert(queries[query]) @ references[ref]
            source = FROM_POSES
            out.append(Pair(ref, query, T_query_ref, sigma_translation_m=sigma, sigma_rotation_deg=0.05, source=source))
    return out


def _within(poses: dict[int, Array]) -> list[Pair]:
    times: Sequence[int] = list(poses)
    return [
        Pair(
            times[i], times[i + k], invert(poses[times[i + k]]) @ poses[times[i]], group=f"step_{k}", source=FROM_POSES
        )
        for k in (1, 2)
        for i in range(len(times) - k)
    ]


def _with_pose(pair: Pair, T_query_ref: Array | None) -> Pair:
    return Pair(
        *pair.key,
        T_query_ref,
        pair.group,
        pair.overlap,
        pair.sigma_translation_m,
        pair.sigma_rotation_deg,
        pair.source,
    )


def _bilinear(texture: Floats, at: Array) -> Array:
    """Values (N,) of a texture that repeats, at (N, 2) row and column."""
    low = np.floor(at).astype(int)
    f = at - low
    (r0, c0), (r1, c1) = (low % len(texture)).T, ((low + 1) % len(texture)).T
    top = texture[r0, c0] * (1 - f[:, 1]) + texture[r0, c1] * f[:, 1]
    bottom = texture[r1, c0] * (1 - f[:, 1]) + texture[r1, c1] * f[:, 1]
    return np.asarray(top * (1 - f[:, 0]) + bottom * f[:, 0], dtype=np.float64)


@cache
def _texture(seed: int, size: int = 256) -> Floats:
    """Blobs of several sizes that repeat without a seam, values 20 to 235."""
    rng = np.random.default_rng(seed)
    total = np.zeros((size, size))
    for sigma, weight in ((1.5, 1.0), (4.0, 1.2), (12.0, 1.0)):
        noise = np.tile(rng.normal(size=(size, size)), (3, 3)).astype(np.float32)
        smooth = cv2.GaussianBlur(noise, (0, 0), sigma)[size : 2 * size, size : 2 * size]
        total += weight * smooth / smooth.std()
    total = np.clip(total / (2.2 * total.std()), -1, 1)
    out: Floats = (127.5 + 107.5 * total).astype(np.float32)
    return out

"""Whether the truth of the procedural town is exact: depth, correspondences and occlusion against independent rays.

Three datasets are built and read like any other: one with all predefined conditions against the first one, with
different parked cars, one with three conditions and moving cars, and one of these conditions with a rig of its own for
each drive (``--views varied``). Every ray is then cast again, independently of the renderer and its ray caster, by the
algorithm of Moeller and Trumbore (1997) in double precision over all triangles whose outline is near the ray. It prints
a table; the last line is JSON.

A ray that passes an edge within ``_SILHOUETTE_PX`` may end on either side of it. Such disagreements are counted like
all others and also reported separately: the result holds for a ray within this distance.

    python benchmarks/truth/synthetic_truth.py [--steps N] [--correspondences N] [--seed N]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array, Floats, Indices, Mask
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import DEPTH_SCALE
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.importers import importer
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS, Factors
from relocbench.datasets.synthetic.conditions.presets import conditions_of
from relocbench.datasets.synthetic.drives.drive import DriveStyle
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.plan import AskedDrives, TraversalPlan, make_plans
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.town.mesh import Mesh
from relocbench.datasets.synthetic.town.moving import moves
from relocbench.datasets.synthetic.town.town import compose
from relocbench.execution import Run, default_workers
from relocbench.geometry import Camera, apply, invert
from relocbench.kernels import njit
from relocbench.progress import Silent

_TILE_PX = 16
_SAME_POINT = 1e-6
"""relative distance within which two points are the same in double precision"""
_SILHOUETTE_PX = 0.01
_GOOD_PX = 0.05
"""the promised accuracy of correspondences"""
_WRITTEN_TO = 1e-8
"""true poses of pairs have nine decimals; the entries of a rotation change by twice as much as the quaternion"""
_BUSY = ("Sunny", "Rain", "Night")
"""conditions with moving cars"""


@njit(cache=True)
def _nearest(corners: Array, rays: Array, first: Indices, columns: int, rows: int, lens: Array) -> Any:
    """Depth (N,) and triangle (N,) of the first hit of rays (x, y, 1) from the origin, which are sorted by tiles.

    ``first[t]`` is the first ray of tile t; ``lens`` is fx, fy, cx, cy. A triangle is intersected with the rays of all
    tiles that its bounding box overlaps, or with all rays if it reaches behind the camera.
    """
    best = np.full(len(rays), np.inf)
    which = np.full(len(rays), -1, dtype=np.int64)
    for i in range(len(corners)):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        if max(a[2], b[2], c[2]) <= 0.0:
            continue
        left, right, top, bottom = 0, columns - 1, 0, rows - 1
        if min(a[2], b[2], c[2]) > 1e-3:
            ua, ub, uc = a[0] / a[2], b[0] / b[2], c[0] / c[2]
            va, vb, vc = a[1] / a[2], b[1] / b[2], c[1] / c[2]
            u0, u1 = lens[0] * min(ua, ub, uc) + lens[2] - 0.1, lens[0] * max(ua, ub, uc) + lens[2] + 0.1
            v0, v1 = lens[1] * min(va, vb, vc) + lens[3] - 0.1, lens[1] * max(va, vb, vc) + lens[3] + 0.1
            if u1 < -1.0 or v1 < -1.0 or u0 > _TILE_PX * columns or v0 > _TILE_PX * rows:
                continue
            left, right = max(0, int(u0 // _TILE_PX)), min(columns - 1, int(u1 // _TILE_PX))
            top, bottom = max(0, int(v0 // _TILE_PX)), min(rows - 1, int(v1 // _TILE_PX))
        e1x, e1y, e1z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        e2x, e2y, e2z = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        qx = -a[1] * e1z + a[2] * e1y  # s x e1, s = -a
        qy = -a[2] * e1x + a[0] * e1z
        qz = -a[0] * e1y + a[1] * e1x
        distance = e2x * qx + e2y * qy + e2z * qz
        for row in range(top, bottom + 1):
            for n in range(first[row * columns + left], first[row * columns + right + 1]):
                x, y = rays[n, 0], rays[n, 1]
                px, py, pz = y * e2z - e2y, e2x - x * e2z, x * e2y - y * e2x
                determinant = e1x * px + e1y * py + e1z * pz
                if determinant == 0.0:
                    continue
                t = distance / determinant
                if not 1e-3 < t < best[n]:
                    continue
                beta = -(a[0] * px + a[1] * py + a[2] * pz) / determinant
                gamma = (x * qx + y * qy + qz) / determinant
                if beta >= -1e-12 and gamma >= -1e-12 and beta + gamma <= 1.0 + 1e-12:
                    best[n], which[n] = t, i
    return best, which


@dataclass(frozen=True, eq=False)
class Eye:
    """A camera at one time, and all triangles around it at that time."""

    camera: Camera
    T_world_cam: Array
    mesh: Mesh

    @cached_property
    def _corners(self) -> Array:
        """The corners of all triangles (T, 3, 3) in the camera's frame."""
        inside = (self.mesh.vertices.astype(np.float64) - self.T_world_cam[:3, 3]) @ self.T_world_cam[:3, :3]
        return np.asarray(inside[self.mesh.triangles])

    def cast(self, pixels: Array) -> tuple[Array, Indices]:
        """The depth along z (N,) of pixels (N, 2), inf without a hit, and the triangle (N,), -1 without a hit."""
        if len(pixels) == 0:
            return np.empty(0), np.empty(0, dtype=np.int64)
        c = self.camera
        columns, rows = c.width // _TILE_PX + 1, c.height // _TILE_PX + 1
        column = np.clip(pixels[:, 0] // _TILE_PX, 0, columns - 1).astype(np.int64)
        tile = np.clip(pixels[:, 1] // _TILE_PX, 0, rows - 1).astype(np.int64) * columns + column
        order = np.argsort(tile, kind="stable")
        first = np.searchsorted(tile[order], np.arange(columns * rows + 1))
        rays = np.column_stack([(pixels[order, 0] - c.cx) / c.fx, (pixels[order, 1] - c.cy) / c.fy])
        lens = np.array([c.fx, c.fy, c.cx, c.cy])
        found, triangle = _nearest(self._corners, rays, first, columns, rows, lens)
        depth, which = np.empty(len(pixels)), np.empty(len(pixels), dtype=np.int64)
        depth[order], which[order] = found, triangle
        return depth, which

    def lift(self, pixels: Array, depth: Array) -> Array:
        """The world points (N, 3) of pixels."""
        c = self.camera
        x, y = (pixels[:, 0] - c.cx) / c.fx * depth, (pixels[:, 1] - c.cy) / c.fy * depth
        return apply(self.T_world_cam, np.column_stack([x, y, depth]))

    def project(self, points: Array) -> tuple[Array, Array]:
        """The pixels (N, 2) and depths (N,) of world points (N, 3)."""
        c = self.camera
        p = (points - self.T_world_cam[:3, 3]) @ self.T_world_cam[:3, :3]
        return np.column_stack([c.fx * p[:, 0] / p[:, 2] + c.cx, c.fy * p[:, 1] / p[:, 2] + c.cy]), p[:, 2]


class Scenes:
    """The scene of a rendered dataset, reconstructed from the dataset's own description."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        made = dataset.file.made_by["options"]
        self._extent, self._seed = float(made["extent"]), int(made["seed"])
        factors = {k: Factors.model_validate(f) for k, f in dataset.file.made_by["factors"].items()}
        named = conditions_of(tuple(made["conditions"]), {}, None, 2, made["traffic"], people=made.get("people"))
        if {k: c.factors for k, c in named.items()} != factors:
            raise RuntimeError("the dataset was made with other conditions than this version has")
        style = DriveStyle(made["speed"], made["lateral"], made["heading"])
        asked = AskedDrives((made["split"],), named, made["traversals"], self._seed)
        plans = make_plans(asked, made["steps"], style, extent_m=self._extent, reporter=Silent())
        self._plans: dict[str, TraversalPlan] = {plan.name: plan for plan in plans}

    def eye(self, traversal: str, camera: str, timestamp_ns: int) -> Eye:
        """The camera of a frame from the dataset, with the triangles from the town's plan."""
        plan = self._plans[traversal]
        cars = plan.moving[plan.times.index(timestamp_ns)]
        spec = DistrictSpec(self._seed, plan.split, self._extent)
        mesh = compose(scenes.district(spec), plan.condition.factors, cars)
        opened = self._dataset.traversal(traversal)
        return Eye(opened.camera(camera), opened.T_world_cam(camera, timestamp_ns), mesh)


@dataclass
class Tally:
    """The measurements, ray by ray."""

    depth_units: list[Array] = field(default_factory=list)
    """|stored - cast| in 1/256 m; inf where only one of them has a surface"""
    depth_at_edge: list[Mask] = field(default_factory=list)
    forward_px: list[Array] = field(default_factory=list)
    forward_at_edge: list[Mask] = field(default_factory=list)
    backward_px: list[Array] = field(default_factory=list)
    backward_at_edge: list[Mask] = field(default_factory=list)
    flag_wrong: list[Mask] = field(default_factory=list)
    flag_at_edge: list[Mask] = field(default_factory=list)
    visible: int = 0
    hidden: int = 0
    hidden_by_car: int = 0
    """by a moving one"""
    on_moving_cars: int = 0
    """correspondences whose reference pixel shows a moving car; there must be none"""

    def add(self, name: str, values: Array | Mask, at_edge: Mask) -> None:
        getattr(self, name).append(values)
        getattr(self, {"flag_wrong": "flag_at_edge"}.get(name, name.split("_")[0] + "_at_edge")).append(at_edge)


def beside(pixels: Array) -> Iterator[Array]:
    """The pixels (N, 2) moved by ``_SILHOUETTE_PX`` in eight directions."""
    for angle in np.arange(8) * np.pi / 4:
        yield pixels + _SILHOUETTE_PX * np.array([np.cos(angle), np.sin(angle)])


def check_depth(tally: Tally, eye: Eye, stored: Floats, count: int, rng: np.random.Generator) -> None:
    """Compare the stored depth at random pixels."""
    rows = rng.choice(stored.size, min(count, stored.size), replace=False)
    pixels = np.column_stack([rows % stored.shape[1], rows // stored.shape[1]]).astype(np.float64)
    known = stored.ravel()[rows].astype(np.float64)

    def units(at: Array, of: Array) -> Array:
        depth = eye.cast(at)[0]
        # Depth beyond the range of sixteen bits is stored as none.
        depth[depth * DEPTH_SCALE > 65535.5] = np.inf
        return np.where(np.isinf(depth) & (of == 0), 0.0, np.where(of == 0, np.inf, np.abs(depth - of) * DEPTH_SCALE))

    error = units(pixels, known)
    wrong = np.flatnonzero(error > 1.0)
    edge = np.zeros(len(error), dtype=np.bool_)
    for moved in beside(pixels[wrong]):
        # Half a unit of rounding, and the change of a slanted surface within the tolerance.
        edge[wrong] |= units(moved, known[wrong]) <= 1.0 + 0.02 * known[wrong]
    tally.add("depth_units", error, edge)


def check_pair(tally: Tally, dataset: Dataset, pair_set: PairSet, pair: Pair, ref: Eye, query: Eye) -> None:
    """Compare stored correspondences forward, backward, and in their visibility."""
    rows = read_correspondences(dataset.layout.correspondence_file(pair_set.name), pair.key)
    T_query_ref = invert(query.T_world_cam) @ ref.T_world_cam
    if pair.T_query_ref is None or np.abs(pair.T_query_ref - T_query_ref).max() > _WRITTEN_TO:
        raise RuntimeError(f"{pair_set.name} {pair.key}: the pair's pose is not that of its traversals")
    depth, triangle = ref.cast(rows.uv_ref)
    tally.on_moving_cars += int(np.sum(moves(ref.mesh.semantic[triangle])))
    points = ref.lift(rows.uv_ref, depth)
    expected, z = query.project(points)

    error = np.linalg.norm(expected - rows.uv_query, axis=1)
    error[~np.isfinite(error)] = np.inf
    wrong = np.flatnonzero(error >= _GOOD_PX)
    edge = np.zeros(len(error), dtype=np.bool_)
    for moved in beside(rows.uv_ref[wrong]):
        again, _ = query.project(ref.lift(moved, ref.cast(moved)[0]))
        edge[wrong] |= np.linalg.norm(again - rows.uv_query[wrong], axis=1) < 0.5
    tally.add("forward_px", error, edge)

    def seen(pixels: Array, at: Array) -> Mask:
        found, which = query.cast(pixels)
        return np.asarray((np.abs(found - at) <= _SAME_POINT * at) & ~moves(query.mesh.semantic[which]))

    visible = seen(expected, z)
    differs = np.flatnonzero(visible != rows.visible)
    edge = np.zeros(len(visible), dtype=np.bool_)
    for moved in beside(rows.uv_ref[differs]):
        shifted, at = query.project(ref.lift(moved, ref.cast(moved)[0]))
        usable = np.isfinite(shifted).all(axis=1)
        edge[differs[usable]] |= seen(shifted[usable], at[usable]) == rows.visible[differs[usable]]
    tally.add("flag_wrong", visible != rows.visible, edge)
    tally.visible += int(visible.sum())
    tally.hidden += int((~visible).sum())
    tally.hidden_by_car += int(np.sum(moves(query.mesh.semantic[query.cast(expected[~visible])[1]])))

    pixels, start = rows.uv_query[rows.visible], rows.uv_ref[rows.visible]

    def returned(at: Array, to: Array) -> Array:
        back, _ = ref.project(query.lift(at, query.cast(at)[0]))
        error = np.linalg.norm(back - to, axis=1)
        return np.where(np.isfinite(error), error, np.inf)

    error = returned(pixels, start)
    wrong = np.flatnonzero(error >= _GOOD_PX)
    edge = np.zeros(len(error), dtype=np.bool_)
    for moved in beside(pixels[wrong]):
        edge[wrong] |= returned(moved, start[wrong]) < 0.5
    tally.add("backward_px", error, edge)


def check(dataset: Dataset, pairs_a_set: int, depth_pixels: int, seed: int) -> Tally:
    """Check random pairs of every set, and random pixels of both depth images."""
    tally, scenes = Tally(), Scenes(dataset)
    for pair_set in dataset.pair_sets():
        print(f"{dataset.name}: {pair_set.name}", file=sys.stderr)
        rng = np.random.default_rng([seed, *pair_set.name.encode()])
        chosen = rng.choice(len(pair_set.pairs), min(pairs_a_set, len(pair_set.pairs)), replace=False)
        for pair in (pair_set.pairs[i] for i in sorted(chosen)):
            sides = zip((pair_set.reference, pair_set.query), pair_set.cameras, pair.key, strict=True)
            eyes = [scenes.eye(*side) for side in sides]
            check_pair(tally, dataset, pair_set, pair, *eyes)
            stored = dataset.traversal(pair_set.query).depth(pair_set.query_camera, pair.query_timestamp_ns)
            assert stored is not None
            check_depth(tally, eyes[1], stored, depth_pixels, rng)
    return tally


def report(tally: Tally) -> dict[str, Any]:
    """The statistics; shares are in percent."""
    depth, forward, backward = map(np.concatenate, (tally.depth_units, tally.forward_px, tally.backward_px))
    flags = np.concatenate(tally.flag_wrong)
    parts = (tally.depth_at_edge, tally.forward_at_edge, tally.backward_at_edge, tally.flag_at_edge)
    edges: list[Mask] = [np.concatenate(part) for part in parts]

    def of(values: Array, limit: float, edge: Mask) -> dict[str, Any]:
        bad = values > limit
        smooth = values[~(bad & edge)]
        return {
            "rays": len(values),
            "median": float(np.median(values)),
            "p99": float(np.percentile(values, 99)),
            "within_percent": round(100 * float(np.mean(~bad)), 4),
            "outside_at_silhouettes": int(np.sum(bad & edge)),
            "outside_elsewhere": int(np.sum(bad & ~edge)),
            "max_without_silhouettes": float(np.max(smooth, initial=0.0)),
        }

    return {
        "depth_in_256ths_m": of(depth, 1.0, edges[0]),
        "forward_px": of(forward, _GOOD_PX, edges[1]),
        "backward_px": of(backward, _GOOD_PX, edges[2]),
        "occlusion": {
            "flags": len(flags),
            "visible": tally.visible,
            "hidden": tally.hidden,
            "hidden_by_moving_cars": tally.hidden_by_car,
            "agree_percent": round(100 * float(np.mean(~flags)), 4),
            "wrong_at_silhouettes": int(np.sum(flags & edges[3])),
            "wrong_elsewhere": int(np.sum(flags & ~edges[3])),
        },
        "reference_pixels_on_moving_cars": tally.on_moving_cars,
    }


def build(out: Path, conditions: Sequence[str], **options: object) -> Dataset:
    town = importer("synthetic")
    chosen = town.Options.model_validate({"conditions": tuple(conditions), **options})
    return town.build([], chosen, out, Silent(), Run(default_workers()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=6, help="frames of each traversal")
    parser.add_argument("--pairs", type=int, default=4, help="random pairs of each pair set")
    parser.add_argument("--correspondences", type=int, default=2000, help="correspondences of each pair")
    parser.add_argument("--depth-pixels", type=int, default=5000, help="pixels of each image")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    common = {"steps": given.steps, "correspondences": given.correspondences, "seed": given.seed, "heading": 8.0}
    found = {}
    with tempfile.TemporaryDirectory(prefix="relocbench-truth-") as scratch:
        for name, conditions, more in (
            ("still", tuple(dict.fromkeys(("Sunny", *CONDITIONS))), {}),
            ("traffic", _BUSY, {"traffic": 3.0}),
            ("views", _BUSY, {"views": "varied", "traversals": 2}),
        ):
            print(f"building {name}: {', '.join(conditions)}", file=sys.stderr)
            dataset = build(Path(scratch) / name, conditions, name=name, **common, **more)
            found[name] = report(check(dataset, given.pairs, given.depth_pixels, given.seed))
    for name, figures in found.items():
        for what, values in figures.items():
            told = values if isinstance(values, int) else ", ".join(f"{k} {v:.6g}" for k, v in values.items())
            print(f"{name:8} {what:32} {told}")
    print(json.dumps({"benchmark": "synthetic_truth", **found}))


if __name__ == "__main__":
    main()

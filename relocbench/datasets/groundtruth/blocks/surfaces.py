"""The surfaces that points lie on: planes fitted to their neighbours, and which of these are ground.

The normal at a point is the direction in which its neighbours spread least: the eigenvector of the smallest eigenvalue
of their covariance. A plane fits if that spread is no larger than noise and the other two are much larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Bytes, Floats, Indices, Mask
from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.voxels.voxels import Grid, cell_of, make_grid, pack
from relocbench.kernels import njit


@dataclass(frozen=True)
class SurfaceOptions:
    """Options that decide when neighbours lie in a plane, and which planes are ground."""

    radius_m: float = 0.35
    """radius of the neighbourhood of a point"""
    wide_radius_m: float = 0.8
    """radius that is used instead where the first one holds too few points, or only points on a line"""
    fewest: int = 8
    """least number of neighbours, the point itself included, to fit a plane to"""
    plane_m: float = 0.04
    """largest standard deviation of the distances of neighbours from their plane"""
    flatness: float = 0.3
    """largest ratio of thickness to breadth, both as standard deviations"""
    line: float = 0.2
    """ratio of breadth to length below which neighbours lie on a line, which determines no plane"""
    ground_m: float = 0.25
    """largest difference in height between ground and wheels, under the car"""
    ground_slope: float = 0.06
    """growth of that difference for each metre away from the path"""
    ground_tilt_deg: float = 20.0
    """largest angle between the ground and the floor of the car"""


def fit_normals(points: Array, wanted: Indices, options: SurfaceOptions) -> Floats:
    """Normals (M, 3) of some points, of either sign; 0 where no plane fits.

    Args:
        points: (N, 3) of several blocks, in one frame.
        wanted: (M,) rows of the points whose normals are wanted.
    """
    normals = np.zeros((len(wanted), 3), dtype=np.float32)
    undecided = np.arange(len(wanted))
    for radius in (options.radius_m, options.wide_radius_m):
        grid = make_grid(points, radius)
        fitted, decided = _fit(
            points, wanted[undecided], grid, radius, options.fewest, options.plane_m, options.flatness, options.line
        )
        normals[undecided] = fitted
        undecided = undecided[~decided]
    return normals


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(
    points: Array, wanted: Indices, grid: Grid, radius: float, fewest: int, plane_m: float, flatness: float, line: float
) -> tuple[Floats, Mask]:
    """Normals (M, 3), and (M,) whether the neighbours determine a plane at all."""
    normals = np.zeros((len(wanted), 3), dtype=np.float32)
    decided = np.zeros(len(wanted), dtype=np.bool_)
    size = grid.size_m
    for w in range(len(wanted)):
        i = wanted[w]
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        cx, cy, cz = int(np.floor(px / size)), int(np.floor(py / size)), int(np.floor(pz / size))
        n = 0
        sx = sy = sz = sxx = sxy = sxz = syy = syz = szz = 0.0
        for ix in range(cx - 1, cx + 2):
            for iy in range(cy - 1, cy + 2):
                for iz in range(cz - 1, cz + 2):
                    cell = cell_of(pack(ix, iy, iz), grid.keys, grid.cells)
                    if cell < 0:
                        continue
                    for k in range(grid.starts[cell], grid.starts[cell + 1]):
                        j = grid.order[k]
                        dx, dy, dz = points[j, 0] - px, points[j, 1] - py, points[j, 2] - pz
                        if dx * dx + dy * dy + dz * dz > radius * radius:
                            continue
                        n += 1
                        sx += dx
                        sy += dy
                        sz += dz
                        sxx += dx * dx
                        sxy += dx * dy
                        sxz += dx * dz
                        syy += dy * dy
                        syz += dy * dz
                        szz += dz * dz
        if n < fewest:
            continue
        mx, my, mz = sx / n, sy / n, sz / n
        cov = (sxx / n - mx * mx, sxy / n - mx * my, sxz / n - mx * mz,
               syy / n - my * my, syz / n - my * mz, szz / n - mz * mz)  # fmt: skip
        low, middle, high, nx, ny, nz = smallest_eigenvector(cov)
        if middle < line * line * high:
            continue
        decided[w] = True
        if low <= plane_m * plane_m and low <= flatness * flatness * middle:
            normals[w, 0], normals[w, 1], normals[w, 2] = nx, ny, nz
    return normals, decided


@njit(cache=True, nogil=True, error_model="numpy")
def smallest_eigenvector(
    cov: tuple[float, float, float, float, float, float],
) -> tuple[float, float, float, float, float, float]:
    """Eigenvalues of a symmetric matrix (xx, xy, xz, yy, yz, zz), ascending, and the unit eigenvector of the smallest.

    Jacobi's method: rotations in one coordinate plane after another make the matrix diagonal.
    """
    a = np.empty((3, 3))
    a[0, 0], a[0, 1], a[0, 2], a[1, 1], a[1, 2], a[2, 2] = cov
    a[1, 0], a[2, 0], a[2, 1] = a[0, 1], a[0, 2], a[1, 2]
    v = np.eye(3)
    for _ in range(20):
        off = a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2
        if off <= 1e-30 * (a[0, 0] ** 2 + a[1, 1] ** 2 + a[2, 2] ** 2):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if a[p, q] == 0.0:
                    continue
                theta = (a[q, q] - a[p, p]) / (2 * a[p, q])
                t = (1.0 if theta >= 0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1))
                c = 1 / np.sqrt(t * t + 1)
                s = t * c
                for k in range(3):
                    kp, kq = a[k, p], a[k, q]
                    a[k, p], a[k, q] = c * kp - s * kq, s * kp + c * kq
                for k in range(3):
                    pk, qk = a[p, k], a[q, k]
                    a[p, k], a[q, k] = c * pk - s * qk, s * pk + c * qk
                for k in range(3):
                    kp, kq = v[k, p], v[k, q]
                    v[k, p], v[k, q] = c * kp - s * kq, s * kp + c * kq
    low = 0
    for k in range(1, 3):
        if a[k, k] < a[low, low]:
            low = k
    one, two = a[(low + 1) % 3, (low + 1) % 3], a[(low + 2) % 3, (low + 2) % 3]
    return max(a[low, low], 0.0), min(one, two), max(one, two), v[0, low], v[1, low], v[2, low]


def towards(normals: Floats, points: Floats, origins: Floats) -> Floats:
    """Normals (N, 3), flipped where necessary to point towards the sensor."""
    away = np.einsum("ni,ni->n", normals, origins - points) < 0
    return np.where(away[:, None], -normals, normals).astype(np.float32)


def classify(
    points: Floats,
    normals: Floats,
    T_node_path: Array,
    wheel_height_m: float,
    options: SurfaceOptions,
) -> Bytes:
    """:class:`Surface` (N,) of points (N, 3) with normals (N, 3), which are 0 where no plane fits.

    Args:
        T_node_path: (P, 4, 4) poses of the rig along the drive, in the frame of the points.
        wheel_height_m: height of the road in the rig's frame; if it is nan, nothing is classified as ground.
    """
    plane = np.any(normals != 0, axis=1)
    out = np.where(plane, Surface.STRUCTURE, Surface.ROUGH).astype(np.uint8)
    if not np.isfinite(wheel_height_m) or not len(points):
        return out
    height, level, away = _over_path(points.astype(np.float64), normals.astype(np.float64), T_node_path)
    near = np.abs(height - wheel_height_m) <= options.ground_m + options.ground_slope * away
    flat = np.abs(level) >= np.cos(np.radians(options.ground_tilt_deg))
    out[plane & near & flat] = Surface.GROUND
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _over_path(points: Array, normals: Array, poses: Array) -> tuple[Array, Array, Array]:
    """Relative to the pose that is nearest in plan, for each point: height, cosine of the normal with up, distance."""
    n = len(points)
    height, level, away = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        best, nearest = 0, np.inf
        for k in range(len(poses)):
            dx, dy = points[i, 0] - poses[k, 0, 3], points[i, 1] - poses[k, 1, 3]
            if dx * dx + dy * dy < nearest:
                best, nearest = k, dx * dx + dy * dy
        up = poses[best, :3, 2]
        height[i] = 0.0
        level[i] = 0.0
        for axis in range(3):
            height[i] += up[axis] * (points[i, axis] - poses[best, axis, 3])
            level[i] += up[axis] * normals[i, axis]
        away[i] = np.sqrt(nearest)
    return height, level, away


def level_under(points: Array, beside_m: float = 6.0, bin_m: float = 0.04, fewest: int = 200) -> float:
    """Height of the road in the rig's frame: where most points (N, 3) near the rig lie; nan if there are too few."""
    near = np.hypot(points[:, 0], points[:, 1]) < beside_m
    z = points[near, 2]
    z = z[z < 0.5]  # overhead wires and bridges are not road
    if len(z) < fewest:
        return float("nan")
    bins = np.floor(z / bin_m).astype(np.int64)
    counts = np.bincount(bins - bins.min())
    # Counts of two neighbouring bins, since the road may lie on the border between them.
    pairs = counts + np.append(counts[1:], 0)
    low = (int(np.argmax(pairs)) + int(bins.min())) * bin_m
    return float(np.median(z[(z >= low - bin_m) & (z < low + 3 * bin_m)]))

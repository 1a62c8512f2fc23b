"""Drawing of surfels into a depth image, with hidden surfaces removed.

Two passes, as in Zwicker et al., Surface splatting (2001): the first finds the front surfel at each pixel, the second
takes the mean of all surfels that agree with it. A surface that was scanned twice, with a small offset, becomes one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Floats
from relocbench.datasets.groundtruth.depth.surfels import SECTORS
from relocbench.geometry import Camera
from relocbench.kernels import njit

OCCLUSION_STEP = 4
"""occlusion is computed at every fourth pixel"""
_NEAR_M = 0.3
_GRAZING = 0.03
"""least product of a surfel's normal with a pixel's ray (z = 1); at more grazing incidence its depth is ignored"""
_DIAGONAL = np.sqrt(0.5)
_THICK = 2.0
"""half thickness of a surfel in standard deviations of its own noise, so that rays along its plane meet it too"""


@dataclass(frozen=True, eq=False)
class View:
    """Surfels in the camera's frame, with their noise."""

    points: Floats
    """(N, 3) in the camera's frame"""
    normals: Floats
    """(N, 3) unit vectors; 0 for surfels without a plane, which are drawn facing the camera"""
    axes: Floats
    """(N, 3) unit vectors along the surface, in the first of the eight directions"""
    reach: Floats
    """(N, 8) metres that each surfel covers in each direction; 0 if it is not drawn"""
    occluding_reach: Floats
    """(N, 8) metres within which it hides what is behind it"""
    sigma: Floats
    """(N,) independent noise along the normal, metres"""
    drift: Floats
    """(N,) error along the normal that it shares with its neighbours, metres"""


@dataclass(frozen=True, eq=False)
class Drawn:
    """The drawn surfels; all arrays are (H, W)."""

    depth: Floats
    """metres along z, 0 where there is no surfel"""
    sigma: Floats
    """standard deviation of the depth, metres"""
    centre: Floats
    """centrality of the pixel in its surfels (1 in the middle of one, 0 at its rim), summed over those at the front"""
    behind: Floats
    """largest centrality in a surfel behind the front"""
    rough: Floats
    """in [0, 1]: share of the front that is of surfels without a plane"""


def draw(view: View, camera: Camera, max_depth: float, sigmas: float, slack_m: float) -> Drawn:
    """Draw surfels into a pinhole camera.

    Args:
        sigmas, slack_m: surfels are one surface if their depths differ by at most so many standard deviations plus
            ``slack_m``.
    """
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    front = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    spread = np.zeros_like(front)
    surfels = (view.points, view.normals, view.axes, view.reach)
    noise = (view.sigma, view.drift)
    _front(*surfels, *noise, lens, max_depth, front, spread)
    return Drawn(*_mean(*surfels, *noise, lens, max_depth, front, spread, sigmas, slack_m))


def draw_occlusion(view: View, camera: Camera, max_depth: float) -> Floats:
    """(ceil(H / 4), ceil(W / 4)) depth beyond which everything is hidden; inf where nothing hides.

    Element (i, j) is for row 4 i + 1.5 and column 4 j + 1.5 of the image.
    """
    shape = -(-camera.height // OCCLUSION_STEP), -(-camera.width // OCCLUSION_STEP)
    middle = (OCCLUSION_STEP - 1) / 2
    lens = np.array([camera.fx, camera.fy, camera.cx - middle, camera.cy - middle]) / OCCLUSION_STEP
    occlusion = np.full(shape, np.inf, dtype=np.float32)
    exact = np.zeros(len(view.points), np.float32)
    surfels = (view.points, view.normals, view.axes, view.occluding_reach)
    _front(*surfels, exact, exact, lens, max_depth, occlusion, np.zeros_like(occlusion))
    return occlusion


@njit(cache=True, inline="always")
def _window(x, y, z, ex, ey, ez, lens, height, width):  # type: ignore[no-untyped-def]
    """The pixels [u0, u1) x [v0, v1) that a box around (x, y, z), with half sizes (ex, ey, ez), covers."""
    near, far = max(z - ez, _NEAR_M), max(z + ez, _NEAR_M)
    left, right = x - ex, x + ex
    top, bottom = y - ey, y + ey
    u0 = lens[0] * (left / near if left < 0 else left / far) + lens[2]
    u1 = lens[0] * (right / far if right < 0 else right / near) + lens[2]
    v0 = lens[1] * (top / near if top < 0 else top / far) + lens[3]
    v1 = lens[1] * (bottom / far if bottom < 0 else bottom / near) + lens[3]
    return (
        max(np.int64(np.ceil(max(u0, -1.0))), 0), min(np.int64(np.floor(min(u1, width))) + 1, width),
        max(np.int64(np.ceil(max(v0, -1.0))), 0), min(np.int64(np.floor(min(v1, height))) + 1, height),
    )  # fmt: skip


@njit(cache=True, inline="always")
def _rim(a, b, reach):  # type: ignore[no-untyped-def]
    """Position of (a, b) between the middle (0) and the rim (1) of a surfel, a polygon with corners at its reach."""
    across, along = abs(a), abs(b)
    if across >= along:
        straight = 0 if a >= 0 else 4
        minor, major = along, across
    else:
        straight = 2 if b >= 0 else 6
        minor, major = across, along
    right, left = (1, 3) if b >= 0 else (7, 5)
    slanted = right if a >= 0 else left
    return (major - minor) / reach[straight] + minor / (_DIAGONAL * reach[slanted])


@njit(cache=True, inline="always")
def _met(px, py, pz, dx, dy, slope, nx, ny, nz, ax, ay, az, bx, by, bz, thick, reach):  # type: ignore[no-untyped-def]
    """:func:`_rim` at the point of the ray (dx, dy, 1), within the surfel's thickness, that is nearest to its middle.

    (px, py, pz) is the vector from the middle to the point where the ray meets the plane.
    """
    # The component of the ray's direction along the plane.
    tx, ty, tz = dx - slope * nx, dy - slope * ny, 1 - slope * nz
    square = tx * tx + ty * ty + tz * tz
    most = thick / abs(slope)
    shift = -(px * tx + py * ty + pz * tz) / max(square, np.float32(1e-6))
    shift = min(max(shift, -most), most)
    px, py, pz = px + shift * tx, py + shift * ty, pz + shift * tz
    return _rim(px * ax + py * ay + pz * az, px * bx + py * by + pz * bz, reach)


@njit(cache=True, inline="always")
def _frame(i, points, normals, axes, reach, thick, max_depth):  # type: ignore[no-untyped-def]
    """Whether surfel i is drawn; its normal, its two axes, and the half sizes of its bounding box."""
    z = points[i, 2]
    largest = np.float32(0.0)
    for k in range(SECTORS):
        largest = max(largest, reach[i, k])
    nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
    ax, ay, az = axes[i, 0], axes[i, 1], axes[i, 2]
    if nx == 0 and ny == 0 and nz == 0:
        nz = np.float32(-1.0)
        ax, ay, az = np.float32(1.0), np.float32(0.0), np.float32(0.0)
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    drawn = largest > 0 and z - largest < max_depth and z > _NEAR_M
    ex = largest * np.sqrt(max(np.float32(0), 1 - nx * nx)) + thick * abs(nx)
    ey = largest * np.sqrt(max(np.float32(0), 1 - ny * ny)) + thick * abs(ny)
    ez = largest * np.sqrt(max(np.float32(0), 1 - nz * nz)) + thick * abs(nz)
    return drawn, nx, ny, nz, ax, ay, az, bx, by, bz, ex, ey, ez


@njit(cache=True, nogil=True, error_model="numpy")
def _front(points, normals, axes, reach, sigma, drift, lens, max_depth, front, spread):  # type: ignore[no-untyped-def]
    """Find the smallest depth at each pixel, and the standard deviation of that surfel's depth there."""
    height, width = front.shape
    for i in range(len(points)):
        thick = np.float32(_THICK) * sigma[i]
        drawn, nx, ny, nz, ax, ay, az, bx, by, bz, ex, ey, ez = _frame(
            i, points, normals, axes, reach, thick, max_depth
        )
        if not drawn:
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        u0, u1, v0, v1 = _window(x, y, z, ex, ey, ez, lens, height, width)
        offset = nx * x + ny * y + nz * z
        for v in range(v0, v1):
            dy = np.float32((v - lens[3]) / lens[1])
            for u in range(u0, u1):
                dx = np.float32((u - lens[2]) / lens[0])
                slope = nx * dx + ny * dy + nz
                if abs(slope) < _GRAZING:
                    continue
                depth = offset / slope
                if depth >= front[v, u] or depth < _NEAR_M or depth > max_depth:
                    continue
                px, py, pz = depth * dx - x, depth * dy - y, depth - z
                inside = _met(px, py, pz, dx, dy, slope, nx, ny, nz, ax, ay, az, bx, by, bz, thick, reach[i])
                if inside < 1:
                    front[v, u] = depth
                    spread[v, u] = np.sqrt(sigma[i] * sigma[i] + drift[i] * drift[i]) / abs(slope)


@njit(cache=True, nogil=True, error_model="numpy")
def _mean(  # type: ignore[no-untyped-def]
    points, normals, axes, reach, sigma, drift, lens, max_depth, front, spread, sigmas, slack_m
):
    """Weighted mean depth of the surfels at the front, its sigma, and the other arrays of :class:`Drawn`."""
    height, width = front.shape
    total = np.zeros((height, width), np.float32)
    mean = np.zeros((height, width), np.float32)
    noise = np.zeros((height, width), np.float32)
    shared = np.zeros((height, width), np.float32)
    centre = np.zeros((height, width), np.float32)
    behind = np.zeros((height, width), np.float32)
    rough = np.zeros((height, width), np.float32)
    flat = (normals[:, 0] != 0) | (normals[:, 1] != 0) | (normals[:, 2] != 0)
    for i in range(len(points)):
        thick = np.float32(_THICK) * sigma[i]
        drawn, nx, ny, nz, ax, ay, az, bx, by, bz, ex, ey, ez = _frame(
            i, points, normals, axes, reach, thick, max_depth
        )
        if not drawn:
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        u0, u1, v0, v1 = _window(x, y, z, ex, ey, ez, lens, height, width)
        offset = nx * x + ny * y + nz * z
        own = sigma[i] * sigma[i] + drift[i] * drift[i]
        for v in range(v0, v1):
            dy = np.float32((v - lens[3]) / lens[1])
            for u in range(u0, u1):
                dx = np.float32((u - lens[2]) / lens[0])
                slope = nx * dx + ny * dy + nz
                if abs(slope) < _GRAZING:
                    continue
                depth = offset / slope
                if depth < _NEAR_M or depth > max_depth:
                    continue
                px, py, pz = depth * dx - x, depth * dy - y, depth - z
                near = 1 - _met(px, py, pz, dx, dy, slope, nx, ny, nz, ax, ay, az, bx, by, bz, thick, reach[i])
                if near <= 0:
                    continue
                variance = own / (slope * slope)
                ahead = depth - front[v, u]
                if ahead > slack_m + sigmas * np.sqrt(variance + spread[v, u] * spread[v, u]):
                    behind[v, u] = max(behind[v, u], near)
                    continue
                weight = (near + np.float32(0.01)) / variance
                total[v, u] += weight
                # The sum is of offsets from the front, so that single precision suffices.
                mean[v, u] += weight * ahead
                noise[v, u] += weight * weight * (sigma[i] * sigma[i]) / (slope * slope)
                shared[v, u] += weight * abs(drift[i] / slope)
                centre[v, u] += near
                if not flat[i]:
                    rough[v, u] += weight
    for v in range(height):
        for u in range(width):
            if total[v, u] > 0:
                mean[v, u] = front[v, u] + mean[v, u] / total[v, u]
                rough[v, u] /= total[v, u]
                own = noise[v, u] / (total[v, u] * total[v, u])
                common = shared[v, u] / total[v, u]
                noise[v, u] = np.sqrt(own + common * common)
    return mean, noise, centre, behind, rough

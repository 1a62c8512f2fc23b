"""Cameras: pinhole, radial-tangential (Brown-Conrady) and equidistant fisheye (Kannala-Brandt).

Axes: x right, y down, z forward. The centre of the top-left pixel is (0, 0). All functions are vectorised.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Floats, Mask

CameraModel = Literal["pinhole", "radtan", "equidistant"]

_COEFFICIENTS: dict[str, tuple[int, ...]] = {"pinhole": (0,), "radtan": (4, 5, 8), "equidistant": (4,)}
_NEWTON_STEPS = 50
_CONVERGED = 1e-12  # in normalised coordinates: far below any pixel


@dataclass(frozen=True)
class Camera:
    """Model, intrinsics and size of one camera.

    ``distortion`` holds, for ``radtan``, OpenCV's ``k1 k2 p1 p2 [k3 [k4 k5 k6]]``; for ``equidistant``
    ``k1 k2 k3 k4`` of ``theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)``.

    Raises:
        ValueError: unknown model, impossible intrinsics or the wrong number of coefficients.
    """

    model: CameraModel
    width: int
    """pixels"""
    height: int
    """pixels"""
    fx: float
    """pixels"""
    fy: float
    """pixels"""
    cx: float
    """pixels"""
    cy: float
    """pixels"""
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.model not in get_args(CameraModel):
            raise ValueError(f"camera model '{self.model}' is none of {', '.join(get_args(CameraModel))}")
        if self.width < 1 or self.height < 1:
            raise ValueError(f"camera size {self.width}x{self.height} is not positive")
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.all(np.isfinite(values)) or self.fx <= 0 or self.fy <= 0:
            raise ValueError(f"camera intrinsics {values} must be finite, focal lengths positive")
        if len(self.distortion) not in _COEFFICIENTS[self.model]:
            wanted = " or ".join(map(str, _COEFFICIENTS[self.model]))
            raise ValueError(
                f"camera model '{self.model}' takes {wanted} distortion coefficients, got {len(self.distortion)}"
            )

    @property
    def matrix(self) -> Array:
        """K, (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.width, self.height

    def pinhole(self) -> Camera:
        """The undistorted camera with the same K and size."""
        return replace(self, model="pinhole", distortion=())

    def scaled(self, factor: float) -> Camera:
        """The camera of the image resized by ``factor`` (pixel centres at integers: c' = (c + 0.5) s - 0.5)."""
        return replace(
            self,
            width=round(self.width * factor),
            height=round(self.height * factor),
            fx=self.fx * factor,
            fy=self.fy * factor,
            cx=(self.cx + 0.5) * factor - 0.5,
            cy=(self.cy + 0.5) * factor - 0.5,
        )

    def contains(self, pixels: ArrayLike, border: float = 0.0) -> Mask:
        """Whether pixels (..., 2) lie on the image, ``border`` pixels inside its outermost pixel centres."""
        p = np.asarray(pixels, dtype=np.float64)
        u, v = p[..., 0], p[..., 1]
        inside = (u >= border) & (u <= self.width - 1 - border)
        return inside & (v >= border) & (v <= self.height - 1 - border)

    @np.errstate(all="ignore")  # points that are not finite are reported as not valid
    def project(self, points: ArrayLike) -> tuple[Array, Mask]:
        """Pixels of points in the camera frame.

        Args:
            points: (..., 3) metres.

        Returns:
            pixels (..., 2), NaN where not valid, and valid (...): in front of the camera, and inside the part of
            the image where the distortion can be inverted. Not clipped to the image: see :meth:`contains`.
        """
        p = np.asarray(points, dtype=np.float64)
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        if self.model == "equidistant":
            radius = np.hypot(x, y)
            theta = np.arctan2(radius, z)
            theta_d, _ = self._theta_d(theta)
            valid = (theta < self._fold) & ((radius > 0) | (z > 0))
            scale = np.where(radius > 1e-12, theta_d / np.where(radius > 1e-12, radius, 1.0), 1.0)
            xd, yd = x * scale, y * scale
        else:
            valid = z > 1e-9
            safe = np.where(valid, z, 1.0)
            xd, yd = x / safe, y / safe
            if self.model == "radtan":
                xu, yu = xd, yd
                xd, yd, jacobian = self._radtan(xu, yu)
                determinant = jacobian[0] * jacobian[3] - jacobian[1] * jacobian[2]
                valid = valid & (determinant > 0) & (np.hypot(xu, yu) < self._fold)
        pixels = np.stack([self.fx * xd + self.cx, self.fy * yd + self.cy], axis=-1)
        valid = valid & np.all(np.isfinite(pixels), axis=-1)
        return np.where(valid[..., None], pixels, np.nan), valid

    def unproject(self, pixels: ArrayLike) -> tuple[Array, Mask]:
        """Rays of pixels.

        Args:
            pixels: (..., 2).

        Returns:
            rays (..., 3) and valid (...). Rays have z = 1 for pinhole and radtan, so that ``ray * depth`` is the
            point; for equidistant they have unit length where they look 90 degrees or more off the axis, and
            z = 1 elsewhere. Rays are NaN where the inversion of the distortion did not converge.
        """
        p = np.asarray(pixels, dtype=np.float64)
        xd, yd = (p[..., 0] - self.cx) / self.fx, (p[..., 1] - self.cy) / self.fy
        if self.model == "pinhole":
            rays = np.stack([xd, yd, np.ones_like(xd)], axis=-1)
            return rays, np.all(np.isfinite(rays), axis=-1)
        if self.model == "radtan":
            x, y, valid = self._invert_radtan(xd, yd)
            rays = np.stack([x, y, np.ones_like(x)], axis=-1)
        else:
            theta_d = np.hypot(xd, yd)
            theta, valid = _invert_increasing(self._theta_d, theta_d, self._fold)
            direction = np.where(theta_d > 1e-12, np.sin(theta) / np.where(theta_d > 1e-12, theta_d, 1.0), 1.0)
            rays = np.stack([xd * direction, yd * direction, np.cos(theta)], axis=-1)
            forward = rays[..., 2] > 1e-6
            rays = rays / np.where(forward, rays[..., 2], 1.0)[..., None]
        return np.where(valid[..., None], rays, np.nan), valid

    def undistort(self, pixels: ArrayLike, target: Camera | None = None) -> tuple[Array, Mask]:
        """Pixels (..., 2) of this camera as pixels of ``target`` (default: :meth:`pinhole`), and valid (...)."""
        rays, valid = self.unproject(pixels)
        moved, seen = (target or self.pinhole()).project(rays)
        return moved, valid & seen

    def undistortion_map(self, target: Camera | None = None) -> tuple[Floats, Floats]:
        """For each pixel of ``target`` (default: :meth:`pinhole`) the pixel of this camera that it shows.

        Returns:
            u, v: each (target.height, target.width) float32, as ``cv2.remap`` takes them; -1e4 where this camera
            sees nothing.
        """
        target = target or self.pinhole()
        grid = np.stack(np.meshgrid(np.arange(target.width), np.arange(target.height)), axis=-1)
        pixels, valid = target.undistort(grid, self)
        pixels = np.where(valid[..., None], pixels, -1e4).astype(np.float32)
        return np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as written to YAML."""
        return {**asdict(self), "distortion": list(self.distortion)}

    def _radtan(self, x: Array, y: Array) -> tuple[Array, Array, tuple[Array, Array, Array, Array]]:
        """Distorted normalised coordinates and their Jacobian, row by row (Brown-Conrady, rational model)."""
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, 0.0, 0.0, 0.0, 0.0)[:8]
        r2 = x * x + y * y
        top = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bottom = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = top / bottom
        d_top = k1 + r2 * (2 * k2 + r2 * 3 * k3)
        d_bottom = k4 + r2 * (2 * k5 + r2 * 3 * k6)
        d_radial = 2 * (d_top - radial * d_bottom) / bottom  # d radial / d r2, times 2
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        cross = x * y * d_radial + 2 * p1 * x + 2 * p2 * y
        return (
            xd,
            yd,
            (
                radial + x * x * d_radial + 2 * p1 * y + 6 * p2 * x,
                cross,
                cross,
                radial + y * y * d_radial + 6 * p1 * y + 2 * p2 * x,
            ),
        )

    def _radial(self, r: Array) -> tuple[Array, Array]:
        """Distorted radius and its derivative, without the tangential distortion."""
        zero = np.zeros_like(r)
        k1, k2, _, _, *higher = self.distortion
        untilted = replace(self, distortion=(k1, k2, 0.0, 0.0, *higher))
        value, _, jacobian = untilted._radtan(r, zero)
        return value, jacobian[0]

    @cached_property
    def _fold(self) -> float:
        """Radius r (radtan) or angle theta (equidistant) up to which the distorted radius increases.

        Beyond it the image folds back and two rays would share a pixel. It is the first positive root of the
        derivative, a polynomial in the square of r or theta, or the first pole of the rational model.
        """
        if self.model == "equidistant":
            k1, k2, k3, k4 = self.distortion
            return min(_first_root([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0]), np.pi)
        k1, k2, _, _, k3, k4, k5, k6 = (*self.distortion, 0.0, 0.0, 0.0, 0.0)[:8]
        top, bottom = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
        growth = top * bottom + np.poly1d([2.0, 0.0]) * (top.deriv() * bottom - top * bottom.deriv())
        return min(_first_root(growth.coeffs), _first_root(bottom.coeffs))

    def _invert_radtan(self, xd: Array, yd: Array) -> tuple[Array, Array, Mask]:
        """Undistort by Newton's method in two dimensions, starting from the inverse of the radial part alone."""
        rd = np.hypot(xd, yd)
        r, _ = _invert_increasing(self._radial, rd, self._fold)
        with np.errstate(all="ignore"):
            outward = np.where(rd > 0, r / np.where(rd > 0, rd, 1.0), 1.0)
            # The full model may reach slightly past the fold of the radial part: start there at the distorted point.
            outward = np.where(np.isfinite(outward), outward, 1.0)
            x, y = xd * outward, yd * outward
            for _ in range(_NEWTON_STEPS):
                px, py, (a, b, c, d) = self._radtan(x, y)
                ex, ey = px - xd, py - yd
                determinant = a * d - b * c
                dx, dy = (d * ex - b * ey) / determinant, (a * ey - c * ex) / determinant
                x, y = x - dx, y - dy
                if not np.any(np.abs(dx) + np.abs(dy) > _CONVERGED):
                    break
            px, py, (a, b, c, d) = self._radtan(x, y)
            valid = (np.hypot(px - xd, py - yd) < 1e-9) & (a * d - b * c > 0) & (np.hypot(x, y) < self._fold)
        return x, y, valid

    def _theta_d(self, theta: Array) -> tuple[Array, Array]:
        """Kannala-Brandt distorted angle and its derivative."""
        k1, k2, k3, k4 = self.distortion
        t2 = theta * theta
        value = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        return value, slope


def _first_root(coefficients: ArrayLike) -> float:
    """Square root of a polynomial's smallest positive real root, infinite if it has none; highest power first."""
    roots = np.roots(np.asarray(coefficients))
    real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)]
    return float(np.sqrt(real.min(initial=np.inf)))


def _invert_increasing(
    function: Callable[[Array], tuple[Array, Array]], target: Array, end: float
) -> tuple[Array, Mask]:
    """Solve ``function(x) = target`` for x in [0, end), where the function increases from 0.

    Newton's method within a bracket: alone it would overshoot next to a fold, where the function is nearly flat.

    Args:
        function: returns value and derivative.
        target: (...) at least 0; NaN gives an invalid result.
        end: end of the interval, may be infinite.

    Returns:
        x (...), NaN where not valid, and valid (...).
    """
    with np.errstate(all="ignore"):
        low, high = np.zeros_like(target), np.full_like(target, end)
        x = np.minimum(target, 0.5 * end)
        for _ in range(_NEWTON_STEPS):
            value, slope = function(x)
            low, high = np.where(value <= target, x, low), np.where(value >= target, x, high)
            middle = np.where(np.isfinite(high), 0.5 * (low + high), 2.0 * low + 1.0)
            newton = x - (value - target) / slope
            following = np.where((newton >= low) & (newton <= high), newton, middle)
            moved, x = np.abs(following - x), following
            if not np.any(moved > _CONVERGED):
                break
        value, _ = function(x)
        valid = (np.abs(value - target) < 1e-9) & (x < end)
    return np.where(valid, x, np.nan), valid


def camera_from_dict(values: dict[str, Any]) -> Camera:
    """The camera of :meth:`Camera.to_dict`. Raises ValueError or TypeError on impossible values."""
    distortion = tuple(float(v) for v in values.get("distortion") or ())
    numbers = {name: float(values[name]) for name in ("fx", "fy", "cx", "cy")}
    return Camera(
        model=values["model"],
        width=int(values["width"]),
        height=int(values["height"]),
        distortion=distortion,
        **numbers,
    )

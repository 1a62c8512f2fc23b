"""The metric scale of what is only known up to scale, from a keyframe with depth.

Two images alone do not determine how long the translation between them is. A keyframe with depth does: of two kinds of
answers, :func:`translation_scale` finds the length of a translation from matches, and :func:`depth_scale` the size of
a scene from depth that a model estimated itself. Both bear less than half of wrong values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Mask
from relocbench.geometry.camera import Camera
from relocbench.geometry.robust import robust_sigma, weighted_median

FEWEST = 5
"""values from which a scale is estimated"""
_TUKEY = 4.685
"""95 % as efficient as least squares where all errors are normal (Holland and Welsch 1977)"""
_SIGMA_PER_MEDIAN_2D = 1 / np.sqrt(2 * np.log(2))
"""the median length of a vector of two normal errors is 1.177 of their standard deviation (Rayleigh)"""
_SIGMA_PER_MEDIAN_ERROR = np.sqrt(np.pi / 2)
"""standard error of a median, times sqrt(N), over the standard deviation of normal values"""
_ROUNDING = 1e-10
"""radians, or relative: less than this is rounding and no error of a measurement"""
_STEPS = 50
_NEGATIVE_SIGMAS = 3.0


class ScaleError(ValueError):
    """The metric scale cannot be found, as the message says in one line."""


@dataclass(frozen=True, eq=False)
class Scale:
    """A metric scale and what is known of it."""

    value: float
    """metres for one unit of the model, at least 0"""
    sigma: float
    """standard error of ``value``"""
    inliers: Mask
    """(N,) values that agree with it"""
    spread: float
    """robust standard deviation of a value: a match in pixels, a depth as a share of itself"""


def translation_scale(
    points: ArrayLike,
    pixels: ArrayLike,
    camera: Camera,
    rotation: ArrayLike,
    direction: ArrayLike,
    *,
    max_sigma_m: float = 1.0,
) -> Scale:
    """The metric length of a translation of which only the direction is known, from matches.

    A point X of the keyframe is seen by the query along the unit ray y, so that y is parallel to R X + s t. Then

        y x (R X + s t) = 0,    that is    s a = b    with    a = y x t,  b = -(y x R X),

    three equations of rank two in s. One match alone gives s = a.b / a.a. The vector b - s a is by how much the ray
    misses the point, in metres; divided by the point's distance d = |R X + s t| it is the sine of an angle, whose noise
    is about that of a pixel for all matches. The estimate starts from the median of a.b / a.a with weights |a| / d,
    which are inverse to the noise of each, and minimises Tukey's biweight of |b - s a| / d by reweighted least squares

        s = sum(w a.b / d^2) / sum(w a.a / d^2).

    Points in the direction of the translation (a = 0), and points that are far away, do not constrain s.

    Args:
        points: (N, 3) metres in the keyframe's camera; matches whose point is not finite have no depth.
        pixels: (N, 2) where the query sees them; matches whose pixel is not finite do not count.
        camera: the query's camera.
        rotation: (3, 3) of ``T_query_ref``.
        direction: (3,) the translation of ``T_query_ref`` up to scale, of any length but 0.
        max_sigma_m: largest standard error of the translation along its direction, metres.

    Returns:
        the scale: ``value * direction`` is the translation in metres.

    Raises:
        ScaleError: fewer than :data:`FEWEST` matches have depth, or fewer agree; there is no parallax, so that the
            length is known worse than ``max_sigma_m``; or the points say that the translation is the other way round.
        ValueError: arrays of other shapes, or a direction of length 0.
    """
    X, uv = np.asarray(points, dtype=np.float64), np.asarray(pixels, dtype=np.float64)
    R, t = np.asarray(rotation, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    if X.shape != (len(X), 3) or uv.shape != (len(X), 2) or R.shape != (3, 3) or t.shape != (3,):
        raise ValueError(
            f"expected points (N, 3), pixels (N, 2), rotation (3, 3) and direction (3,), "
            f"got {X.shape}, {uv.shape}, {R.shape}, {t.shape}"
        )
    unit = float(np.linalg.norm(t))
    if not (np.isfinite(R).all() and np.isfinite(unit) and unit > 0):
        raise ValueError("expected a finite rotation and a finite direction whose length is not 0")
    rays, seen = camera.unproject(uv)
    usable = seen & np.isfinite(X).all(axis=1) & (np.linalg.norm(X, axis=1) > 0)
    _require(int(usable.sum()), "matches have depth")
    y = rays[usable] / np.linalg.norm(rays[usable], axis=1, keepdims=True)
    p = X[usable] @ R.T
    a, b = np.cross(y, t / unit), -np.cross(y, p)
    s, sigma_s, agree = _ray_scale(y, p, t / unit, a, b)
    _require(int(agree.sum()), "matches agree with one length of the translation")
    if not sigma_s <= max_sigma_m:
        raise ScaleError(
            f"no parallax: the length of the translation is known to {sigma_s:.3g} m only, worse than "
            f"{max_sigma_m:g} m; the points are too far away, too few or too close to the direction of the translation"
        )
    if s < -_NEGATIVE_SIGMAS * sigma_s:
        raise ScaleError(f"the points say that the translation is the other way round ({s:.3g} m along its direction)")
    inliers = np.zeros(len(X), dtype=bool)
    inliers[usable] = agree
    s = max(s, 0.0)
    seen_at, _ = camera.project(p + s * t / unit)
    spread = _SIGMA_PER_MEDIAN_2D * np.nanmedian(np.linalg.norm(seen_at - uv[usable], axis=1))
    return Scale(s / unit, sigma_s / unit, inliers, float(spread))


def depth_scale(depth: ArrayLike, model_depth: ArrayLike, relative_sigma: ArrayLike | None = None) -> Scale:
    """The metric scale of depth that a model estimated up to scale: the median of the ratio of both.

    With metric depth z and the model's depth m at the same pixels of the keyframe, z = s m. Errors of depth grow with
    depth, so that log z - log m = log s + e with errors e that are alike; the median of the left side is log s. The
    standard error is that of a median, 1.253 sigma / sqrt(N) for normal errors (Kendall and Stuart, The Advanced Theory
    of Statistics).

    Args:
        depth: (N,) metres; 0 or not finite where it is unknown.
        model_depth: (N,) in the units of the model, of the same pixels; 0 or not finite where it is unknown.
        relative_sigma: (N,) standard deviation of the metric depth as a share of it, by which values are weighted; for
            keyframe points it is ``sigma / inverse_depth``. Without it all weigh the same.

    Returns:
        the scale: ``value`` times a depth, a point or a translation of the model is in metres.

    Raises:
        ScaleError: fewer than :data:`FEWEST` pixels have both depths.
        ValueError: arrays of different shapes, or a sigma that is not positive.
    """
    z, m = np.asarray(depth, dtype=np.float64), np.asarray(model_depth, dtype=np.float64)
    weights = np.ones(z.shape) if relative_sigma is None else 1.0 / _positive(relative_sigma)
    if z.ndim != 1 or not z.shape == m.shape == weights.shape:
        raise ValueError(f"expected arrays (N,) of one length, got {z.shape}, {m.shape}, {weights.shape}")
    usable = np.isfinite(z) & np.isfinite(m)
    usable[usable] = (z[usable] > 0) & (m[usable] > 0)
    _require(int(usable.sum()), "pixels have both depths")
    logs, weights = np.log(z[usable]) - np.log(m[usable]), weights[usable]
    middle = weighted_median(logs, weights)
    spread = max(robust_sigma(logs - middle, weights), _ROUNDING)
    effective = weights.sum() ** 2 / np.square(weights).sum()
    inliers = np.zeros(len(z), dtype=bool)
    inliers[usable] = np.abs(logs - middle) <= _TUKEY * spread
    value = float(np.exp(middle))
    return Scale(value, float(value * _SIGMA_PER_MEDIAN_ERROR * spread / np.sqrt(effective)), inliers, spread)


def _ray_scale(y: Array, p: Array, t: Array, a: Array, b: Array) -> tuple[float, float, Mask]:
    """The scale along unit t (3,), its standard error, and the matches (N,) that agree."""
    ab, aa = np.sum(a * b, axis=1), np.sum(a * a, axis=1)
    constrains = aa > _ROUNDING**2
    if not constrains.any():
        raise ScaleError("no parallax: all matches lie in the direction of the translation")
    s = weighted_median(ab[constrains] / aa[constrains], (np.sqrt(aa) / np.linalg.norm(p, axis=1))[constrains])
    noise = _noise(s, p, t, a, b)
    for _ in range(2):  # the noise is measured at the median, and once more at what it leads to
        for _ in range(_STEPS):
            weights = _weights(s, noise, y, p, t, a, b)
            information = float(weights @ aa)
            if information <= 0:
                break
            before, s = s, float(weights @ ab) / information
            if abs(s - before) <= _ROUNDING * (1 + abs(s)):
                break
        noise = _noise(s, p, t, a, b)
    agree = _weights(s, noise, y, p, t, a, b) > 0
    d = np.linalg.norm(p + s * t, axis=1)
    information = float(np.sum(aa[agree] / d[agree] ** 2)) / noise**2
    return s, 1 / np.sqrt(information) if information > 0 else np.inf, agree


def _misses(s: float, p: Array, t: Array, a: Array, b: Array) -> tuple[Array, Array]:
    """Sine of the angle (N,) by which each ray misses its point, and the point's distance (N,) in metres."""
    d = np.maximum(np.linalg.norm(p + s * t, axis=1), _ROUNDING)
    return np.linalg.norm(b - s * a, axis=1) / d, d


def _noise(s: float, p: Array, t: Array, a: Array, b: Array) -> float:
    missed, _ = _misses(s, p, t, a, b)
    return max(float(np.median(missed)) * float(_SIGMA_PER_MEDIAN_2D), _ROUNDING)


def _weights(s: float, noise: float, y: Array, p: Array, t: Array, a: Array, b: Array) -> Array:
    """Weights (N,) of the squares of b - s a: Tukey's biweight over the distance squared, 0 behind the camera."""
    missed, d = _misses(s, p, t, a, b)
    inside = np.maximum(1 - (missed / (_TUKEY * noise)) ** 2, 0.0)
    in_front = np.sum(y * (p + s * t), axis=1) > 0
    return np.where(in_front, inside**2, 0.0) / d**2


def _positive(values: ArrayLike) -> Array:
    found = np.asarray(values, dtype=np.float64)
    if not (np.isfinite(found).all() and (found > 0).all()):
        raise ValueError("expected finite relative_sigma above 0")
    return found


def _require(count: int, what: str) -> None:
    if count < FEWEST:
        raise ScaleError(f"{count} {what}, at least {FEWEST} are needed for a metric scale")

"""The white noise of odometry that was computed from scans: each scan's pose has an error of its own.

It is not a random walk, since the next scan is registered to the same map, and it is in the pose of each image, however
near the image is to a node. A car's motion is smooth from scan to scan, and white noise is not. Differences of high
order, ``(1 - B)^n`` of the poses with B the one before, leave of an oscillation of frequency f at a rate of scans r
only ``(2 sin(pi f / r))^n``: the eighth leave a sixth of a body that sways at 1.3 Hz, at ten scans a second, and
enlarge white noise by a hundred.

Differences need as many scans in a row, evenly spaced. Where too few of a drive's scans are, since it is short or every
eighth scan is missing, those of a lower order tell the noise, with more of the sway: too much is better than none.
"""

from __future__ import annotations

from math import comb

import numpy as np

from relocbench.arrays import Array, Mask
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import invert, robust_sigma, se3_log

_FEWEST = 20
"""with fewer differences nothing is estimated"""
_ORDERS = range(8, 2, -1)
"""of the differences of poses, the best first"""


def white_noise(odometry: Trajectory) -> Array:
    """(6,) standard deviations of the twist ``(rho, phi)``, metres and radians: x forward, y to the left, z up.

    The body heaves by more than it sways, and what differences leave of it counts as noise. Scans show the ground at
    least as well as what stands beside it, so that the noise in height is taken to be the smallest of the three.
    """
    if len(odometry.times_ns) < _FEWEST:
        return np.zeros(6)
    steps = se3_log(invert(odometry.T_odom_rig[:-1]) @ odometry.T_odom_rig[1:])
    gaps = np.diff(odometry.times_ns)
    usual = np.abs(gaps - np.median(gaps)) < 0.1 * np.median(gaps)
    for order in _ORDERS:
        even: Mask = np.asarray(np.lib.stride_tricks.sliding_window_view(usual, order).all(axis=1))
        if np.count_nonzero(even) >= _FEWEST:
            return _sigmas(steps, order, even)
    return np.zeros(6)


def _sigmas(steps: Array, order: int, even: Mask) -> Array:
    """(6,) by the differences of an order of the poses between which there are (N, 6) steps, where they are even."""
    # A step is a difference of two poses; the others are taken of the steps.
    differences = np.diff(steps, n=order - 1, axis=0)[even]
    # The variance of an n-th difference of white noise of unit variance is the sum of squared binomial coefficients.
    enlarged = np.sqrt(comb(2 * order, order))
    sigmas: Array = np.array([robust_sigma(axis, np.ones(len(axis))) for axis in differences.T]) / enlarged
    sigmas[2] = sigmas[:3].min()
    return sigmas

"""The white noise of odometry that was computed from scans: each scan's pose has an error of its own.

It is not a random walk, since the next scan is registered to the same map, and it is in the pose of each image, however
near the image is to a node. Cars do not jerk from scan to scan, so that third differences of their position show it.
"""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import invert, robust_sigma

_FEWEST = 20
"""with fewer poses nothing is estimated"""
_THIRD_DIFFERENCE = np.sqrt(20.0)
"""standard deviation of the third difference of white noise of unit variance: 1 + 9 + 9 + 1 = 20"""


def white_noise_m(odometry: Trajectory) -> Array:
    """(3,) standard deviations of the position along, across and in height, metres.

    The car's body heaves on its springs, which third differences cannot tell from noise; the noise in height is taken
    to be the smaller of the other two.
    """
    if len(odometry.times_ns) < _FEWEST:
        return np.zeros(3)
    steps = (invert(odometry.T_odom_rig[:-1]) @ odometry.T_odom_rig[1:])[:, :3, 3]
    gaps = np.diff(odometry.times_ns)
    usual = np.abs(gaps - np.median(gaps)) < 0.1 * np.median(gaps)
    even = usual[:-2] & usual[1:-1] & usual[2:]
    third = (steps[:-2] - 2 * steps[1:-1] + steps[2:])[even]
    if len(third) < _FEWEST:
        return np.zeros(3)
    along, across = (robust_sigma(third[:, axis], np.ones(len(third))) / _THIRD_DIFFERENCE for axis in (0, 1))
    return np.array([along, across, min(along, across)])

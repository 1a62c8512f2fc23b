"""The uncertainty of a pair's pose, from that of the two poses that it was made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from relocbench.datasets.core.pairfile import Pair


def sigma_of_pair(pair: Pair, sigma_m: float | None, sigma_deg: float | None) -> Pair:
    """A pair with its sigmas, the errors of its two poses being independent.

    With ``c = R_world_ref^T (c_query - c_ref)``, first-order propagation gives the covariance
    ``2 sigma_m^2 I + sigma_rad^2 (|c|^2 I - c c^T)``, whose mean variance on an axis is
    ``2 sigma_m^2 + 2/3 |c|^2 sigma_rad^2``; the relative rotation has ``sqrt(2)`` times the sigma of each.

    Args:
        sigma_m: of each pose's position along each axis, metres; None if unknown.
        sigma_deg: of each pose's rotation about each axis, degrees; None if unknown, and not counted.
    """
    translation = None
    if sigma_m is not None:
        lever = float(np.radians(sigma_deg or 0.0)) * (pair.distance_m or 0.0)
        translation = float(np.sqrt(2 * sigma_m**2 + 2 / 3 * lever**2))
    rotation = None if sigma_deg is None else float(np.sqrt(2) * sigma_deg)
    return replace(pair, sigma_translation_m=translation, sigma_rotation_deg=rotation)

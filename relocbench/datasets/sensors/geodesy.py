"""Positions on the earth: WGS 84 (NIMA TR8350.2) in degrees, and Cartesian coordinates (ECEF)."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array

SEMI_MAJOR_M = 6378137.0
_FLATTENING = 1 / 298.257223563
ECCENTRICITY2 = _FLATTENING * (2 - _FLATTENING)
"""square of the eccentricity"""


def prime_vertical_radius(latitude_rad: Array) -> Array:
    """Radius of curvature in metres across the meridian, (...)."""
    return np.asarray(SEMI_MAJOR_M / np.sqrt(1 - ECCENTRICITY2 * np.sin(latitude_rad) ** 2))


def ecef_from_geodetic(positions: Array) -> Array:
    """ECEF (..., 3) in metres of latitudes and longitudes in degrees and heights in metres (..., 3)."""
    latitude, longitude, height = np.radians(positions[..., 0]), np.radians(positions[..., 1]), positions[..., 2]
    normal = prime_vertical_radius(latitude)
    across = (normal + height) * np.cos(latitude)
    z = (normal * (1 - ECCENTRICITY2) + height) * np.sin(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), z], axis=-1)


def R_enu_ecef(latitude_deg: float, longitude_deg: float) -> Array:
    """(3, 3) from ECEF to the directions east, north and up at a place."""
    phi, lam = np.radians([latitude_deg, longitude_deg])
    return np.array(
        [
            [-np.sin(lam), np.cos(lam), 0.0],
            [-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)],
            [np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)],
        ]
    )

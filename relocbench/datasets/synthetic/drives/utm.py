"""Geographic coordinates (WGS 84) of UTM coordinates.

Uses Krüger's series to the third order in the flattening, which is accurate to a millimetre within a zone (Karney,
Transverse Mercator with an accuracy of a few nanometers, J. Geodesy 2011).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array

_EQUATORIAL_M = 6378137.0
_FLATTENING = 1 / 298.257223563
_SCALE = 0.9996
_FALSE_EASTING_M = 500_000.0


def latitude_longitude(northing_m: ArrayLike, easting_m: ArrayLike, zone: int) -> tuple[Array, Array]:
    """Latitude and longitude (...) in degrees of places (...) in the northern half of a UTM zone."""
    n = _FLATTENING / (2 - _FLATTENING)
    rectifying = _EQUATORIAL_M / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    beta = (n / 2 - 2 / 3 * n**2 + 37 / 96 * n**3, n**2 / 48 + n**3 / 15, 17 / 480 * n**3)
    delta = (2 * n - 2 / 3 * n**2 - 2 * n**3, 7 / 3 * n**2 - 8 / 5 * n**3, 56 / 15 * n**3)
    xi = np.asarray(northing_m, dtype=np.float64) / (_SCALE * rectifying)
    eta = (np.asarray(easting_m, dtype=np.float64) - _FALSE_EASTING_M) / (_SCALE * rectifying)
    xi_sphere = xi - sum(b * np.sin(2 * j * xi) * np.cosh(2 * j * eta) for j, b in enumerate(beta, start=1))
    eta_sphere = eta - sum(b * np.cos(2 * j * xi) * np.sinh(2 * j * eta) for j, b in enumerate(beta, start=1))
    conformal = np.arcsin(np.sin(xi_sphere) / np.cosh(eta_sphere))
    latitude = conformal + sum(d * np.sin(2 * j * conformal) for j, d in enumerate(delta, start=1))
    longitude = np.arctan2(np.sinh(eta_sphere), np.cos(xi_sphere))
    return np.degrees(latitude), np.degrees(longitude) + 6.0 * zone - 183.0

"""Echoes of a lidar's beams: reflectance of dry, wet and snowy surfaces, and attenuation by the air."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array, Bytes
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.town.mesh import Material

DARK = 0.1
"""reflectance of the dark surface for which data sheets state a range"""
_DIFFUSE_WHEN_WET = 0.4
"""share of the diffuse reflection that remains under a film of water, at normal incidence"""
_SNOW_REFLECTANCE = 0.8
_CLUTTER_PER_MM_H = (1e-4, 4e-3)
"""share of beams that falling rain and snow reflect, per mm/h"""

_REFLECTANCE_OF = {
    Material.ASPHALT: 0.15, Material.COBBLES: 0.20, Material.PAVEMENT: 0.25, Material.KERB: 0.30,
    Material.LANE_MARKING: 0.60, Material.GRASS: 0.50, Material.SOIL: 0.25, Material.BRICK: 0.35,
    Material.PLASTER: 0.55, Material.STONE: 0.40, Material.CONCRETE: 0.40, Material.ROOF_TILES: 0.30,
    Material.ROOF_FLAT: 0.15, Material.WINDOW: 0.06, Material.SHOP_WINDOW: 0.06, Material.DOOR: 0.30,
    Material.SHOP_SIGN: 0.40, Material.WOOD: 0.40, Material.METAL: 0.40, Material.BARK: 0.35, Material.LEAF: 0.50,
    Material.HEDGE: 0.50, Material.CAR_PAINT: 0.40, Material.CAR_GLASS: 0.06, Material.RUBBER: 0.05,
    Material.TRAFFIC_SIGN: 5.0, Material.LAMP: 0.30, Material.PLASTIC: 0.30,
    Material.PAINTED_WALL: 0.50, Material.FRESH_ASPHALT: 0.10, Material.SIGNAL_RED: 1.0, Material.SIGNAL_WHITE: 1.5,
    Material.CONTAINER: 0.40, Material.SHEET: 0.45, Material.CLOTH: 0.40, Material.TROUSERS: 0.30,
    Material.SKIN: 0.55, Material.HAIR: 0.25, Material.AWNING: 0.40, Material.GUIDE_SIGN: 5.0,
    Material.STREET_NAME: 2.0, Material.POSTER: 0.45, Material.LIGHT_RED: 0.30, Material.LIGHT_GREEN: 0.30,
    Material.CURTAIN: 0.06, Material.GOODS: 0.06,
    Material.KERB_LINE: 0.55,
    Material.NUMBER_PLATE: 1.5, Material.LIGHT_METAL: 0.40, Material.TAIL_LAMP: 1.0,
}  # fmt: skip
"""diffuse reflectance near 905 nm: leaves are bright there, glass deflects the beam, signs are retroreflective"""
_REFLECTANCE = np.array([_REFLECTANCE_OF[material] for material in Material])


def extinction(factors: Factors) -> float:
    """Extinction of the air, 1/m, by fog, rain and dry snow (ITU-R P.1814: 1.076 R^0.67 and 5.545 S^1.38 dB/km)."""
    decibels_per_km = 1.076 * factors.rain_mm_h**0.67 + 5.545 * factors.snowfall_mm_h**1.38
    return float(factors.fog_density + decibels_per_km / 1000 * np.log(10) / 10)


def surface_reflectance(material: Bytes, upward: Array, cosine: Array, factors: Factors) -> Array:
    """Diffuse reflectance (N,) near 905 nm of the surfaces that were hit, in the given weather.

    A film of water darkens a surface and reflects grazing beams specularly, by Schlick's approximation of Fresnel's
    equations, on the way in and on the way out. Walls get a third of the rain that the ground gets.

    Args:
        material: (N,) :class:`Material`.
        upward: (N,) vertical component of the surface's normal.
        cosine: (N,) cosine of the angle between beam and normal.
    """
    upward = np.clip(upward, 0.0, 1.0)
    dry = _REFLECTANCE[material]
    wet = factors.wetness * (1 + 2 * upward) / 3
    fresnel = 0.02 + 0.98 * (1 - np.clip(cosine, 0.0, 1.0)) ** 5
    damp = dry * (1 - wet + wet * _DIFFUSE_WHEN_WET * (1 - fresnel) ** 2)
    snow = factors.snow_cover * (upward > 0.5)
    return np.asarray((1 - snow) * damp + snow * _SNOW_REFLECTANCE)


def signal(distance: Array, reflectance: Array, extinction_per_m: float, dark_range_m: float) -> Array:
    """Power (N,) of echoes relative to the detection threshold, by the lidar equation ``rho cos / r^2 exp(-2 a r)``."""
    met = np.isfinite(distance)
    r = np.where(met, np.maximum(distance, 1e-3), 1.0)
    power = reflectance / r**2 * np.exp(-2 * extinction_per_m * r)
    return np.where(met, power * dark_range_m**2 / DARK, 0.0)


def clutter(factors: Factors) -> float:
    """Share of beams that are reflected by a raindrop or a snowflake."""
    rain, snow = _CLUTTER_PER_MM_H
    return float(1 - np.exp(-rain * factors.rain_mm_h - snow * factors.snowfall_mm_h))

"""Shading: the light that returns along each ray, by sun, sky and lamps, attenuated by the air."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Floats
from relocbench.datasets.synthetic.renderer.lamps import Beam, Lamps, headlight_irradiance, strongest_lamp
from relocbench.datasets.synthetic.renderer.samples import Samples, View, start
from relocbench.datasets.synthetic.renderer.sky import MAP, Sky
from relocbench.datasets.synthetic.renderer.skylight import Skylight, ground_share, sky_share
from relocbench.datasets.synthetic.renderer.surfaces import Geometry, Hits, Setting
from relocbench.datasets.synthetic.renderer.vectors import Vector, dot, exp_negative, smoothstep
from relocbench.datasets.synthetic.town.mesh import Material
from relocbench.kernels import njit

_LEAF, _HEDGE = int(Material.LEAF), int(Material.HEDGE)
_BRIGHTEST = 10.0
_HAZE = 0.00025
"""extinction of clear air, 1/m"""
_FOG_LAYER_M = 160.0


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def sky_radiance(sky: Sky, x: float, y: float, z: float) -> Vector:
    """The sky's radiance in a unit direction; directions below the horizon get that of the horizon."""
    z = max(z, 0.0)
    scale = MAP * 0.5 / (1 + z)
    u, v = x * scale + MAP * 0.5 - 0.5, y * scale + MAP * 0.5 - 0.5
    u, v = min(max(u, 0.0), MAP - 1.001), min(max(v, 0.0), MAP - 1.001)
    i, j = int(u), int(v)
    a, b = u - i, v - j
    m = sky.radiance
    w00, w10, w01, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    return (
        w00 * m[j, i, 0] + w10 * m[j, i + 1, 0] + w01 * m[j + 1, i, 0] + w11 * m[j + 1, i + 1, 0],
        w00 * m[j, i, 1] + w10 * m[j, i + 1, 1] + w01 * m[j + 1, i, 1] + w11 * m[j + 1, i + 1, 1],
        w00 * m[j, i, 2] + w10 * m[j, i + 1, 2] + w01 * m[j + 1, i, 2] + w11 * m[j + 1, i + 1, 2],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def radiance(
    view: View,
    geometry: Geometry,
    setting: Setting,
    sky: Sky,
    skylight: Skylight,
    lamps: Lamps,
    beam: Beam,
    samples: Samples,
    hits: Hits,
    lit: Floats,
    reflected: Floats,
) -> Floats:
    """Radiance (N, 3) of the samples.

    Args:
        lit: (N,) unshadowed share of the sun or of the strongest lamp.
        reflected: (N, 3) light from the direction of specular reflection; negative where no ray was cast for it, and
            the sky is used instead.
    """
    n = len(hits.depth)
    out = np.empty((n, 3), dtype=np.float32)
    by_lamp = sky.sun[0] + sky.sun[1] + sky.sun[2] <= 0.0
    for i in range(n):
        _, d, _, _ = start(view, samples, i)
        length = np.sqrt(dot(d, d))
        per_length = 1.0 / length
        d = (d[0] * per_length, d[1] * per_length, d[2] * per_length)
        if hits.depth[i] <= 0.0:
            r, g, b = sky_radiance(sky, d[0], d[1], d[2])
            distance = _FOG_LAYER_M / (max(d[2], 0.0) + 0.02)
            veil = exp_negative(setting.extinction * distance)
        else:
            x, y, z = hits.position[i, 0], hits.position[i, 1], hits.position[i, 2]
            nx, ny, nz = hits.normal[i, 0], hits.normal[i, 1], hits.normal[i, 2]
            material = geometry.material[samples.triangle[i]]
            leafy = material in (_LEAF, _HEDGE)
            share, open_sky = sky_share(skylight, x, y, z, nx, ny, nz)
            if leafy:
                share = 0.6 * share + 0.12
            elif nz > 0.9 and z < 0.4:
                near = ground_share(skylight, x, y)
                share, open_sky = share * near, open_sky * near
            # The ground reflects about a quarter of the light that falls on it.
            below = 0.5 * (1 - 0.6 * nz) * 0.25
            sun_down = max(sky.to_sun[2], 0.0) * 0.45 * open_sky
            er = sky.ambient[0] * (share + below * open_sky) + below * sun_down * sky.sun[0]
            eg = sky.ambient[1] * (share + below * open_sky) + below * sun_down * sky.sun[1]
            eb = sky.ambient[2] * (share + below * open_sky) + below * sun_down * sky.sun[2]
            if not by_lamp:
                facing = nx * sky.to_sun[0] + ny * sky.to_sun[1] + nz * sky.to_sun[2]
                if leafy:
                    # A leaf transmits a third of the light and is never seen exactly edge-on; its neighbours, of which
                    # only the largest are there, shade parts of it.
                    facing = 0.2 + 0.6 * abs(facing) if facing > 0 else 0.24 * abs(facing)
                facing = max(facing, 0.0) * lit[i]
                er, eg, eb = er + facing * sky.sun[0], eg + facing * sky.sun[1], eb + facing * sky.sun[2]
            if setting.lamps_on:
                _, most, rest = strongest_lamp(lamps, x, y, z, nx, ny, nz)
                power = most * (lit[i] if by_lamp else 1.0) + 0.5 * rest
                er, eg, eb = er + power, eg + 0.76 * power, eb + 0.46 * power
            if setting.headlights:
                power = headlight_irradiance(beam, x, y, z, nx, ny, nz) * (0.01 + 0.99 * setting.night)
                er, eg, eb = er + power, eg + 0.93 * power, eb + 0.8 * power
            r, g, b = hits.albedo[i, 0] * er, hits.albedo[i, 1] * eg, hits.albedo[i, 2] * eb
            f = hits.mirror[i]
            if f > 0.0:
                if reflected[i, 0] >= 0.0:
                    mr, mg, mb = reflected[i, 0], reflected[i, 1], reflected[i, 2]
                else:
                    turn = 2 * (d[0] * nx + d[1] * ny + d[2] * nz)
                    ux, uy, uz = d[0] - turn * nx, d[1] - turn * ny, d[2] - turn * nz
                    mr, mg, mb = sky_radiance(sky, ux, uy, uz)
                    # Where little of the sky is visible, low directions hit houses.
                    low = 1 - (1 - open_sky) * (1 - smoothstep(uz, 0.2, 0.7)) if uz > 0 else 0.25 * open_sky
                    mr, mg, mb = mr * low, mg * low, mb * low
                r, g, b = r + f * (mr - r), g + f * (mg - g), b + f * (mb - b)
            r, g, b = r + hits.emission[i, 0], g + hits.emission[i, 1], b + hits.emission[i, 2]
            veil = exp_negative((setting.extinction + _HAZE) * hits.depth[i] * length)
        glow = 0.0
        if setting.extinction > 0.0:
            glow = 0.25 * max(d[0] * sky.to_sun[0] + d[1] * sky.to_sun[1] + d[2] * sky.to_sun[2], 0.0) ** 8
        for k in range(3):
            value = r if k == 0 else (g if k == 1 else b)
            value = value * veil + (sky.horizon[k] + glow * sky.sun[k]) * (1 - veil)
            out[i, k] = min(max(value, 0.0), _BRIGHTEST)
    return out

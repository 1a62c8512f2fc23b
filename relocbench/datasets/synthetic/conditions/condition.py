"""Weather, season and time of day as separate continuous factors, and named conditions made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from relocbench.datasets.core.schema import Condition, Strict
from relocbench.datasets.synthetic.conditions.imaging import Imaging
from relocbench.errors import ConfigError, available

_OF_THE_IDEAL_CAMERA = ("gamma", "vignetting", "read_noise", "shot_noise")
"""factors that ``imaging`` has in its own way"""
_OF_THE_CAMERA = "imaging."
_ADDED: dict[str, object] = {"imaging": None, "months": 0.0}
"""factors that earlier versions did not have, with the values that change nothing"""


class Factors(Strict):
    """Everything that can differ between two traversals of one district, apart from the drive itself."""

    sun_elevation_deg: float = Field(45.0, ge=-90, le=90)
    """above the horizon; below -6 it is night"""
    sun_azimuth_deg: float = Field(140.0, ge=0, lt=360)
    """clockwise from north"""
    cloud_cover: float = Field(0.0, ge=0, le=1)
    """0 clear sky, 1 no sun and no shadows"""
    fog_density: float = Field(0.0, ge=0)
    """extinction coefficient (Beer-Lambert), 1/m; 0.02 hides what is beyond 150 m"""
    rain_mm_h: float = Field(0.0, ge=0)
    """falling rain, which gives streaks and fewer lidar returns"""
    lens_drops: float = Field(0.0, ge=0, le=1)
    """drops on the lens, as a share of a fixed worst case"""
    wetness: float = Field(0.0, ge=0, le=1)
    """wetness of all surfaces that rain reaches; they are darker and, if flat, mirror-like"""
    puddles: float = Field(0.0, ge=0, le=1)
    """share of the road's hollows that are filled with water"""
    snow_cover: float = Field(0.0, ge=0, le=1)
    """snow on upward-facing surfaces; 1 covers the road as well"""
    snowfall_mm_h: float = Field(0.0, ge=0)
    """falling snow, water equivalent"""
    foliage: float = Field(1.0, ge=0, le=1)
    """leaf density of deciduous plants; 0 is bare winter"""
    leaf_colour: float = Field(0.3, ge=0, le=1)
    """0 spring green, 0.5 late summer, 1 autumn yellow and red"""
    parked_share: float = Field(0.6, ge=0, le=1)
    """share of the parking bays that are occupied"""
    parked_seed: int = Field(0, ge=0)
    """chooses which cars are parked where"""
    months: float = Field(0.0, ge=0, le=24)
    """time by which the street has aged since it was built, as :mod:`relocbench.datasets.synthetic.town.ageing` says"""
    traffic: float = Field(0.0, ge=0)
    """moving cars per 100 m of lane"""
    people: float = Field(10.0, ge=0)
    """people on foot per 100 m of pavement; there are a twelfth as many bicycles per 100 m of lane"""
    exposure_ev: float = 0.0
    """stops above what auto-exposure chooses"""
    auto_exposure: bool = True
    gamma: float = Field(2.2, gt=0)
    vignetting: float = Field(0.15, ge=0, le=1)
    """share of light lost in the image's corners"""
    read_noise: float = Field(0.3, ge=0)
    """standard deviation in the dark, grey levels of 255"""
    shot_noise: float = Field(0.006, ge=0)
    """standard deviation at full scale, relative to the signal"""
    street_lamps: bool = False
    headlights: bool = False
    """headlights of the recording car and of the moving cars"""
    imaging: Imaging | None = None
    """a camera in place of the ideal one, whose ``gamma``, ``vignetting`` and noise then do not apply"""

    @property
    def dark(self) -> bool:
        """Whether it is night, so that lamps are the only light."""
        return self.sun_elevation_deg < -6

    @property
    def scene(self) -> Factors:
        """What the scene looks like, whichever camera is used."""
        return self if self.imaging is None else self.model_copy(update={"imaging": None})

    @model_validator(mode="after")
    def _one_camera(self) -> Self:
        fields = type(self).model_fields
        both = [n for n in _OF_THE_IDEAL_CAMERA if self.imaging is not None and getattr(self, n) != fields[n].default]
        if both:
            raise ValueError(f"{both[0]} has no effect beside imaging; set it there")
        return self

    @model_serializer(mode="wrap")
    def _as_earlier_versions(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """The factors as they were before there were ``imaging`` and ``months``, where these have no effect."""
        values: dict[str, Any] = plain(self)
        for name, without in _ADDED.items():
            if getattr(self, name) == without:
                values.pop(name, None)
        return values


class NamedCondition(Strict):
    """A condition that ``--conditions NAME`` can select."""

    label: Condition
    factors: Factors


def _named(weather: str, season: str, time: str, **factors: object) -> NamedCondition:
    return NamedCondition(
        label=Condition(weather=weather, season=season, time_of_day=time), factors=Factors.model_validate(factors)
    )


CONDITIONS: dict[str, NamedCondition] = {
    "Neutral": _named("partly cloudy", "summer", "afternoon",
        sun_elevation_deg=48, sun_azimuth_deg=255, cloud_cover=0.6, parked_share=0.5),
    "Sunny": _named("sunny", "summer", "morning",
        sun_elevation_deg=38, sun_azimuth_deg=120, cloud_cover=0.1),
    "Overcast": _named("overcast", "autumn", "noon",
        cloud_cover=1.0, sun_elevation_deg=30, leaf_colour=0.75, foliage=0.6, parked_seed=1),
    "Rain": _named("rain", "autumn", "afternoon",
        cloud_cover=1.0, sun_elevation_deg=22, sun_azimuth_deg=230, rain_mm_h=8.0, lens_drops=0.3, wetness=1.0,
        puddles=0.7, fog_density=0.003, leaf_colour=0.9, foliage=0.45, parked_seed=2, headlights=True,
        people=4),
    "Snow": _named("snow", "winter", "noon",
        cloud_cover=0.9, sun_elevation_deg=18, sun_azimuth_deg=180, snow_cover=0.85, snowfall_mm_h=1.5, foliage=0.0,
        fog_density=0.002, parked_seed=3, people=5),
    "Night": _named("clear", "summer", "night",
        sun_elevation_deg=-20, sun_azimuth_deg=330, street_lamps=True, headlights=True, parked_seed=4,
        parked_share=0.8, read_noise=2.0, people=3),
    "Fog": _named("fog", "autumn", "morning",
        cloud_cover=1.0, sun_elevation_deg=15, sun_azimuth_deg=110, fog_density=0.03, leaf_colour=0.8, foliage=0.5,
        wetness=0.4, parked_seed=5, people=6),
    "WetNoon": _named("wet", "summer", "noon",
        sun_elevation_deg=75, sun_azimuth_deg=180, cloud_cover=0.3, wetness=0.9, puddles=0.6, parked_seed=6),
    "SoftRainNoon": _named("soft rain", "summer", "noon",
        sun_elevation_deg=75, sun_azimuth_deg=180, cloud_cover=0.76, rain_mm_h=2.0, wetness=0.8, puddles=0.4,
        lens_drops=0.15, parked_seed=7, people=6),
    "WetCloudySunset": _named("wet, cloudy", "summer", "sunset",
        sun_elevation_deg=7, sun_azimuth_deg=285, cloud_cover=0.6, wetness=0.9, puddles=0.5, parked_seed=8),
    "ClearSnow": _named("clear, snow", "winter", "noon",
        cloud_cover=0.1, sun_elevation_deg=16, sun_azimuth_deg=180, snow_cover=0.85, foliage=0.0, parked_seed=9,
        people=5),
}  # fmt: skip
"""WetNoon, SoftRainNoon and WetCloudySunset are those of the GN-Net benchmark, modelled on CARLA 0.8.2's presets of
these names. Another condition comes last, since cameras of previews are drawn by the place of theirs."""


def condition_named(name: str) -> NamedCondition:
    """The condition of a name in :data:`CONDITIONS`. Raises ConfigError, listing the names, if there is none."""
    if name not in CONDITIONS:
        raise ConfigError(f"no condition '{name}'{available(name, CONDITIONS)}")
    return CONDITIONS[name]


SEASONS: dict[str, dict[str, float]] = {
    "spring": {"foliage": 0.5, "leaf_colour": 0.0, "sun_elevation_deg": 42, "snow_cover": 0.0},
    "summer": {"foliage": 1.0, "leaf_colour": 0.4, "sun_elevation_deg": 62, "snow_cover": 0.0},
    "autumn": {"foliage": 0.85, "leaf_colour": 1.0, "sun_elevation_deg": 33, "snow_cover": 0.0},
    "late autumn": {"foliage": 0.1, "leaf_colour": 1.0, "sun_elevation_deg": 20, "snow_cover": 0.0},
    "winter": {"foliage": 0.0, "leaf_colour": 1.0, "sun_elevation_deg": 16, "snow_cover": 0.9},
}
"""The year; the sun is as high as around noon at 50 degrees north."""

SWEEPS: dict[str, tuple[dict[str, float], ...]] = {
    "season": tuple(SEASONS.values()),
    "light": ({"sun_elevation_deg": 60, "sun_azimuth_deg": 120}, {"sun_elevation_deg": 8, "sun_azimuth_deg": 280}),
    "clouds": ({"cloud_cover": 0.0}, {"cloud_cover": 1.0}),
    "wetness": ({"wetness": 0.0, "puddles": 0.0}, {"wetness": 1.0, "puddles": 1.0}),
    "leaves": ({"foliage": 1.0}, {"foliage": 0.0}),
    "leaf-colour": ({"leaf_colour": 0.0}, {"leaf_colour": 1.0}),
    "snow": ({"snow_cover": 0.0}, {"snow_cover": 1.0}),
    "fog": ({"fog_density": 0.0}, {"fog_density": 0.05}),
    "rain": ({"rain_mm_h": 0.0}, {"rain_mm_h": 20.0}),
    "exposure": ({"exposure_ev": -2.0}, {"exposure_ev": 2.0}),
    "months": ({"months": 0.0}, {"months": 24.0}),
    "people": ({"people": 0.0}, {"people": 20.0}),
    "parked-cars": ({"parked_share": 0.0}, {"parked_share": 1.0}),
    "exposure-time": ({"imaging.exposure_ms": 0.0}, {"imaging.exposure_ms": 40.0}),
    "defocus": ({"imaging.defocus_px": 0.0}, {"imaging.defocus_px": 4.0}),
    "vignetting": ({"imaging.vignetting": 0.0}, {"imaging.vignetting": 0.8}),
    "bloom": ({"imaging.bloom": 0.0}, {"imaging.bloom": 0.2}),
    "veiling-glare": ({"imaging.veiling_glare": 0.0}, {"imaging.veiling_glare": 0.3}),
    "dirt": ({"imaging.dirt": 0.0}, {"imaging.dirt": 1.0}),
    "drops": ({"imaging.drops": 0.0}, {"imaging.drops": 1.0}),
    "noise": (
        {"imaging.read_noise": 0.0, "imaging.shot_noise": 0.0},
        {"imaging.read_noise": 0.02, "imaging.shot_noise": 0.2},
    ),
    "temperature": ({"imaging.temperature_ev": -1.0}, {"imaging.temperature_ev": 1.0}),
    "white-level": ({"imaging.white_level": 1.0}, {"imaging.white_level": 8.0}),
    "gamma": ({"imaging.gamma": 1.4}, {"imaging.gamma": 3.0}),
    "contrast": ({"imaging.contrast": 0.5}, {"imaging.contrast": 2.0}),
    "denoising": (
        {"imaging.denoising": 0.0, "imaging.chroma_denoising_px": 0.0},
        {"imaging.denoising": 0.2, "imaging.chroma_denoising_px": 6.0},
    ),
    "sharpening": ({"imaging.sharpening": 0.0}, {"imaging.sharpening": 3.0}),
    "saturation": ({"imaging.saturation": 0.0}, {"imaging.saturation": 2.0}),
    "jpeg-quality": ({"imaging.jpeg_quality": 95.0}, {"imaging.jpeg_quality": 5.0}),
}
"""Name -> values of the swept factors at two or more stations, the first and the last of which are the ends; all other
factors stay the same. Those of the camera begin with ``imaging.``."""


def sweep(name: str, steps: int) -> Sequence[Factors]:
    """``steps`` conditions, evenly spread over the stations of a sweep, that differ from ``Sunny`` in what is swept.

    Raises:
        ConfigError: the name is unknown, or there are fewer than two steps.
    """
    if name not in SWEEPS:
        raise ConfigError(f"no sweep '{name}'{available(name, SWEEPS)}")
    if steps < 2:
        raise ConfigError(f"a sweep needs at least 2 steps, got {steps}")
    base = CONDITIONS["Sunny"].factors
    return [changed(base, _between(SWEEPS[name], i / (steps - 1))) for i in range(steps)]


def _between(stations: Sequence[Mapping[str, float]], part: float) -> dict[str, float]:
    """The values at a part, in [0, 1], of the way from the first station to the last."""
    at = part * (len(stations) - 1)
    before = min(int(at), len(stations) - 2)
    start, end, f = stations[before], stations[before + 1], at - before
    return {key: (1 - f) * start[key] + f * end[key] for key in start}


def changed(factors: Factors, values: Mapping[str, float]) -> Factors:
    """The factors with other values for some; names as in :data:`SWEEPS`."""
    ours = {key: value for key, value in values.items() if not key.startswith(_OF_THE_CAMERA)}
    imaging = {key.removeprefix(_OF_THE_CAMERA): value for key, value in values.items() if key not in ours}
    if imaging:
        before = {} if factors.imaging is None else factors.imaging.model_dump()
        return Factors.model_validate({**factors.model_dump(), **ours, "imaging": {**before, **imaging}})
    return Factors.model_validate({**factors.model_dump(), **ours})


def value_of(factors: Factors, name: str) -> float:
    """The value of a factor; names as in :data:`SWEEPS`, of those of the camera if the factors have one."""
    if name.startswith(_OF_THE_CAMERA):
        return float(getattr(factors.imaging, name.removeprefix(_OF_THE_CAMERA)))
    return float(getattr(factors, name))

"""The camera of a drive as separate factors, from shutter and lens to compression, and how one is drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from relocbench.datasets.core.schema import Strict

_DIGITS = 4
"""significant digits of drawn values, so that build.yaml can be read"""


class Imaging(Strict):
    """How one camera turns light into grey levels. With the defaults nothing disturbs the picture.

    :mod:`relocbench.datasets.synthetic.camera` has the formulas.
    """

    seed: int = Field(0, ge=0, lt=2**31)
    """chooses the course of drifts, and where dirt and drops are"""
    exposure_ms: float = Field(0.0, ge=0, le=100)
    """exposure time; half of it is before the time of the pose and half after"""
    defocus_px: float = Field(0.0, ge=0, le=20)
    """radius of the disk in which a point is imaged"""
    vignetting: float = Field(0.0, ge=0, le=0.9)
    """share of light lost in the image's corners"""
    bloom: float = Field(0.0, ge=0, le=0.5)
    """share of light that the lens scatters nearby, which is seen around bright lights"""
    veiling_glare: float = Field(0.0, ge=0, le=0.5)
    """share of light that the lens scatters over the whole image"""
    dirt: float = Field(0.0, ge=0, le=1)
    """dirt on the lens, as a share of a fixed worst case"""
    drops: float = Field(0.0, ge=0, le=1)
    """drops that stay on the lens or slide down, as a share of a fixed worst case, beside those of the weather"""
    exposure_ev: float = Field(0.0, ge=-6, le=6)
    """stops above what auto-exposure and the condition choose"""
    exposure_drift_ev: float = Field(0.0, ge=0, le=3)
    """greatest drift of the exposure along the drive, stops"""
    read_noise: float = Field(0.0, ge=0, le=0.5)
    """standard deviation in the dark, as a share of the light that a linear sensor saturates at"""
    shot_noise: float = Field(0.0, ge=0, le=0.5)
    """standard deviation at that light, as a share of it"""
    temperature_ev: float = Field(0.0, ge=-3, le=3)
    """error of the white balance: stops of red over blue; warm if positive"""
    tint_ev: float = Field(0.0, ge=-2, le=2)
    """error of the white balance: stops of green over magenta"""
    white_balance_drift_ev: float = Field(0.0, ge=0, le=2)
    """greatest drift of ``temperature_ev`` along the drive, stops"""
    white_level: float = Field(3.0, ge=1, le=20)
    """light that becomes white; 1 is a linear sensor that saturates, larger values keep highlights"""
    gamma: float = Field(2.2, ge=1, le=4)
    """exponent of the response curve"""
    contrast: float = Field(1.0, ge=0.2, le=4)
    """slope of the response curve's S at middle grey"""
    denoising: float = Field(0.0, ge=0, le=0.5)
    """differences of brightness, as a share of full scale, that are smoothed away within a few pixels"""
    chroma_denoising_px: float = Field(0.0, ge=0, le=20)
    """standard deviation of the Gaussian that smooths colour"""
    sharpening: float = Field(0.0, ge=0, le=5)
    """weight of the unsharp mask"""
    sharpening_px: float = Field(1.0, ge=0.3, le=10)
    """standard deviation of the Gaussian of the unsharp mask"""
    saturation: float = Field(1.0, ge=0, le=3)
    """factor of the colour differences; 0 is a grey image"""
    jpeg_quality: float | None = Field(None, ge=1, le=100)
    """quality, a whole number after rounding, of a JPEG compression before the image is stored; none by default"""


@dataclass(frozen=True)
class Range:
    """What a factor is drawn from."""

    low: float
    high: float
    share: float = 1.0
    """share of the cameras that have the effect; others keep the default"""
    logarithmic: bool = False

    def draw(self, rng: np.random.Generator) -> float | None:
        """A value, or None for a camera without the effect. Always takes two numbers from the generator."""
        chosen, at = rng.uniform(size=2)
        if chosen >= self.share:
            return None
        if self.logarithmic:
            return float(self.low * (self.high / self.low) ** at)
        return float(self.low + (self.high - self.low) * at)


def rounded(drawn: float) -> float:
    """A drawn value as files tell it."""
    return float(f"{drawn:.{_DIGITS}g}")


RANGES: dict[str, Range] = {
    "exposure_ms": Range(0.5, 12.0, logarithmic=True),
    "defocus_px": Range(0.3, 1.5, share=0.6),
    "vignetting": Range(0.0, 0.5),
    "bloom": Range(0.005, 0.06, logarithmic=True),
    "veiling_glare": Range(0.001, 0.015, logarithmic=True),
    "dirt": Range(0.1, 0.6, share=0.2),
    "drops": Range(0.05, 0.3, share=0.2),
    "exposure_ev": Range(-0.3, 1.3),
    "exposure_drift_ev": Range(0.0, 0.4),
    "read_noise": Range(0.0005, 0.003, logarithmic=True),
    "shot_noise": Range(0.003, 0.02, logarithmic=True),
    "temperature_ev": Range(-0.45, 0.45),
    "tint_ev": Range(-0.12, 0.12),
    "white_balance_drift_ev": Range(0.0, 0.2),
    "white_level": Range(1.0, 2.5),
    "gamma": Range(1.8, 2.6),
    "contrast": Range(1.0, 1.7),
    "denoising": Range(0.01, 0.07, share=0.6),
    "chroma_denoising_px": Range(0.5, 3.0, share=0.7),
    "sharpening": Range(0.2, 1.4, share=0.7),
    "sharpening_px": Range(0.6, 1.8),
    "saturation": Range(0.5, 1.5),
    "jpeg_quality": Range(30.0, 97.0, share=0.8),
}
"""What ``--imaging varied`` draws each factor from."""

DARK_RANGES: dict[str, Range] = {
    "exposure_ms": Range(8.0, 33.0, logarithmic=True),
    "read_noise": Range(0.002, 0.008, logarithmic=True),
    "shot_noise": Range(0.02, 0.08, logarithmic=True),
}
"""The same for drives in the dark, where the shutter stays open longer and amplified light is noisier."""


def draw_imaging(rng: np.random.Generator, *, dark: bool) -> Imaging:
    """The camera of a drive.

    Args:
        dark: whether lamps are the only light.
    """
    values: dict[str, float] = {"seed": int(rng.integers(2**31))}
    for name, by_day in RANGES.items():
        drawn = (DARK_RANGES.get(name, by_day) if dark else by_day).draw(rng)
        if drawn is not None:
            values[name] = round(drawn) if name == "jpeg_quality" else rounded(drawn)
    return Imaging.model_validate(values)

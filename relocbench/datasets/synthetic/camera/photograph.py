"""One image by the camera of a drive, in the order of physics: lens, sensor, processing, compression."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Floats, Image
from relocbench.datasets.core.images import through_jpeg
from relocbench.datasets.synthetic.camera import processing
from relocbench.datasets.synthetic.camera.drops import sliding_drops, through_drops
from relocbench.datasets.synthetic.camera.lens import behind_dirt, clearness, defocus, scatter, vignette
from relocbench.datasets.synthetic.camera.shot import Drifting, Shot, drift


def through_lens(light: Floats, shot: Shot) -> Floats:
    """The light (H, W, 3) that arrives at the sensor: behind drops and dirt, scattered, defocused, less in corners."""
    camera = shot.imaging
    height, width = light.shape[:2]
    if camera.drops > 0:
        light = through_drops(light, sliding_drops(height, width, camera.drops, camera.seed, shot.lens, shot.time_s))
    if camera.dirt > 0:
        light = behind_dirt(light, clearness(height, width, camera.dirt, camera.seed, shot.lens))
    light = scatter(light, camera.bloom, camera.veiling_glare)
    light = defocus(light, camera.defocus_px)
    if camera.vignetting > 0:
        light = light * vignette(height, width, camera.vignetting)[..., None]
    return light


def exposure_ev(shot: Shot) -> float:
    """Stops by which the camera exposes more than automatic exposure, at the time of the shot."""
    camera = shot.imaging
    return camera.exposure_ev + camera.exposure_drift_ev * drift(camera.seed, Drifting.EXPOSURE, shot.time_s)


def temperature_ev(shot: Shot) -> float:
    """Error of the white balance at the time of the shot: stops of red over blue."""
    camera = shot.imaging
    wandered = drift(camera.seed, Drifting.WHITE_BALANCE, shot.time_s)
    return camera.temperature_ev + camera.white_balance_drift_ev * wandered


def with_noise(light: Floats, read: float, shot: float, rng: np.random.Generator) -> Floats:
    """Linear light (H, W, 3), on a scale on which 1 is the least light that a linear sensor saturates at, with noise.

    The variance is ``read^2 + shot^2 I`` (Foi et al., "Practical Poissonian-Gaussian noise modeling", 2008). Values
    below 0 are kept, so that the mean stays that of the light.
    """
    if read <= 0 and shot <= 0:
        return light
    deviation = np.sqrt(np.float32(read**2) + np.float32(shot**2) * np.maximum(light, 0))
    return np.asarray(light + deviation * rng.standard_normal(light.shape, dtype=np.float32), dtype=np.float32)


def grey_levels(light: Floats, shot: Shot, rng: np.random.Generator) -> Image:
    """The 8-bit image (H, W, 3) of exposed light (H, W, 3): noise, processing, compression.

    Args:
        rng: of the image's noise.
    """
    camera = shot.imaging
    light = with_noise(light, camera.read_noise, camera.shot_noise, rng)
    light = light * processing.white_balance(temperature_ev(shot), camera.tint_ev)
    levels = processing.response(light, camera.white_level, camera.gamma, camera.contrast)
    luma, chroma = processing.to_luma_chroma(levels)
    luma = processing.denoise(luma, camera.denoising)
    chroma = processing.smooth_colour(chroma, camera.chroma_denoising_px)
    luma = processing.sharpen(luma, camera.sharpening, camera.sharpening_px)
    levels = processing.to_rgb(luma, np.float32(camera.saturation) * chroma)
    image = np.rint(np.clip(levels, 0, 1) * 255).astype(np.uint8)
    return image if camera.jpeg_quality is None else through_jpeg(image, camera.jpeg_quality)

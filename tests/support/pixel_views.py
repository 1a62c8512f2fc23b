"""Two views of a texture that is shifted by known fractions of a pixel."""

from __future__ import annotations

import cv2
import numpy as np

from baselines.alignment.matching import DSO_PATTERN, MatchSettings
from baselines.alignment.shared.pyramid import Level, level_camera, with_gradients
from relocbench.arrays import Array
from relocbench.geometry import Camera

WIDTH, HEIGHT = 320, 240
CAMERA = Camera("pinhole", WIDTH, HEIGHT, 250.0, 250.0, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5)
INTENSITY = MatchSettings(DSO_PATTERN, "affine", damping=0.01)


def texture(x: Array, y: Array, seed: int = 0, shortest: float = 9.0) -> Array:
    """A sum of sine waves of random direction, 9 px and longer: values are known between the pixels."""
    rng = np.random.default_rng(seed)
    total = np.zeros(np.broadcast(x, y).shape)
    for length in np.geomspace(shortest, 120, 24):
        direction, phase = rng.uniform(0, 2 * np.pi, 2)
        total += np.sin(2 * np.pi / length * (np.cos(direction) * x + np.sin(direction) * y) + phase)
    return np.asarray(127.5 + 24.0 * total, dtype=np.float64)


def view(shift: tuple[float, float] = (0.0, 0.0), seed: int = 0) -> Array:
    """(H, W): what is at u in the reference is at u + shift here."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    return texture(u - shift[0], v - shift[1], seed)


def levels(*channels: Array, count: int = 4) -> list[Level]:
    """A pyramid of float maps with as many channels."""
    values = np.stack(channels, axis=-1).astype(np.float32)
    out = []
    for number in range(count):
        out.append(Level(with_gradients(values), level_camera(CAMERA, number)))
        values = np.stack(
            [
                cv2.resize(values[..., c], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                for c in range(len(channels))
            ],
            axis=-1,
        )
    return out


def pixels(border: float = 40.0, step: float = 17.3) -> Array:
    """(N, 2), not at pixel centres."""
    u, v = np.meshgrid(np.arange(border, WIDTH - border, step), np.arange(border, HEIGHT - border, step))
    return np.stack([u, v], axis=-1).reshape(-1, 2)


def offsets(count: int, length: float, seed: int = 0) -> Array:
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, count)
    return length * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def share_found(end: Array, truth: Array, within: float) -> float:
    distance = np.linalg.norm(end - truth, axis=-1)
    return float(np.mean(np.nan_to_num(distance, nan=np.inf) <= within))

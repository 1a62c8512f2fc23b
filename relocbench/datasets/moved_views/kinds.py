"""The kinds of surfaces, of motions and of changes of light, for options that are read before anything is drawn."""

from __future__ import annotations

from typing import Literal

SurfaceKind = Literal["plane", "street", "relief"]
SURFACES: tuple[SurfaceKind, ...] = ("plane", "street", "relief")

Viewpoint = Literal["normal", "strong"]

Change = Literal["none", "exposure", "shading", "night", "lamplight", "fog", "snow", "low-sun"]
WORDS: dict[Change, str] = {
    "none": "photograph",
    "exposure": "photograph, changed exposure",
    "shading": "photograph, changed shading",
    "night": "photograph, darkened",
    "lamplight": "photograph, made-up night",
    "fog": "photograph, made-up fog",
    "snow": "photograph, made-up snow",
    "low-sun": "photograph, made-up low sun",
}
"""the condition of images so changed, in words"""

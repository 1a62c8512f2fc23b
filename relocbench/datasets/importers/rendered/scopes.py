"""Which options of rendered datasets have an effect on what: on datasets, recordings, some of their kinds only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic_core import PydanticCustomError

_RECORDING_OPTIONS = ("recording_cameras", "image_scale", "rings", "azimuths", "motion_distorted")
_SPINNING_OPTIONS = ("rings", "azimuths")
_LAYOUT_OPTIONS = {
    "robotcar": (),
    "kitti": (*_SPINNING_OPTIONS, "motion_distorted"),
    "boreas": _SPINNING_OPTIONS,
}
"""options of recordings that only some layouts have"""
_DEPTH_OPTIONS = {
    "exact": (),
    "points": ("depth_points", "depth_error"),
    "lidar": ("rings",),
    "stereo": ("depth_error",),
}
"""options of datasets that only some kinds of depth have"""
_DATASET_OPTIONS = (
    "name", "licence", "imaging", "pair_rule", "pair_step", "max_distance", "max_angle", "correspondences",
    "min_distance", "min_angle", "camera_pairs", "cameras", "size", "distance", "reference", "extras", "elsewhere",
    "elsewhere_distance", "salt_file", "views", "rolling_shutter", "people", "tier", "pairs", "repeating_street",
    "depth", "depth_points", "depth_error",
)  # fmt: skip


def refuse_what_has_no_effect(values: dict[str, Any]) -> None:
    """Raise PydanticCustomError if an option was given that has no effect."""
    layout = values.get("recording")
    # Recordings and one kind of depth have the lidar's rings.
    refused = [name for name in _RECORDING_OPTIONS if name not in _only_some(_DEPTH_OPTIONS)]
    why = "applies to recordings (--recording) only"
    option, chosen, having = "depth", values.get("depth", "exact"), _DEPTH_OPTIONS
    if layout is not None:
        refused, why = [*_DATASET_OPTIONS], "applies to datasets only, not to recordings (--recording)"
        option, chosen, having = "recording", layout, _LAYOUT_OPTIONS
    found = [name for name in refused if name in values]
    if not found and chosen in [*having]:
        found = [name for name in _only_some(having) if name in values and name not in having[chosen]]
        those = [other for other, names in having.items() if found and found[0] in names]
        also = " and to recordings" if layout is None and found and found[0] in _RECORDING_OPTIONS else ""
        why = f"applies to --{option} {' and '.join(those)}{also} only"
    if not found and values.get("min_distance") and "distance" in values:
        found, why = ["distance"], "has no effect with --min-distance, which spreads distances evenly"
    if found:
        raise PydanticCustomError("no_effect", f"--{found[0].replace('_', '-')} {why}")


def without_effect_on_datasets(depth: str) -> set[str]:
    """The options of recordings that datasets with a kind of depth do not have."""
    return set(_RECORDING_OPTIONS) - set(_DEPTH_OPTIONS[depth])


def without_effect_on_recordings(layout: str) -> set[str]:
    """The options that recordings in a layout do not have."""
    return {*_DATASET_OPTIONS, *_only_some(_LAYOUT_OPTIONS)} - set(_LAYOUT_OPTIONS[layout])


def _only_some(having: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """The options that only some layouts of recordings have, or some kinds of depth."""
    return tuple(dict.fromkeys(name for names in having.values() for name in names))

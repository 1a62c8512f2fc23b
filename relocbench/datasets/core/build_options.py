"""The options that several importers share."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from relocbench.datasets.core.schema import Condition, Strict
from relocbench.errors import ConfigError, available


class DatasetOptions(Strict):
    """Options of every dataset, with or without images. Each field is a command-line option (``max_distance`` is
    ``--max-distance``) and a YAML key."""

    LATER: ClassVar[tuple[str, ...]] = ()
    """options that earlier versions did not have, and whose defaults change nothing"""
    PATHS: ClassVar[tuple[str, ...]] = ()
    """options that name folders and files; what these hold is recorded"""

    name: str = Field("", description="name of the dataset; default: made from the kind and the recordings")
    licence: str = Field("unknown", description="licence of the recordings, kept in dataset.yaml")
    conditions: dict[str, Condition] = Field(
        {}, description="condition of each traversal (weather, season, time_of_day, tags); YAML only"
    )

    def recorded(self) -> dict[str, Any]:
        """The options as ``build.yaml`` and ``dataset.yaml`` keep them; the content id covers these.

        Paths are left out, and later options at their defaults, as earlier versions had it.
        """
        fields = type(self).model_fields
        unused = {name for name in self.LATER if getattr(self, name) == fields[name].default}
        return self.model_dump(mode="json", exclude=unused | set(self.PATHS))

    def condition_of(self, traversal: str) -> Condition:
        """The condition that is given for a traversal; unknown by default."""
        return self.conditions.get(traversal, Condition())

    def given(self, name: str) -> Any:
        """The value of an option if it was given; None if it is left to its default."""
        return getattr(self, name) if name in self.model_fields_set else None

    def check_conditions(self, traversals: Sequence[str]) -> None:
        """Raise ConfigError if a condition is given for a traversal that does not exist."""
        for name in self.conditions:
            if name not in traversals:
                raise ConfigError(f"conditions: no traversal '{name}'{available(name, traversals)}")

    @property
    def copies_images(self) -> bool:
        """Whether images that could be linked are copied; kinds that convert every image have no option for it."""
        return False


class ImportOptions(DatasetOptions):
    """Options of every import of images."""

    max_distance: float = Field(5.0, gt=0, description="farthest pair in metres")
    max_angle: float = Field(60.0, gt=0, le=180, description="widest pair in degrees")
    correspondences: int = Field(
        2000, ge=0, description="ground-truth correspondences kept for each pair, spread over the image; 0 for none"
    )
    seed: int = Field(0, ge=0, description="seed of every random choice")


class LinkingOptions(ImportOptions):
    """Options of imports that can link to images of a recording."""

    copy_images: bool = Field(False, description="copy images of the recording instead of linking to them")

    @property
    def copies_images(self) -> bool:
        return self.copy_images


class PairingOptions(DatasetOptions):
    """Options of the rules by which frames make pairs."""

    max_distance: float = Field(5.0, gt=0, description="farthest pair in metres (nearest rule)")
    max_angle: float = Field(60.0, gt=0, le=180, description="widest pair in degrees (nearest rule)")
    pair_rule: Literal["step", "nearest"] | None = Field(
        None,
        description="'step': frame i with frame i + k of the same traversal; 'nearest': each query frame with the "
        "nearest keyframe of the reference traversal; default: step within one traversal, nearest across two",
    )
    pair_step: tuple[int, ...] = Field(
        (1,), description="frames between reference and query, such as 1,2,4 (step rule)"
    )
    seed: int = Field(0, ge=0, description="seed of every random choice")
    elsewhere: int = Field(
        0,
        ge=0,
        le=1_000_000,
        description="pairs of different places added to each pair set, which only confidences are judged by",
    )
    elsewhere_distance: float = Field(
        50.0, gt=0, description="least distance in metres between the cameras of a pair of different places"
    )

    def recorded(self) -> dict[str, Any]:
        """The options, without those of pairs of different places where there are none: as earlier versions had it."""
        unused = () if self.elsewhere else ("elsewhere", "elsewhere_distance")
        return {name: value for name, value in super().recorded().items() if name not in unused}

    @model_validator(mode="after")
    def _elsewhere_is_farther(self) -> Self:
        if not self.elsewhere and "elsewhere_distance" in self.model_fields_set:
            raise ValueError("elsewhere_distance has no effect without elsewhere, the number of negative pairs")
        if self.elsewhere and self.elsewhere_distance <= self.max_distance:
            raise ValueError(
                f"elsewhere_distance is {self.elsewhere_distance:g} m, expected more than max_distance, "
                f"{self.max_distance:g} m"
            )
        return self

    @model_validator(mode="after")
    def _steps_not_zero(self) -> Self:
        if not self.pair_step or 0 in self.pair_step:
            raise ValueError("pair_step must hold at least one step, and no 0")
        if len(set(self.pair_step)) != len(self.pair_step):
            raise ValueError("pair_step names a step twice")
        return self


class RuleOptions(PairingOptions, ImportOptions):
    """Options of imports that pair images by a rule."""


class PosedRecordingOptions(RuleOptions, LinkingOptions):
    """Options of imports of recordings with poses, which link to images and pair frames by a rule."""


class ClockOptions(PosedRecordingOptions):
    """Options of imports whose poses were measured by another clock than the images."""

    time_offset: tuple[float | Literal["estimate"], ...] = Field(
        ("estimate",),
        min_length=1,
        description="seconds, one for all or one per recording: an image at time t has the true pose at t + "
        "time_offset; 'estimate': as the images tell; 0: as recorded",
    )

    def time_offset_of(self, recording: int) -> float | None:
        """Seconds for a recording by its number; None where the images shall tell."""
        chosen = self.time_offset[min(recording, len(self.time_offset) - 1)]
        return None if chosen == "estimate" else float(chosen)

    def check_time_offsets(self, recordings: int) -> None:
        """Raise ConfigError unless there is one offset for all recordings or one for each."""
        if len(self.time_offset) not in (1, recordings):
            expected = f"expected one, or one for each of {recordings} recordings"
            raise ConfigError(f"time_offset has {len(self.time_offset)} values, {expected}")


def plain_size(text: str) -> str:
    """The size WIDTHxHEIGHT in pixels that an option tells, perhaps as one number for both. Raises ValueError."""
    match = re.fullmatch(r"(\d+)(?:x(\d+))?", text)
    sides = [int(side) for side in match.groups() if side] if match else []
    if not sides or not all(32 <= side <= 4096 for side in sides):
        raise ValueError("size is WIDTHxHEIGHT or one number, 32 to 4096 pixels")
    return f"{sides[0]}x{sides[-1]}"


ImageSize = Annotated[str, AfterValidator(plain_size)]
"""an option with a size in pixels"""


def width_height(size: str) -> tuple[int, int]:
    """The two numbers of WIDTHxHEIGHT."""
    width, height = size.split("x")
    return int(width), int(height)

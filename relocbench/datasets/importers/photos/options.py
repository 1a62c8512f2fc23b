"""The options that importers of photo collections share."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from pydantic import Field

from relocbench.datasets.core.build_options import PosedRecordingOptions
from relocbench.errors import ConfigError


class PhotoOptions(PosedRecordingOptions):
    """Options of imports of photo collections."""

    PATHS: ClassVar[tuple[str, ...]] = ("pairs",)

    queries: tuple[str, ...] = Field(
        (),
        description="names of the model's images that are queries and no keyframes, with * and ? as in file names, "
        "such as 'night/*'; default: every image is both",
    )
    pairs: Path | None = Field(
        None, description="pairs: lines 'query keyframe' of image names, as hloc writes them; default: by --pair-rule"
    )
    metres_per_unit: float = Field(1.0, gt=0, description="length of the model's unit; a model knows it up to scale")
    min_track: int = Field(2, ge=1, description="points that fewer images observe are left out")
    noise_px: float = Field(0.5, gt=0, description="least standard deviation of a keypoint in pixels")

    @property
    def paths(self) -> list[Path]:
        """The folders and files that are given."""
        return [path for key in self.PATHS if (path := getattr(self, key)) is not None]

    def check_pairs(self) -> None:
        """Raise ConfigError where pairs are both named and made by a rule."""
        if self.pairs is not None and (self.pair_rule is not None or self.elsewhere):
            raise ConfigError("--pairs names the pairs; --pair-rule and --elsewhere make some")

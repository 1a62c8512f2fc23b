"""Schemas of ``dataset.yaml`` and ``traversal.yaml``; unknown keys are refused by name."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    StringConstraints,
    field_validator,
    model_serializer,
    model_validator,
)

from relocbench.arrays import Array
from relocbench.errors import quoted
from relocbench.files import MAX_FOLDER_BYTES, check_distinct, check_joined_name, check_label, check_name
from relocbench.geometry import Camera, camera_from_dict, transform_from_tq, transform_to_tq

FORMAT_VERSION = 1
ELSEWHERE_VERSION = 2
"""format of datasets with pairs of different places, which programs that know only the first would score like others"""
INTRINSICS_VERSION = 3
"""format of datasets whose images may have intrinsics of their own, which programs that know less would not look at"""
POSES_VERSION = 4
"""format of datasets with frames that have poses and no images, for which programs that know less would look"""
CAMERAS_VERSION = 5
"""format of datasets with pairs across two cameras, whose names programs that know less would refuse or misread"""
_VERSIONS = (FORMAT_VERSION, ELSEWHERE_VERSION, INTRINSICS_VERSION, POSES_VERSION, CAMERAS_VERSION)

Name = Annotated[str, AfterValidator(lambda name: check_name(name, "name"))]
"""name of a traversal, a camera or a split, which becomes part of a path"""
Label = Annotated[str, AfterValidator(lambda name: check_label(name, "method label"))]
"""name of a method"""
JoinedName = Annotated[str, AfterValidator(lambda name: check_joined_name(name, "name"))]
"""name of a pair set, a task or a dataset"""
FolderName = Annotated[str, AfterValidator(lambda name: check_joined_name(name, "name", most_bytes=MAX_FOLDER_BYTES))]
"""name of a dataset with the suffix that its results folder has"""
Fingerprint = Annotated[str, StringConstraints(pattern=r"^[0-9A-Za-z]{1,128}$")]


def _one_line(text: str) -> str:
    if not text.isprintable() or len(text) > _LONGEST_LINE:
        raise ValueError(f"{quoted(text, 60)} is not one line of at most {_LONGEST_LINE} printable characters")
    return text


_LONGEST_LINE = 200
Line = Annotated[str, AfterValidator(_one_line)]
"""text of one printable line, which stands in tables"""


class Strict(BaseModel):
    """An immutable record that refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Transform(Strict):
    """A rigid transform in human-readable form."""

    model_config = ConfigDict(allow_inf_nan=False)

    translation_m: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]

    @model_validator(mode="after")
    def _unit_quaternion(self) -> Self:
        norm = float(np.linalg.norm(self.quaternion_xyzw))
        if not abs(norm - 1.0) <= 1e-3:
            raise ValueError(f"quaternion_xyzw has norm {norm:.6g}, expected 1")
        return self

    @property
    def matrix(self) -> Array:
        """(4, 4)"""
        return transform_from_tq(self.translation_m, self.quaternion_xyzw)

    @classmethod
    def of(cls, matrix: Array) -> Transform:
        """The transform with a (4, 4) matrix."""
        t, q = transform_to_tq(matrix)
        return cls.model_validate({"translation_m": t.tolist(), "quaternion_xyzw": q.tolist()})


class Condition(Strict):
    """Weather, season and time of day of one traversal."""

    weather: Line = "unknown"
    season: Line = "unknown"
    time_of_day: Line = "unknown"
    tags: tuple[Line, ...] = ()

    def __str__(self) -> str:
        known = [v for v in (self.weather, self.season, self.time_of_day) if v != "unknown"]
        return ", ".join([*known, *self.tags]) or "unknown"


class CameraEntry(Strict):
    """One camera of a rig."""

    model: Literal["pinhole", "radtan", "equidistant"]
    width: int = Field(ge=1)
    height: int = Field(ge=1)
    fx: float = Field(gt=0, allow_inf_nan=False)
    fy: float = Field(gt=0, allow_inf_nan=False)
    cx: float = Field(allow_inf_nan=False)
    cy: float = Field(allow_inf_nan=False)
    distortion: tuple[float, ...] = ()
    T_rig_cam: Transform
    depth_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """sigma of a dense depth z is a + b z + c z^2, metres"""

    @model_validator(mode="after")
    def _possible_camera(self) -> Self:
        self.camera  # noqa: B018  raises ValueError on the wrong number of coefficients
        return self

    @property
    def camera(self) -> Camera:
        return camera_from_dict(self.model_dump())

    @classmethod
    def of(
        cls, camera: Camera, T_rig_cam: Array | None = None, depth_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> CameraEntry:
        """The entry for a camera with (4, 4) extrinsics (default: identity) and depth noise."""
        transform = Transform.of(np.eye(4) if T_rig_cam is None else T_rig_cam)
        return cls.model_validate({**camera.to_dict(), "T_rig_cam": transform.model_dump(), "depth_sigma": depth_sigma})


class ClockEntry(Strict):
    """What the images say of the clock of the poses: an image at time t has the pose at t + offset.

    Of rendered images it is what the renderer knows.
    """

    model_config = ConfigDict(allow_inf_nan=False)

    applied_s: float
    """seconds that were added to the images' times to find their poses"""
    verdict: Literal["one clock", "offset", "contradiction", "cannot tell"]
    offset_s: float | None = None
    """as estimated, against the poses as they were recorded"""
    sigma_s: float | None = None
    readout_s: float | None = None
    """from the first row of an image to the last, where a camera reads its rows one after the other"""
    how: Line = ""
    """what each method found, or why nothing can be told"""


class TraversalFile(Strict):
    """The content of ``traversal.yaml``."""

    name: str
    condition: Condition = Condition()
    location: str = ""
    rate_hz: float | None = None
    cameras: dict[str, CameraEntry]
    frames: dict[str, Transform] = {}
    """``T_rig_frame`` of frames that have poses and no images; a pair set names one where others name a camera"""
    source: str = ""
    """what it was imported from, in words"""
    clock: ClockEntry | None = None
    """how the times of images and poses were brought together; None for kinds whose poses are those of the images"""

    @field_validator("name")
    @classmethod
    def _plain_name(cls, name: str) -> str:
        return check_name(name, "traversal name")

    @field_validator("cameras")
    @classmethod
    def _plain_cameras(cls, cameras: dict[str, CameraEntry]) -> dict[str, CameraEntry]:
        for name in cameras:
            check_name(name, "camera name")
        check_distinct(cameras, "camera names")
        return cameras

    @model_validator(mode="after")
    def _plain_frames(self) -> Self:
        for name in self.frames:
            check_name(name, "frame name")
        check_distinct([*self.cameras, *self.frames], "names of cameras and frames")
        return self

    def T_rig(self, name: str) -> Array:
        """(4, 4) pose on the rig of a camera, or of a frame without images. Raises KeyError if there is none."""
        return (self.frames.get(name) or self.cameras[name].T_rig_cam).matrix

    @model_serializer(mode="wrap")
    def _without_empty_frames(self, usual: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Descriptions without frames and clock are written, and digested, as earlier versions did."""
        values: dict[str, Any] = usual(self)
        if not self.frames:
            values.pop("frames", None)
        if self.clock is None:
            values.pop("clock", None)
        return values


class DatasetFile(Strict):
    """The content of ``dataset.yaml``."""

    format_version: int
    name: JoinedName
    licence: str = "unknown"
    made_by: dict[str, Any] = {}
    """command, configuration, seed, versions"""
    splits: dict[Name, tuple[JoinedName, ...]] = {}
    """split name -> pair sets"""
    fingerprint: Fingerprint
    """SHA-256 of everything that can change a score"""

    @field_validator("format_version")
    @classmethod
    def _known_version(cls, version: int) -> int:
        if version not in _VERSIONS:
            expected = ", ".join(map(str, _VERSIONS))
            raise ValueError(f"format_version {version} is not supported, expected one of {expected}")
        return version

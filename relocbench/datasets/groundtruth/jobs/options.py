"""The options that all importers share which build ground truth from lidar.

They are checked before anything large is loaded: what they are for is imported where it is made of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from relocbench.datasets.core.build_options import ImportOptions

if TYPE_CHECKING:
    from relocbench.datasets.groundtruth.alignment.two_drives import AlignmentOptions
    from relocbench.datasets.groundtruth.pairs.outcome import OutcomeLimits

_OF_OWN_RECIPE = ("matcher", "icp", "calibration", "max_sigma", "max_sigma_rotation")
"""options of steps that the plain recipe with Open3D does not have"""


class FieldOptions(ImportOptions):
    """The options of the build that a user can set."""

    LATER = ("recipe", "scale")

    cameras: tuple[str, ...] = Field(
        (),
        description="cameras whose images are paired, or none for poses of the rig; default: the first one, if any",
    )
    keyframe_distance: float = Field(1.0, gt=0, description="metres of road between keyframes of the reference")
    query_distance: float = Field(1.0, gt=0, description="metres of road between images (or poses) of a query drive")
    submap: float = Field(60.0, ge=10, le=300, description="metres of road in a submap, enlarged (--scale)")
    depth_submap: float = Field(
        60.0, ge=10, le=300, description="metres of road in a submap that depth is drawn from, enlarged"
    )
    depth: Literal["lidar", "stereo"] = Field(
        "lidar", description="source of depth; stereo needs a second camera, rectified with the first"
    )
    recipe: Literal["own", "open3d"] = Field(
        "own",
        description="own: submaps, verified and solved for in one graph; open3d, for comparison: pairs by Open3D, each "
        "from the one before, none verified",
    )
    matcher: Literal["ransac", "fgr", "kiss-matcher"] = Field(
        "ransac", description="method of place recognition by features (kiss-matcher needs the extra 'registration')"
    )
    icp: Literal["own", "open3d", "small_gicp"] = Field(
        "own", description="implementation of ICP (small_gicp needs the extra 'registration')"
    )
    first_pose: str = Field(
        "",
        description="pose of a pair by hand: 'REF_NS QUERY_NS tx ty tz qx qy qz qw', T_ref_query of the rigs; verified",
    )
    calibration: Literal["estimate", "given"] = Field(
        "estimate",
        description="estimate the time offsets and extrinsics of the lidars and correct errors, or take what is given",
    )
    scale: Literal["auto"] | Annotated[float, Field(ge=1e-4, le=1e4)] = Field(
        "auto",
        description="enlarge the scene so many times to the size of a street; auto: by its size and noise, and streets "
        "stay as they are",
    )
    use_prior: bool = Field(True, description="limit place recognition by GNSS")
    max_sigma: float = Field(
        0.05,
        gt=0,
        description="largest sigma of an accepted pair's position on each axis, metres; if it is not given, it is "
        "divided by the factor of a scene that is enlarged",
    )
    max_sigma_rotation: float = Field(0.15, gt=0, description="largest sigma of its rotation, degrees")

    @model_validator(mode="after")
    def _recipe_has_none_of_these(self) -> Self:
        given = [name for name in _OF_OWN_RECIPE if name in self.model_fields_set]
        if self.recipe == "open3d" and given:
            raise ValueError(f"recipe open3d does not use {', '.join(given)}; leave out one or the other")
        return self

    def recorded(self) -> dict[str, Any]:
        """The options without those that the recipe does not use."""
        unused = () if self.recipe == "own" else _OF_OWN_RECIPE
        return {name: value for name, value in super().recorded().items() if name not in unused}

    @property
    def without_images(self) -> bool:
        """Whether poses of the rig are wanted alone."""
        return self.cameras == ("none",)

    @property
    def alignment(self) -> AlignmentOptions:
        """The options for aligning two drives."""
        from relocbench.datasets.groundtruth.alignment.two_drives import AlignmentOptions
        from relocbench.datasets.groundtruth.registration.along_drive import DriveRegistrationOptions
        from relocbench.datasets.groundtruth.registration.global_registration import GlobalOptions
        from relocbench.datasets.groundtruth.registration.submap_pair import RegisterOptions

        registration = DriveRegistrationOptions(
            register=RegisterOptions(backend=self.icp),
            search=GlobalOptions(matcher=self.matcher, seeds=tuple(range(3 * self.seed, 3 * self.seed + 3))),
        )
        return AlignmentOptions(submap_m=self.submap, registration=registration)

    def max_sigma_at(self, factor: float) -> float:
        """Largest sigma of a position in a scene that is enlarged, in metres that are not.

        Five centimetres are a share of a street, and a smaller scene is asked for the same share; what is given by hand
        is meant as it is. A larger scene is asked for no less.
        """
        return self.max_sigma if "max_sigma" in self.model_fields_set else self.max_sigma / max(factor, 1.0)

    def limits_at(self, factor: float) -> OutcomeLimits:
        """The limits within which pairs are accepted, in enlarged metres."""
        from relocbench.datasets.groundtruth.pairs.outcome import OutcomeLimits

        return OutcomeLimits(
            distance_m=self.max_distance * factor,
            sigma_m=self.max_sigma_at(factor) * factor,
            sigma_rotation_deg=self.max_sigma_rotation,
        )

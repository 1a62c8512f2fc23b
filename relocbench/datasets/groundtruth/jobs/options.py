"""Options of every importer that builds ground truth from lidar."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.groundtruth.alignment.two_drives import AlignmentOptions
from relocbench.datasets.groundtruth.pairs.outcome import OutcomeLimits
from relocbench.datasets.groundtruth.registration.along_drive import DriveRegistrationOptions
from relocbench.datasets.groundtruth.registration.global_registration import GlobalOptions
from relocbench.datasets.groundtruth.registration.submap_pair import RegisterOptions


class FieldOptions(ImportOptions):
    """What a user may choose; the rest has one good value."""

    cameras: tuple[str, ...] = Field((), description="cameras whose images are paired; default: the first there is")
    keyframe_distance: float = Field(1.0, gt=0, description="metres of road between keyframes of the reference")
    query_distance: float = Field(1.0, gt=0, description="metres of road between images of a query drive")
    submap: float = Field(60.0, ge=10, le=300, description="metres of road that a submap shows")
    depth_submap: float = Field(60.0, ge=10, le=300, description="metres of road that a keyframe's depth is drawn from")
    depth: Literal["lidar", "stereo"] = Field(
        "lidar", description="where depth comes from; stereo needs a second camera, rectified with the first"
    )
    matcher: Literal["ransac", "fgr", "kiss-matcher"] = Field(
        "ransac", description="search for the first pair and for lost ones (kiss-matcher: of the extra 'registration')"
    )
    icp: Literal["own", "open3d", "small_gicp"] = Field(
        "own", description="refinement of registrations (small_gicp: of the extra 'registration')"
    )
    first_pose: str = Field(
        "",
        description="the first pair by hand: 'REF_NS QUERY_NS tx ty tz qx qy qz qw', T_ref_query of the rigs; checked",
    )
    use_prior: bool = Field(True, description="let GNSS limit the search for the first pair")
    max_sigma: float = Field(
        0.05, gt=0, description="a pair whose position is less certain than this along, across or above is rejected"
    )
    max_sigma_rotation: float = Field(0.15, gt=0, description="the same for its rotation, degrees")

    @model_validator(mode="after")
    def _only_nearest(self) -> FieldOptions:
        if self.pair_rule == "step":
            raise ValueError("pair_rule: drives of different days are paired by the nearest keyframe, not by steps")
        return self

    @property
    def alignment(self) -> AlignmentOptions:
        """For the registration of drives."""
        registration = DriveRegistrationOptions(
            register=RegisterOptions(backend=self.icp),
            search=GlobalOptions(matcher=self.matcher, seeds=tuple(range(3 * self.seed, 3 * self.seed + 3))),
        )
        return AlignmentOptions(submap_m=self.submap, registration=registration)

    @property
    def limits(self) -> OutcomeLimits:
        """For the outcome of pairs."""
        return OutcomeLimits(
            distance_m=self.max_distance,
            sigma_along_m=self.max_sigma,
            sigma_across_m=self.max_sigma,
            sigma_height_m=self.max_sigma,
            sigma_rotation_deg=self.max_sigma_rotation,
        )

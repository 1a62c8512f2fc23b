"""Dense depth from a rectified stereo pair by semi-global matching."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from relocbench.arrays import Floats, Image
from relocbench.datasets.core.images import as_grey

DISPARITY_SIGMA = 0.5
"""pixels; sigma_z = z^2 sigma_d / (f b). Against the lidar of KITTI the median error of this matcher is 0.4 px."""
_BLOCK = 5
_SMOOTH, _JUMP = 8 * _BLOCK**2, 32 * _BLOCK**2
"""penalties for disparity changes by one and by more (Hirschmueller 2008; OpenCV's recommendation for one channel)"""


@dataclass(frozen=True)
class StereoGeometry:
    """Geometry of a rectified stereo pair, relative to the left camera."""

    focal_baseline: float
    """f b, pixels times metres"""
    centre_offset: float = 0.0
    """cx of the left minus cx of the right camera, pixels; the disparity at infinity"""
    max_depth: float = 80.0
    """metres"""
    max_disparity: int = 128
    """pixels searched, a multiple of 16; nearer surfaces are not found"""

    @property
    def depth_sigma(self) -> tuple[float, float, float]:
        """(a, b, c) of sigma_z = a + b z + c z^2."""
        return 0.0, 0.0, DISPARITY_SIGMA / self.focal_baseline


def stereo_depth(left: Image, right: Image, geometry: StereoGeometry) -> Floats:
    """Depth (H, W) of the left image in metres along z, 0 where unknown.

    A match is kept if the match from the right image agrees within a pixel, if it is 10 % better than any other, and if
    it is not part of a speckle.
    """
    disparity = _match(as_grey(left), as_grey(right), geometry.max_disparity) - np.float32(geometry.centre_offset)
    known = disparity > geometry.focal_baseline / geometry.max_depth
    depth = np.zeros(disparity.shape, dtype=np.float32)
    depth[known] = geometry.focal_baseline / disparity[known]
    return depth


def _match(left: Image, right: Image, count: int) -> Floats:
    """Disparity (H, W) in pixels, negative where unknown."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=_BLOCK,
        P1=_SMOOTH,
        P2=_JUMP,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=10,
        speckleWindowSize=300,
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    # The matcher skips as many columns on the left as it searches disparities, so pad the images by that many.
    padded = [cv2.copyMakeBorder(image, 0, 0, count, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
    disparity = np.asarray(matcher.compute(*padded))[:, count:].astype(np.float32) / np.float32(16.0)
    # A match in the padding is not valid.
    beyond = disparity > np.arange(disparity.shape[1], dtype=np.float32)
    return np.where((disparity <= 0) | beyond, np.float32(-1.0), disparity)

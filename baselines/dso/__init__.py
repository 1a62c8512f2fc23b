"""Direct tracking on raw intensities: the coarse tracker of Direct Sparse Odometry as a relocalization tracker."""

from baselines.dso.tracker import Dso, DsoMultiStart, DsoReference, small_rotations

__all__ = ["Dso", "DsoMultiStart", "DsoReference", "small_rotations"]

"""Direct alignment of raw intensities: the coarse tracker of Direct Sparse Odometry as a relocalization tracker."""

from baselines.alignment import small_rotations
from baselines.dso.tracker import Dso, DsoMultiStart, DsoReference

__all__ = ["Dso", "DsoMultiStart", "DsoReference", "small_rotations"]

"""Direct alignment of raw intensities: the coarse tracker of Direct Sparse Odometry as a relocalization tracker."""

from baselines.dso.tracker import Dso, DsoMultiStart

__all__ = ["Dso", "DsoMultiStart"]

"""The scratch block that the stages of a kernel share: one row for each quantity, one column for each point.

A kernel processes its points in blocks that fit into the first-level cache. The rows named here are written by
:mod:`~baselines.alignment.shared.warp` or read by :mod:`~baselines.alignment.shared.normal_equations`; an engine may
append rows of its own.
"""

BLOCK = 128
"""points in a block"""

U, V, ID, PX, PY, VALID = 0, 1, 2, 3, 4, 5
"""normalised coordinates and inverse depth (1/m) in the query camera, the query pixel, 1 if the point is valid"""
AXX, AXY, AYY, BX, BY = 6, 7, 8, 9, 10
"""A and b of :mod:`~baselines.alignment.shared.normal_equations`"""
SHARED_ROWS = 11

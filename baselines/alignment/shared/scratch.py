"""The scratch block: what one stage of a kernel hands to the next, one row a quantity and one column a point.

A kernel works on its points in blocks that stay in the first-level cache. The rows named here are written by
:mod:`~baselines.alignment.shared.warp` or read by :mod:`~baselines.alignment.shared.normal_equations`; an engine that
needs more of its own puts them behind.
"""

BLOCK = 128
"""points at a time"""

U, V, ID, PX, PY, VALID = 0, 1, 2, 3, 4, 5
"""normalised coordinates and inverse depth (1/m) in the query camera, pixel in the query, 1 if the point is valid"""
AXX, AXY, AYY, BX, BY = 6, 7, 8, 9, 10
"""the symmetric 2x2 tensor A = sum w g g^T and the 2-vector b = sum w g r over the channels of a point, with g the
gradient times the focal lengths"""
SHARED_ROWS = 11

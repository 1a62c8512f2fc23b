"""The types of the arrays that all modules share, by what their elements are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Indices = NDArray[np.int64]
"""rows of something, identifiers, counts"""
Times = NDArray[np.int64]
"""nanoseconds"""
Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]
Bytes = NDArray[np.uint8]
"""packed data, or a small number of each point: its surface, material, sensor"""

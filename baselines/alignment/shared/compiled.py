"""Flags and types of the compiled functions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
Number = float | np.floating[Any]

FAST = {"reassoc", "nsz", "arcp", "contract"}
"""fast-math flags; NaN and infinity keep their meaning, which the validity test relies on"""

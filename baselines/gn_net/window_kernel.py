"""Distances of features to the pixels of small windows, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.alignment.shared.compiled import FAST
from relocbench.kernels import njit


@njit(cache=True, fastmath=FAST, error_model="numpy")
def add_window_distances(
    values: NDArray[Any], level_map: NDArray[Any], coarser: int, corners: NDArray[Any], distances: NDArray[Any]
) -> None:
    """Add ``||F(u) - f_m||^2`` for each pixel u of each window, with F interpolated bilinearly.

    Args:
        values: (M, D) float32 features f.
        level_map: (H, W, D) float32, F.
        coarser: the side, in pixels of the windows' level, of a pixel of the map: 1, 2, 4, ...
        corners: (M, 2) int64 first column and row of each window; pixels beyond the border are moved onto it.
        distances: (M, K, K) float32, added to.
    """
    height, width, channels = level_map.shape
    side = distances.shape[1]
    one, half = np.float32(1), np.float32(0.5)
    scale = one / np.float32(coarser)
    last_u, last_v = np.float32(width - 1), np.float32(height - 1)
    for m in range(len(values)):
        for i in range(side):
            v = min(max((np.float32(corners[m, 1] + i) + half) * scale - half, np.float32(0)), last_v)
            iv = int(v)
            jv = min(iv + 1, height - 1)
            av = v - np.float32(iv)
            for j in range(side):
                u = min(max((np.float32(corners[m, 0] + j) + half) * scale - half, np.float32(0)), last_u)
                iu = int(u)
                ju = min(iu + 1, width - 1)
                au = u - np.float32(iu)
                w00, w01 = (one - av) * (one - au), (one - av) * au
                w10, w11 = av * (one - au), av * au
                total = np.float32(0)
                for c in range(channels):
                    f = (
                        w00 * level_map[iv, iu, c]
                        + w01 * level_map[iv, ju, c]
                        + w10 * level_map[jv, iu, c]
                        + w11 * level_map[jv, ju, c]
                        - values[m, c]
                    )
                    total += f * f
                distances[m, i, j] += total

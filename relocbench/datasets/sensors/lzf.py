"""LZF, by which ``binary_compressed`` PCD files are packed.

Format: M. Lehmann, liblzf. A byte below 32 is followed by that many + 1 bytes to copy. Any other tells bytes to repeat:
its upper three bits + 2 how many (where all three are set, the next byte is added), its lower five bits and the next
byte how far back, + 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relocbench.kernels import njit

RATIO = 88
"""bytes that one packed byte can stand for at most: three repeat up to 264"""


def decompress(packed: NDArray[np.uint8], size: int) -> NDArray[np.uint8] | None:
    """(size,) bytes, or None where the packed ones do not make exactly so many."""
    out = np.empty(size, dtype=np.uint8)
    return out if _unpack(packed, out) else None


@njit(cache=True, nogil=True)
def _unpack(packed: NDArray[np.uint8], out: NDArray[np.uint8]) -> bool:
    i, o = np.int64(0), np.int64(0)
    while i < packed.size:
        control = np.int64(packed[i])
        i += 1
        if control < 32:
            run = control + 1
            if i + run > packed.size or o + run > out.size:
                return False
            out[o : o + run] = packed[i : i + run]
            i += run
            o += run
            continue
        length = control >> 5
        if length == 7:
            if i >= packed.size:
                return False
            length += np.int64(packed[i])
            i += 1
        if i >= packed.size:
            return False
        start = o - ((control & 31) << 8) - np.int64(packed[i]) - 1
        i += 1
        length += 2
        if start < 0 or o + length > out.size:
            return False
        for k in range(length):  # what is repeated may reach into what is being written
            out[o + k] = out[start + k]
        o += length
    return bool(o == out.size)

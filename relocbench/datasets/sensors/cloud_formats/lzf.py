"""Decompression of LZF, which ``binary_compressed`` PCD files use.

Format: M. Lehmann, liblzf. A control byte below 32 is followed by that many + 1 literal bytes. Any other control byte
refers back to earlier output: its upper three bits + 2 are the length (if all three are set, the next byte is added to
it), its lower five bits and the next byte + 1 the distance.
"""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Bytes
from relocbench.kernels import njit

RATIO = 88
"""greatest ratio of unpacked to packed bytes: three bytes can refer back to 264"""


def decompress(packed: Bytes, size: int) -> Bytes | None:
    """Unpack to (size,) bytes; None if the packed data do not give exactly this size."""
    out = np.empty(size, dtype=np.uint8)
    return out if _unpack(packed, out) else None


@njit(cache=True, nogil=True)
def _unpack(packed: Bytes, out: Bytes) -> bool:
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
        for k in range(length):  # byte by byte, since the source may overlap the bytes being written
            out[o + k] = out[start + k]
        o += length
    return bool(o == out.size)

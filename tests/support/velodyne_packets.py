"""Packets of a Velodyne HDL-32E, written byte by byte from its published layout.

Velodyne, HDL-32E User's Manual (63-9113) and Application Note 63-9277, Packet Structure and Timing Definition: a packet
is 12 blocks of ``FF EE``, the azimuth in hundredths of a degree and 32 returns of two bytes of range in steps of 2 mm
and one of intensity, then four bytes of microseconds since the hour, the return mode (0x37 strongest, 0x38 last, 0x39
both) and the product (0x21). Beams are fired every 1.152 us and a block takes 46.08 us. Azimuths grow clockwise seen
from above. With both returns, pairs of blocks have one azimuth: first the last returns, then the strongest.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np

from relocbench.arrays import Array, Indices

FIRING_US, BLOCK_US, PACKET_US = 1.152, 46.08, 12 * 46.08
STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
ELEVATION_DEG = np.array([[-30.67 + 4 / 3 * k, -9.33 + 4 / 3 * k] for k in range(16)]).ravel()
"""of each beam in the order of firing (table of the manual)"""
RangesOf = Callable[[Array, Array, Array], Array]
"""ranges in metres, 0 without a return, of azimuths in degrees, elevations in degrees, and seconds from the begin"""


def packet(
    azimuths: Indices,
    ranges: Array,
    clock_us: int,
    mode: int = STRONGEST,
    product: int = 0x21,
) -> bytes:
    """A packet.

    Args:
        azimuths: (12,) hundredths of a degree.
        ranges: (12, 32) metres.
    """
    out = b""
    for azimuth, row in zip(azimuths.tolist(), ranges, strict=True):
        out += struct.pack("<HH", 0xEEFF, azimuth % 36000)
        for metres in np.rint(row / 0.002).astype(int).tolist():
            out += struct.pack("<HB", metres if 0 <= metres < 65536 else 0, 100)
    out += struct.pack("<IBB", clock_us % 3_600_000_000, mode, product)
    assert len(out) == 1206
    return out


def turn_of(ranges_of: RangesOf, hz: float, begin_us: int, start_deg: float = 0.0) -> list[tuple[int, bytes]]:
    """One turn: the microseconds at which each packet begins, and the packet.

    Args:
        begin_us: when the turn begins, since the hour.
        start_deg: azimuth at which it begins.
    """
    out, count = [], int(1e6 / hz / PACKET_US)
    for number in range(count):
        block = np.arange(12) * BLOCK_US + number * PACKET_US
        at = (block[:, None] + np.arange(32) * FIRING_US) * 1e-6
        azimuth = start_deg + 360 * hz * at
        ranges = ranges_of(azimuth, np.broadcast_to(ELEVATION_DEG, at.shape), at)
        blocks = np.rint((start_deg + 360 * hz * block * 1e-6) * 100).astype(np.int64)
        at_us = begin_us + round(number * PACKET_US)
        out.append((at_us, packet(blocks, ranges, at_us)))
    return out

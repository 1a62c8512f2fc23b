"""Points of VelodyneScan messages: raw packets of a Velodyne, decoded by the package velodyne-decoder.

A packet has 1206 bytes, little-endian (Velodyne HDL-32E and VLP-16 user manuals): 12 blocks of a flag, an azimuth in
hundredths of a degree and 32 returns (range in units that depend on the model, intensity); then the microseconds since
the hour on the sensor's clock, the return mode and the model. The package knows the angles of the beams and when each
of them is fired within a packet. Points have the axes of the ROS driver: x along azimuth 0, y left, z up.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.importers.rosbag.bag import stamp_ns
from relocbench.errors import ConfigError, DatasetError

_BYTES = 1206
_HOUR_US = 3_600_000_000
_HDL_32E = 0x21
_MODELS = {_HDL_32E: "HDL-32E", 0x22: "VLP-16", 0x24: "Puck Hi-Res", 0x28: "VLP-32C", 0xA1: "VLS-128"}
"""the last byte of a packet; HDL-32E before firmware 2.2.20 and all HDL-64E have others there"""
_STRONGEST = 0x37
_MODES = (_STRONGEST, 0x38, 0x39)
_SAME_CLOCKS = 0.02
"""the sensor's clock is used if it tells the length of a scan like the stamps, up to this part and 5 ms"""
_FAR_NS = 2_000_000_000


@dataclass(frozen=True)
class PacketReading:
    """What packets do not tell themselves."""

    hdl_32e: bool = False
    """packets that name no model are those of an HDL-32E"""
    calibration: Path | None = None
    """calibration of the beams in the format of the ROS driver; None: that of the model"""


def packet_points(message: Any, how: PacketReading) -> tuple[Array, Times]:
    """Points (N, 3) in metres of a scan, and the nanoseconds (N,) from its stamp at which their beams were fired.

    A packet's stamp is taken for the time of its first firing. The sensor's own clock tells the times between packets,
    since the host's stamps jitter; where it makes no sense, the stamps do.

    Args:
        message: an object with the fields of ``velodyne_msgs/VelodyneScan``.

    Raises:
        ValueError: a packet is damaged, its model is not known, or its time is more than two seconds from the scan's.
        DatasetError: the calibration cannot be read.
        ConfigError: velodyne-decoder is not installed.
    """
    library, packets = _library(), list(message.packets)
    if not packets:
        return np.empty((0, 3)), np.empty(0, dtype=np.int64)
    stamps = np.array([stamp_ns(packet.stamp) for packet in packets], dtype=np.int64)
    data = [_checked(np.asarray(packet.data, dtype=np.uint8).tobytes(), how) for packet in packets]
    begin_ns, since_s = _firing_times(stamps, data)
    scan_ns = stamp_ns(message.header.stamp) or int(stamps[-1])
    if abs(begin_ns - scan_ns) > _FAR_NS:
        raise ValueError(f"its packets begin {(begin_ns - scan_ns) / 1e9:.1f} s from the scan's stamp")
    vector = library.PacketVector()
    for seconds, raw in zip(since_s.tolist(), data, strict=True):
        vector.append(library.VelodynePacket(library.TimePair(seconds, seconds), list(raw)))
    try:
        found = _decoder(how.calibration).decode(vector, True)[1]
    except RuntimeError as bad:
        raise ValueError(f"its packets cannot be decoded ({bad})") from None
    points = np.column_stack([found[axis] for axis in "xyz"]).astype(np.float64)
    return points, begin_ns - scan_ns + np.rint(found["time"].astype(np.float64) * 1e9).astype(np.int64)


def check_calibration(path: Path) -> None:
    """Raise DatasetError if a calibration of the beams cannot be read."""
    _decoder(path)


def _checked(raw: bytes, how: PacketReading) -> bytes:
    """A packet that names its model."""
    if len(raw) != _BYTES:
        raise ValueError(f"a packet has {len(raw)} bytes, expected {_BYTES}")
    if raw[-1] in _MODELS:
        if how.hdl_32e and raw[-1] != _HDL_32E:
            raise ValueError(f"a packet is of a {_MODELS[raw[-1]]}, expected HDL-32E")
        return raw
    if not how.hdl_32e:
        raise ValueError(f"a packet is of an unknown model ({raw[-1]:#04x}); known are {', '.join(_MODELS.values())}")
    return raw[:-2] + bytes([raw[-2] if raw[-2] in _MODES else _STRONGEST, _HDL_32E])


def _firing_times(stamps: Times, data: Sequence[bytes]) -> tuple[int, Array]:
    """Time of the first packet in nanoseconds, and the seconds (P,) from it to each packet."""
    clock = np.array([struct.unpack_from("<I", raw, _BYTES - 6)[0] for raw in data], dtype=np.int64)
    by_sensor = np.mod(clock - clock[0], _HOUR_US) * 1000
    by_stamp = stamps - stamps[0]
    span = int(by_stamp[-1])
    same = abs(int(by_sensor[-1]) - span) <= _SAME_CLOCKS * abs(span) + 5_000_000
    if same and (len(data) == 1 or np.all(np.diff(by_sensor) > 0)):
        return int(np.median(stamps - by_sensor)), by_sensor / 1e9
    if np.any(np.abs(by_stamp) > _FAR_NS):
        raise ValueError(f"its packets are {np.abs(by_stamp).max() / 1e9:.1f} s apart")
    return int(stamps[0]), by_stamp / 1e9


def _library() -> Any:
    try:
        from velodyne_decoder import velodyne_decoder_pylib
    except ImportError:
        raise ConfigError(
            "reading packets of a Velodyne needs the package 'velodyne-decoder', which is not installed here (the "
            "extra 'bags' brings it)"
        ) from None
    return velodyne_decoder_pylib


def _decoder(calibration: Path | None) -> Any:
    """A decoder, whose model is that of the packets that it gets."""
    library = _library()
    chosen = {} if calibration is None else {"calibration": _calibration(calibration)}
    # Points out of range are left out by the stream, like those of other messages.
    settings = library.Config(min_range=0.0, max_range=1e6, timestamp_first_packet=True, **chosen)
    return library.ScanDecoder(settings)


@lru_cache(maxsize=4)
def _calibration(path: Path) -> Any:
    if not path.is_file():
        raise DatasetError("missing; expected a calibration of the beams, as the ROS driver of Velodyne reads it", path)
    try:
        return _library().Calibration.read(str(path))
    except Exception as bad:  # noqa: BLE001  what the parser of a damaged file raises is open
        message = " ".join(str(bad).split())
        raise DatasetError(f"is not a calibration of the beams of a Velodyne ({message[:200]})", path) from None

"""Lidars that are another lidar with something changed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from relocbench.arrays import Array, Times
from relocbench.datasets.sensors.recording import LidarStream, Scan


@dataclass(frozen=True, eq=False)
class DerivedLidar:
    """A :class:`LidarStream` that is another one; classes derived from it say what they change."""

    stream: LidarStream

    @property
    def name(self) -> str:
        return self.stream.name

    @property
    def pattern(self) -> Literal["push-broom", "spinning"]:
        return self.stream.pattern

    @property
    def T_rig_lidar(self) -> Array:
        """(4, 4)"""
        return self.stream.T_rig_lidar

    @property
    def times_ns(self) -> Times:
        """(M,)"""
        return self.stream.times_ns

    @property
    def max_range_m(self) -> float:
        return self.stream.max_range_m

    @property
    def sigma_m(self) -> float:
        return self.stream.sigma_m

    def read(self, index: int) -> Scan:
        """Read a scan. Raises DatasetError with the file if it is missing or damaged."""
        return self.stream.read(index)

"""What all parts of the reading of one bag share: its topics, index, frames and rig, and the times of its messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Times
from relocbench.datasets.importers.rosbag.extrinsics import Extrinsics
from relocbench.datasets.importers.rosbag.frames import BASES, Frames
from relocbench.datasets.importers.rosbag.index import Index, read_index
from relocbench.datasets.importers.rosbag.packets import PacketReading
from relocbench.datasets.importers.rosbag.roles import Roles, Wanted
from relocbench.datasets.importers.rosbag.stamps import Stamps, check_one_run, times_of
from relocbench.datasets.importers.rosbag.streams import Messages
from relocbench.datasets.importers.rosbag.survey import Survey
from relocbench.datasets.sensors.point_times import PointTimes
from relocbench.errors import DatasetError, available
from relocbench.progress import Reporter

Pattern = Literal["auto", "spinning", "push-broom"]
ScanMotion = Literal["auto", "compensated", "distorted"]


@dataclass(frozen=True)
class BagSettings:
    """How bags are read: what the options of the command say, the same for all drives."""

    wanted: Wanted = field(default_factory=Wanted)
    base_frame: str = ""
    """empty: it is guessed"""
    extrinsics: Extrinsics = field(default_factory=Extrinsics)
    extrinsics_file: Path | None = None
    packets: PacketReading = field(default_factory=PacketReading)
    point_times: PointTimes | None = None
    """None: they are told from the values"""
    motion: ScanMotion = "auto"
    pattern: Pattern = "auto"
    min_range_m: float = 0.5
    max_range_m: float = 100.0
    sigma_m: float = 0.03
    stamps: Stamps = "header"
    max_gap_ns: int | None = None
    """longest gap between two poses to interpolate over, hole or not; None: one second, and no hole"""


@dataclass(frozen=True, eq=False)
class Opened:
    """A recording whose topics are chosen."""

    survey: Survey
    roles: Roles


class Reading:
    """One bag that is being read."""

    def __init__(self, opened: Opened, name: str, settings: BagSettings, kept: Path | None, reporter: Reporter) -> None:
        """Read or make the index, and decide which frame is the rig.

        Raises:
            DatasetError: a message is damaged, or there is no such frame.
            ConfigError: the extrinsics are of sensors that are not read.
        """
        self.survey, self.roles = opened.survey, opened.roles
        self.name, self.settings, self.reporter = name, settings, reporter
        self.source = self.survey.source
        if settings.extrinsics_file is not None:
            settings.extrinsics.check_used(self.roles, settings.extrinsics_file)
        self.index: Index = read_index(self.survey, self.roles.topics(), kept, reporter)
        self.frames = Frames(self.index.links, self.source)
        self.lags_ns: dict[str, float] = {}
        """topic -> median time from the stamp of a message to its receipt"""
        self.base = self._base_frame()

    def note(self, text: str) -> None:
        self.reporter.note(f"{self.name}: {text}")

    def times(self, topic: str, stamps: Times, received: Times) -> tuple[Times, Times]:
        """Times (M,) of the messages of a topic, strictly increasing, and the indices (M,) of these messages."""
        what = f"{self.name}: {topic}"
        if self.settings.stamps == "header":
            check_one_run(stamps, received, topic, self.source)
        times, kept, by_header = times_of(stamps, received, what, self.settings.stamps, self.reporter)
        if by_header and len(kept):
            self.lags_ns[topic] = float(np.median(received[kept] - stamps[kept]))
        return times, kept

    def messages(self, topic: str) -> tuple[Messages, Times]:
        """The scans or images of a topic, and their times (M,).

        Raises:
            DatasetError: fewer than two messages have a time of their own.
        """
        places = self.index.places[topic]
        times, kept = self.times(topic, places.stamps_ns, places.received_ns)
        if len(times) < 2:
            raise DatasetError(
                f"{topic} has {len(times)} messages of different times; expected at least 2", self.source
            )
        files = tuple(part.path for part in self.survey.parts)
        found = (places.part[kept], places.received_ns[kept], places.ordinal[kept])
        return Messages(files, topic, self.survey.topics[topic].type, *found), times

    def _base_frame(self) -> str:
        """The frame that is the rig: as named, else a vehicle's, that of the odometry, or that of the first lidar."""
        name, topic = next(iter(self.roles.lidars.items()))
        first = self.survey.topics[topic].frame
        poses = self.index.poses.get(self.roles.odometry)
        named = self.settings.base_frame.removeprefix("/")
        if named:
            known = {*self.frames.names(), first, poses.child if poses else ""}
            if named not in known:
                others = available(named, sorted(known - {""}))
                raise DatasetError(f"--base-frame: no frame {named!r}{others}", self.source)
            return named
        given = self.settings.extrinsics.lidar(name, topic) is not None
        for frame in (*BASES, poses.child if poses else ""):
            if frame and (frame == first or (frame in self.frames and (given or self.frames.connected(frame, first)))):
                self.note(f"the rig is the frame '{frame}'")
                return frame
        if given:
            return poses.child if poses and poses.child else "rig"
        self.note(f"the rig is the frame of the lidar, '{first}': no frame of a vehicle leads to it")
        return first

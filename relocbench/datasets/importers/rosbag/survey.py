"""What a recording holds: its topics with type, number of messages, rate, and what their first message tells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from relocbench.datasets.importers.rosbag import kinds
from relocbench.datasets.importers.rosbag.bag import Part, frame_name, open_parts
from relocbench.datasets.importers.rosbag.clouds import field_names
from relocbench.errors import DatasetError


@dataclass(frozen=True, eq=False)
class Topic:
    """One topic of a recording."""

    name: str
    type: str
    count: int
    rate_hz: float
    """messages a second over the whole recording"""
    frame: str = ""
    """frame of the first message's header"""
    fields: tuple[str, ...] = ()
    """fields of a cloud"""
    encoding: str = ""
    """encoding of an image, or the format of a compressed one"""
    fault: str = ""
    """why its first message cannot be read; such a topic is used only if it is named, and then it is an error"""


@dataclass(frozen=True, eq=False)
class Survey:
    """The topics of a recording, and the files that they are in."""

    source: Path
    parts: tuple[Part, ...]
    """ordered by time"""
    topics: dict[str, Topic]

    def of_types(self, types: Sequence[str]) -> list[Topic]:
        """The topics of some types that have messages which can be read, by name."""
        return [t for t in self.topics.values() if t.type in types and t.count and not t.fault]

    def first(self, topic: str) -> Any:
        """The first message of a topic, decoded. Raises DatasetError with the file."""
        for part in self.parts:
            if part.counts.get(topic):
                part.check_standard(topic)
                for _, received_ns, raw in part.messages([topic]):
                    return part.decode(topic, raw, received_ns)
        raise self.parts[0].fault(topic, 0, "there is none")


def survey(source: Path, paths: Sequence[Path]) -> Survey:
    """Look at a recording's topics and at one message of each that can be read.

    Raises:
        DatasetError: a file is damaged, or files are too far apart in time to be one drive.
    """
    parts = open_parts(paths)
    begin = min(part.begin_ns for part in parts if any(part.counts.values()))
    end = max(part.end_ns for part in parts if any(part.counts.values()))
    found = Survey(source, tuple(parts), {})
    names = sorted({name for part in parts for name in part.counts})
    for name in names:
        having = [part for part in parts if name in part.types]
        message_type = having[0].types[name]
        for part in having:
            if part.types[name] != message_type:
                raise part.fault(name, part.begin_ns, f"is of another type than in {having[0].path.name}")
        count = sum(part.counts[name] for part in having)
        rate = (count - 1) / ((end - begin) / 1e9) if count > 1 and end > begin else 0.0
        found.topics[name] = _peek(found, Topic(name, message_type, count, rate))
    return found


def _peek(found: Survey, topic: Topic) -> Topic:
    name, kind = topic.name, topic.type
    if not topic.count or kind not in kinds.READ or kind in kinds.ALL_TRANSFORMS:
        return topic
    try:
        message = found.first(name)
    except DatasetError as bad:
        file = "" if bad.path in (None, found.source) else f"{bad.path.name}: "
        return replace(topic, fault=f"{file}{bad.expected}")
    topic = replace(topic, frame=frame_name(str(message.header.frame_id)))
    if kind == kinds.CLOUD:
        return replace(topic, fields=field_names(message))
    if kind in kinds.CAMERAS:
        return replace(topic, encoding=str(message.encoding if kind == kinds.IMAGE else message.format))
    return topic

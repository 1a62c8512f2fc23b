"""The definitions of messages: those of ROS, with which messages are decoded, and those in a file, which may differ."""

from __future__ import annotations

from functools import lru_cache
from itertools import zip_longest
from typing import Any

from relocbench.datasets.importers.rosbag import kinds
from relocbench.errors import quoted


@lru_cache(maxsize=2)
def typestore(ros1: bool) -> Any:
    """The standard types. Those in the file are not used: a bag may hold definitions that nobody can read."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kinds.TRANSFORMS))
    stamp = "time" if ros1 else "builtin_interfaces/Time"
    packet = get_types_from_msg(f"{stamp} stamp\nuint8[1206] data", "velodyne_msgs/msg/VelodynePacket")
    scan = get_types_from_msg("std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets", kinds.PACKETS)
    store.register({**packet, **scan})
    return store


def standard_name(message_type: str) -> str:
    """The name by which a type is known here."""
    return kinds.TRANSFORMS if message_type == kinds.OLD_TRANSFORMS else message_type


def difference(connection: Any, message_type: str, ros1: bool) -> str:
    """How a connection defines a type otherwise than ROS, in words; empty if it does not.

    A right checksum decides, or else the definition. Without a definition the type is known by its name alone:
    converters write any checksum there, such as that of an empty text or zeros.

    Args:
        connection: a connection of a reader of rosbags; its definition and checksum may be missing.
        message_type: a type that :func:`typestore` has.
    """
    store, name = typestore(ros1), standard_name(message_type)
    if ros1:
        digest, expected = connection.digest, store.generate_msgdef(name)[1]
        if digest in ("", "*", expected):
            return ""
    definition = getattr(connection, "msgdef", None)
    text = str(getattr(definition, "data", "")).strip()
    if not text or getattr(definition.format, "name", "MSG") != "MSG":  # type: ignore[union-attr]
        return ""
    from rosbags.typesys import get_types_from_msg

    try:
        found = get_types_from_msg(text, name)
    except Exception:  # noqa: BLE001  what a definition that nobody can read raises is open
        return f"its checksum is {quoted(digest, 32)}, expected {expected}" if ros1 else ""
    for inner, (_, fields) in found.items():
        if inner in store.fielddefs:
            one, other = (
                [f"{_words(kind)} {field}" for field, kind in these] for these in (fields, store.fielddefs[inner][1])
            )
            for at, (has, wanted) in enumerate(zip_longest(one, other, fillvalue="nothing"), start=1):
                if has != wanted:
                    return f"field {at} of {kinds.short(inner)} is {quoted(has, 60)}, expected {quoted(wanted, 60)}"
    return ""


def _words(kind: Any) -> str:
    """A type of a field as definitions have it."""
    node, what = kind
    if node.name == "NAME":
        return kinds.short(what)
    if node.name == "BASE":
        return str(what[0])
    inner, length = what
    return f"{_words(inner)}[{length if node.name == 'ARRAY' else f'<={length}' if length else ''}]"

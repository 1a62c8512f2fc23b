"""The names of entities in a recording for rerun; the blueprint and the tests find them by these."""

from __future__ import annotations

import rerun as rr

PAIR_TIMELINE = "pair"
QUERY_TIMELINE = "query_time"
KEYFRAME, QUERY = "keyframe", "query_true"
METRES, DEGREES = "translation_error_m", "rotation_error_deg"


def path(*parts: str) -> str:
    """An entity's path; names from outside are escaped."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)


def world(name: str) -> str:
    """The world that traversals share, named after the first of them."""
    return path("worlds", name)


def traversal(world_name: str, name: str) -> str:
    """A traversal: ``/trajectory`` and the moving ``/rig``, which has the cameras."""
    return path("worlds", world_name, "traversals", name)


def pair_set(world_name: str, name: str) -> str:
    """The pairs of a set: ``/keyframe``, ``/query_true`` and ``/answers/METHOD``."""
    return path("worlds", world_name, "pairs", name)


def images(name: str, which: str) -> str:
    """The image of a set's keyframe or query, flat."""
    return path("images", name, which)


def error(what: str, name: str, *method: str) -> str:
    """The errors of a pair set's methods, or of one of them, on an axis of metres or of degrees."""
    return path("errors", what, name, *method)


def words(name: str) -> str:
    """What is told in words of a set's pair."""
    return path("told", name)

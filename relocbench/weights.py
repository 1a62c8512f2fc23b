"""What a method says about files that others publish and it needs: ``relocbench fetch-weights`` fetches them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable


@dataclass(frozen=True)
class PublishedFile:
    """A file that its authors publish, and that a method does not come with."""

    name: str
    """file name under which the method looks for it"""
    address: str
    """URL"""
    publisher: str
    """who publishes it there, and whose work it is if that is somebody else"""
    licence: str
    """of the file, as a name or in a few words"""
    sha256: str | None = None
    """hex digest of its content; None: none is known, and the file is fetched only with ``--unverified``"""
    size_bytes: int | None = None


@runtime_checkable
class SupportsFetching(Protocol):
    """Optional, a class method: the published files that a method needs with the given parameters.

    The result maps the path at which the method looks for each file to the file. Parameters are
    those of the constructor; those that name files are given too, and may be ignored.
    """

    def published(self, **parameters: Any) -> Mapping[Path, PublishedFile]: ...

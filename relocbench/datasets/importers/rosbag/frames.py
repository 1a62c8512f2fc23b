"""The frames of a recording: transforms between them that do not change, chained."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.rosbag.index import Poses
from relocbench.errors import DatasetError
from relocbench.geometry import invert, transform_from_tq

BASES = ("base_link", "base_footprint", "base", "vehicle", "body")
"""names that the frame of a vehicle has, most likely first (REP 105)"""
_STILL_M, _STILL_RAD = 1e-6, 1e-6


class Frames:
    """The tree of frames of one recording."""

    def __init__(self, links: Sequence[Poses], source: Path) -> None:
        """Args:
        links: transforms; those on ``/tf`` that never change count as fixed.
        """
        self.source = source
        self._near: dict[str, dict[str, Array]] = {}
        self.moving: list[Poses] = []
        """transforms that change, such as odometry"""
        for link in links:
            if link.static or _is_still(link):
                T_parent_child = transform_from_tq(link.values[-1, :3], link.values[-1, 3:])
                self._near.setdefault(link.parent, {})[link.child] = T_parent_child
                self._near.setdefault(link.child, {})[link.parent] = invert(T_parent_child)
            else:
                self.moving.append(link)

    def __contains__(self, frame: str) -> bool:
        return frame in self._near

    def names(self) -> list[str]:
        return sorted(self._near)

    def connected(self, dst: str, src: str) -> bool:
        """Whether a fixed transform between two frames is known."""
        return dst == src or self._path(dst, src) is not None

    def transform(self, dst: str, src: str) -> Array:
        """``T_dst_src`` (4, 4). Raises DatasetError naming both frames if they are not connected."""
        if dst == src:
            return np.eye(4)
        path = self._path(dst, src)
        if path is None:
            available = ", ".join(self.names()[:12]) or "none"
            raise DatasetError(
                f"has no fixed transform between {dst!r} and {src!r} in /tf_static or /tf (frames there: {available}); "
                "--extrinsics gives poses of sensors, --base-frame names another rig",
                self.source,
            )
        T = np.eye(4)
        for before, after in pairwise(path):
            T = T @ self._near[before][after]
        return T

    def _path(self, dst: str, src: str) -> list[str] | None:
        """The shortest way from one frame to another."""
        before: dict[str, str | None] = {dst: None}
        waiting = deque([dst])
        while waiting:
            frame = waiting.popleft()
            if frame == src:
                path = [frame]
                while (previous := before[path[-1]]) is not None:
                    path.append(previous)
                return path[::-1]
            for following in sorted(self._near.get(frame, {})):
                if following not in before:
                    before[following] = frame
                    waiting.append(following)
        return None


def _is_still(link: Poses) -> bool:
    """Whether a transform is the same all the time."""
    values = link.values
    if len(values) < 2:
        # A single transform on /tf may be the only pose of an odometry as well, which is of no use.
        return True
    apart = np.abs(values[:, :3] - values[0, :3]).max()
    turned = 1.0 - np.abs(values[:, 3:] @ values[0, 3:]) / (
        np.linalg.norm(values[:, 3:], axis=1) * np.linalg.norm(values[0, 3:])
    )
    return bool(apart <= _STILL_M and turned.max() <= _STILL_RAD**2)

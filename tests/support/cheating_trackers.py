"""Trackers that do not track: each tries to learn the pose from somewhere else than the images.

Each answers the identity where it learns nothing, so that it must not be better than that floor, and says in
``info["found"]`` what it has found.
"""

from __future__ import annotations

import gc
import inspect
import json
import os
import pwd
import secrets
import socket
import struct
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.evaluation.tables.matching import OFFSETS_PX
from relocbench.tracking import Query, Reference, TrackResult

SPACING_M = 0.15
"""between frames of the drives in the tests' dataset, which a cheat may know from training"""
STEP_NS = 100_000_000


def forward(metres: float) -> np.ndarray[Any, Any]:
    """``T_query_ref`` of a query that is so far ahead."""
    pose = np.eye(4)
    pose[2, 3] = -metres
    return pose


class Clock:
    """Knows how fast the drives go, and takes the pose from the times of the images."""

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        times = reference.timestamp_ns, query.timestamp_ns
        if times[0] is None or times[1] is None:
            return TrackResult(np.eye(4), info={"found": []})
        return TrackResult(forward(_since(times[1], times[0]) * SPACING_M), info={"found": ["times"]})


class DeclaredClock(Clock):
    """The same, which says that it uses times."""

    uses_times = True


class KeyReader:
    """Reads frame numbers from the keys of images."""

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        times = [int(part) for key in (reference.key, query.key) for part in key.split("/") if part.isdigit()]
        if len(times) != 2 or max(times) < 10**17:
            return TrackResult(np.eye(4), info={"found": []})
        return TrackResult(forward(_since(times[1], times[0]) * SPACING_M), info={"found": ["keys"]})


class Order:
    """Believes that it is asked about the drive from its start to its end, keyframe by keyframe."""

    def __init__(self) -> None:
        self._keyframes: list[str] = []
        self._asked = 0

    def prepare(self, reference: Reference) -> Reference:
        if reference.key not in self._keyframes:
            self._keyframes.append(reference.key)
            self._asked = 0
        return reference

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        at, self._asked = self._asked, self._asked + 1
        return TrackResult(np.eye(4), info={"keyframe": len(self._keyframes) - 1, "query": at, "key": query.key})


class Sorter:
    """Says of each pair what it is shown besides pixels, and how often it has seen the images, to sort pairs by."""

    def __init__(self) -> None:
        self._keyframes: list[str] = []
        self._queries: list[str] = []

    def prepare(self, reference: Reference) -> Reference:
        self._keyframes.append(reference.key)
        return reference

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        told = {
            "prior": None if prior is None else np.asarray(prior).tolist(),
            "times": [reference.timestamp_ns, query.timestamp_ns],
            "cameras": [repr(reference.camera), repr(query.camera)],
            "keys": [len(reference.key), len(query.key)],
            "neighbours": len(reference.neighbours),
            "fields": [sorted(vars(reference)), sorted(vars(query))],
        }
        seen = [self._keyframes.count(reference.key), self._queries.count(query.key)]
        self._queries.append(query.key)
        return TrackResult(np.eye(4), info={"told": told, "seen": seen})


class StackWalker:
    """Looks for a dataset, its truth or its path in frames, in all objects, and in what the system tells of itself."""

    def __init__(self) -> None:
        self._objects: list[str] | None = None

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        if self._objects is None:  # it takes seconds in a process that holds many
            self._objects = _in_objects()
        found = sorted({*_in_frames(), *self._objects, *_in_process()})
        return TrackResult(np.eye(4), info={"found": found})


def _in_frames() -> list[str]:
    names = {type(value).__name__ for frame in inspect.stack() for value in frame.frame.f_locals.values()}
    return [f"a {name} on the stack" for name in names & {"Dataset", "PairSet", "Unit", "Traversal", "MapTruth"}]


def _in_objects() -> list[str]:
    found = []
    for one in gc.get_objects():
        with suppress(Exception):
            if isinstance(one, Dataset | PairSet):
                found.append(f"a {type(one).__name__} in memory")
            if isinstance(one, Path) and _is_dataset(one):
                found.append("the path of a dataset in memory")
            if isinstance(one, dict):
                found += ["the path of a dataset in memory" for each in one.values() if _names_dataset(each)]
    return found


def _in_process() -> list[str]:
    found = ["the path of a dataset in the arguments" for word in sys.argv if _names_dataset(word)]
    found += ["the path of a dataset in the environment" for word in os.environ.values() if _names_dataset(word)]
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            if _names_dataset(descriptor.readlink()):
                found.append("an open file of a dataset")
    return found


def _names_dataset(value: Any) -> bool:
    return isinstance(value, str | Path) and len(str(value)) < 4096 and "/" in str(value) and _is_dataset(Path(value))


def _is_dataset(path: Path) -> bool:
    return any((above / "dataset.yaml").is_file() for above in (path, *path.parents))


class Neighbours:
    """Requests the frames around the keyframe, of which one may be the query."""

    neighbours = 100

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4), info={"found": len(reference.neighbours)})


class Mutator:
    """Writes to everything that it is shown, to spoil it for whoever is asked next."""

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        found = []
        for name, array in (("image", reference.image), ("depth", reference.depth), ("query", query.image)):
            if array is None:
                continue
            for target in (array, array.base):
                with suppress(Exception):
                    target.setflags(write=True)  # type: ignore[union-attr]
                with suppress(Exception):
                    target[...] = 0  # type: ignore[index]
                    found.append(name)
        return TrackResult(np.eye(4), info={"found": found})


@dataclass
class Forger:
    """Answers in the protocol's stead, and undoes the checks of its own process."""

    how: str = "patch"

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        if self.how == "patch":
            import relocbench.evaluation.isolation.answers as answers
            import relocbench.evaluation.isolation.handles as handles

            huge = answers.CheckedAnswer("ok", np.full((4, 4), 1e300), 2.0, "forged\nline", "[]")
            handles.LocalTracker.ask = lambda *_, **__: ([huge], 0.0)  # type: ignore[method-assign]
        elif self.how == "clock":
            time.perf_counter = lambda: 0.0
            time.sleep(0.05)
        else:
            for connection in sockets():
                connection.sendall(FRAMES[self.how])
        return TrackResult(np.eye(4))


class NoteTaker:
    """Leaves a note wherever a program keeps files, and looks for notes of others."""

    _NAME = f"note-{secrets.token_hex(4)}"

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        places = [Path("~").expanduser(), Path(tempfile.gettempdir())]
        places += [Path(os.environ[name]) for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME")]
        places += [Path.cwd(), Path(__file__).parent, Path("/dev/shm"), Path(pwd.getpwuid(os.getuid()).pw_dir)]
        found = sorted(str(path) for place in places for path in place.glob("note-*") if path.name != self._NAME)
        for place in places:
            with suppress(OSError):
                place.mkdir(parents=True, exist_ok=True)
                (place / self._NAME).touch()
        return TrackResult(np.eye(4), info={"found": found, "places": list(map(str, places))})


class DiskReader:
    """Knows where the dataset is, and answers with the true poses that it finds there.

    Args:
        place: the dataset's folder, spelt backwards.
    """

    def __init__(self, place: str) -> None:
        files = Path(place[::-1]).glob("pairs/*.txt")
        lines = [line.split() for path in files for line in path.read_text().splitlines() if line[:1].isdigit()]
        self.poses = [[float(word) for word in line[2:9]] for line in lines]

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4), info={"found": self.poses})


class Diarist(DiskReader):
    """Writes into a folder of caches, which outlives it, how many true poses it found when it was made.

    Args:
        diary: the file.
    """

    def __init__(self, place: str, diary: Path) -> None:
        super().__init__(place)
        with diary.open("a") as stream:
            stream.write(f"{len(self.poses)} ")

    def match(self, reference: Reference, query: Query, uv_ref: Any, uv_start: Any) -> Any:
        return uv_start


class Trilaterator:
    """Remembers from where it is started for each pixel, and intersects the circles on which the truth then lies."""

    def __init__(self) -> None:
        self.seen: dict[tuple[Any, ...], list[Any]] = {}

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4), info={"found": []})

    def match(self, reference: Reference, query: Query, uv_ref: Any, uv_start: Any) -> Any:
        pixels = [(reference.key, query.key, *uv) for uv in np.asarray(uv_ref).tolist()]
        for pixel, start in zip(pixels, uv_start, strict=True):
            self.seen.setdefault(pixel, []).append(start)
        return np.array([_on_circles(self.seen[p], start) for p, start in zip(pixels, uv_start, strict=True)])


class PoseFitter:
    """Fits one pose to the starts of all pixels, with the keyframe's depth, and answers where that pose puts them."""

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4), info={"found": []})

    def match(self, reference: Reference, query: Query, uv_ref: Any, uv_start: Any) -> Any:
        assert reference.depth is not None
        rows, columns = np.rint(np.asarray(uv_ref)[:, ::-1]).astype(int).T
        depth = reference.depth[rows, columns]
        rays, _ = reference.camera.unproject(uv_ref)
        points = (rays / rays[:, 2:] * depth[:, None])[depth > 0].astype(np.float64)
        if len(points) < 6:
            return uv_start
        matrix = query.camera.matrix
        found, turn, move, inliers = cv2.solvePnPRansac(
            points, np.asarray(uv_start)[depth > 0], matrix, None, reprojectionError=3.0, iterationsCount=300
        )
        ends = np.array(uv_start, dtype=np.float64)
        if found and inliers is not None:
            ends[depth > 0] = cv2.projectPoints(points, turn, move, matrix, None)[0][:, 0]
        return ends


def _on_circles(starts: list[Any], start: Any) -> Any:
    """The point with the offsets of matching quality from the starts, in some order; the start where they are few."""
    if len(starts) < 3:
        return start
    at = np.array(starts[:5])
    best, point = np.inf, start
    for radii in permutations(OFFSETS_PX, len(at)):
        r = np.array(radii, dtype=float)
        right = (at[1:] ** 2).sum(axis=1) - (at[0] ** 2).sum() - r[1:] ** 2 + r[0] ** 2
        found = np.linalg.lstsq(2 * (at[1:] - at[0]), right, rcond=None)[0]
        off = np.abs(np.linalg.norm(at - found, axis=1) - r).max()
        if off < best:
            best, point = off, found
    return point


QUESTION = "0123456789abcdef"
"""what no question is called, since numbers are drawn"""


def _frame(text: bytes) -> bytes:
    return struct.pack("<Q", len(text)) + text


def _told(words: Any, *arrays: list[int]) -> bytes:
    return _frame(json.dumps({"question": QUESTION, "words": words, "arrays": arrays}).encode())


FRAMES = {
    "pickle": _frame(b"cos\nsystem\n(S'false'\ntR."),
    "text": _frame(b"not json"),
    "list": _frame(b"[1, 2]"),
    "huge": struct.pack("<Q", 2**60),
    "arrays": _told([], [8, 2**40, 2**40]),
    "many": _told([{"posed": True}] * 3),
    "fields": _told([{"posed": True, "confidence": "x"}]),
    "objects": _told([], [3, 5]),
    "nothing": _told(None),
    "early": _told([{"posed": True, "confidence": 1.0, "message": "", "info": "{}"}], [8, 4, 4]) + np.eye(4).tobytes(),
}


def sockets() -> list[socket.socket]:
    found = []
    for descriptor in range(3, 64):
        with suppress(OSError):
            found.append(socket.socket(fileno=os.dup(descriptor)))
    return found


def _since(later_ns: int, earlier_ns: int) -> float:
    """Frames between two times; the drives of the tests' dataset start at whole multiples of 1e15 ns."""
    return ((later_ns % 10**15) - (earlier_ns % 10**15)) / STEP_NS

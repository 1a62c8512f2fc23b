"""A dataset and the answers of methods as a recording for the viewer rerun.

Two timelines order what is shown: ``pair`` counts the pairs, ``query_time`` is the time of the query in nanoseconds.
Coordinates are those of the world less a whole number of metres, which the text of every pair names.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import cv2
import numpy as np
import rerun as rr

from relocbench.arrays import Array, Image
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import jpeg_bytes
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.worlds import world_of_traversals
from relocbench.errors import ConfigError
from relocbench.files import atomic_write, remove_parts
from relocbench.geometry import Camera, invert, transform_to_tq
from relocbench.pages.markdown import escaped
from relocbench.progress import Reporter
from relocbench.viewer import paths
from relocbench.viewer.answers import MethodAnswers, ShownAnswer
from relocbench.viewer.blueprint import blueprint
from relocbench.viewer.choice import ShownPair
from relocbench.viewer.frames import Colour, axes, origin_of, pinhole, transform, view_coordinates
from relocbench.viewer.pictures import as_pinhole, keyframe_points, reduced

# Okabe and Ito, "Color Universal Design" (2008).
_METHODS: tuple[Colour, ...] = (
    (213, 94, 0),
    (86, 180, 233),
    (230, 159, 0),
    (204, 121, 167),
    (240, 228, 66),
    (0, 114, 178),
)
_TRUE, _REF, _RIG = (0, 158, 115), (200, 200, 200), (120, 120, 120)
_PATIENCE_S = 10.0
"""in which some more of a recording is written, if any is"""


@dataclass(frozen=True)
class Written:
    """What a recording holds."""

    pairs: int
    pair_sets: int
    methods: int
    traversals: int
    images: int
    points: int
    without_pose: int
    """pairs that have no place in the world, as the traversal has no pose of their keyframe"""
    undistorted: tuple[str, ...]
    """cameras with distortion, whose images are shown undistorted"""
    bytes: int


def write_recording(
    dataset: Dataset,
    shown: Sequence[ShownPair],
    answers: Mapping[str, Mapping[str, MethodAnswers]],
    out: Path,
    *,
    points: int,
    reporter: Reporter,
) -> Written:
    """Write the recording of these pairs, whole or not at all.

    Args:
        shown: from :func:`relocbench.viewer.choice.chosen_pairs`; not empty.
        answers: method -> pair set -> its answers.
        points: most points of a keyframe.

    Raises:
        ConfigError: the file cannot be written to its end.
        DatasetError: an image, depth or description of the dataset is bad.
    """
    remove_parts(out.parent, deep=False)
    with atomic_write(out, "wb") as stream:
        work = _Work(dataset, shown, answers, points, Path(stream.name))
        with reporter.stage("writing pairs", len(shown)) as advance:
            for one in shown:
                work.add(one)
                advance(1)
        try:
            work.close()
        except RuntimeError as bad:  # rerun writes in a thread of its own, and says why on standard error
            raise ConfigError(f"could not be written to its end ({bad}); is there space left?", out) from None
    return work.written(out.stat().st_size)


class _Work:
    """A recording that is being written."""

    def __init__(
        self,
        dataset: Dataset,
        shown: Sequence[ShownPair],
        answers: Mapping[str, Mapping[str, MethodAnswers]],
        points: int,
        path: Path,
    ) -> None:
        self.dataset, self.answers, self.points, self.path = dataset, answers, points, path
        self.colours = {name: _METHODS[i % len(_METHODS)] for i, name in enumerate(answers)}
        self.sets = {one.pair_set.name: one.pair_set for one in shown}
        self.worlds = world_of_traversals(dataset, self.sets.values())
        self.origins = {w: origin_of(self._first_poses(w)) for w in set(self.worlds.values())}
        self.pairs = self.images = self.drawn_points = self.without_pose = 0
        self.undistorted: dict[str, None] = {}
        self._last: ShownPair | None = None
        self._keyframes: dict[str, int] = {}
        digest = hashlib.sha256(f"{dataset.fingerprint} {sorted(answers)} {[o.pair.key for o in shown]}".encode())
        self.rec = rr.RecordingStream("relocbench", recording_id=digest.hexdigest()[:32], send_properties=False)
        self.rec.set_log_time_enabled(False)
        self.rec.set_log_tick_enabled(False)
        self.rec.save(path, default_blueprint=self._blueprint())
        self.rec.send_recording_name(dataset.name)
        for world in self.origins:
            self.rec.log(paths.world(world), rr.ViewCoordinates(xyz=view_coordinates(dataset, world)), static=True)
        for name in self.worlds:
            self._add_traversal(dataset.traversal(name))
        for name in self.sets:
            self._style_errors(name)

    def _blueprint(self) -> rr.blueprint.Blueprint:
        pictured = {name for name, pair_set in self.sets.items() if self.dataset.has_images(pair_set)}
        return blueprint(self.sets, self.worlds, errors=bool(self.answers), pictured=pictured)

    def add(self, one: ShownPair) -> None:
        """Log a pair on both timelines."""
        pair_set, pair = one.pair_set, one.pair
        if self._last is not None and self._last.pair_set is not pair_set:
            self._end(self._last, one.index)
        self._last = one
        self.rec.reset_time()
        self.rec.set_time(paths.PAIR_TIMELINE, sequence=one.index)
        self.rec.set_time(paths.QUERY_TIMELINE, timestamp=np.datetime64(pair.query_timestamp_ns, "ns"))
        T_world_ref = self._pose(pair_set, pair.ref_timestamp_ns)
        root = paths.pair_set(self.worlds[pair_set.reference], pair_set.name)
        self._add_keyframe(one, root, T_world_ref)
        camera, small = None, None
        if self.dataset.has_images(pair_set):
            query = self.dataset.query(pair_set, pair)
            camera, small = query.camera, self._add_image(pair_set, paths.QUERY, query.image, query.camera)
        true = _placed(T_world_ref, pair.T_query_ref)
        self._add_camera(f"{root}/{paths.QUERY}", camera, true, _TRUE, small)
        for method in self.answers:
            answer = self.answers[method].get(pair_set.name, {}).get(pair.key)
            self._add_answer(one, root, method, answer, camera, T_world_ref)
        self._add_rig(one)
        words = rr.TextDocument(self._words(one), media_type="text/markdown")
        self.rec.log(paths.words(pair_set.name), words)
        self.pairs += 1
        self.without_pose += T_world_ref is None

    def close(self) -> None:
        """Write what is left. Raises RuntimeError where nothing more can be written, as on a full disk."""
        written = -1
        while True:  # rerun's thread that writes may end without telling those who wait for it
            try:
                self.rec.flush(timeout_sec=_PATIENCE_S)
                break
            except RuntimeError:
                before, written = written, self.path.stat().st_size
                if written == before:
                    raise
        self.rec.disconnect()

    def written(self, size: int) -> Written:
        return Written(
            pairs=self.pairs,
            pair_sets=len(self.sets),
            methods=len(self.answers),
            traversals=len(self.worlds),
            images=self.images,
            points=self.drawn_points,
            without_pose=self.without_pose,
            undistorted=tuple(self.undistorted),
            bytes=size,
        )

    def _first_poses(self, world: str) -> list[Array]:
        return [
            T for name, of in self.worlds.items() if of == world for T in self.dataset.traversal(name).poses.values()
        ]

    def _pose(self, pair_set: PairSet, time: int) -> Array | None:
        """``T_world_ref`` less the origin; None where the traversal has no pose at that time."""
        traversal = self.dataset.traversal(pair_set.reference)
        if time not in traversal.poses:
            return None
        return self._moved(traversal.T_world_cam(pair_set.reference_camera, time), self.worlds[traversal.name])

    def _moved(self, T_world_x: Array, world: str) -> Array:
        T = T_world_x.copy()
        T[:3, 3] -= self.origins[world]
        return T

    def _add_traversal(self, traversal: Traversal) -> None:
        """The path of a traversal, and its rig with all cameras, which moves along it."""
        world = self.worlds[traversal.name]
        root = paths.traversal(world, traversal.name)
        if not traversal.poses:
            return
        poses = [self._moved(T, world) for T in traversal.poses.values()]
        centres = np.array([T[:3, 3] for T in poses])
        self.rec.log(f"{root}/trajectory", rr.LineStrips3D([centres], colors=[_RIG]), static=True)
        times = np.array(list(traversal.poses), dtype="datetime64[ns]")
        quaternions = np.array([transform_to_tq(T)[1] for T in poses])
        self.rec.send_columns(
            f"{root}/rig",
            indexes=[rr.TimeColumn(paths.QUERY_TIMELINE, timestamp=times)],
            columns=rr.Transform3D.columns(translation=centres, quaternion=quaternions),
        )
        for name in [*traversal.cameras, *traversal.frames]:
            entity = f"{root}/rig{paths.path(name)}"
            shape = axes(_RIG) if name in traversal.frames else pinhole(traversal.camera(name), _RIG)
            self.rec.log(entity, transform(traversal.T_rig_cam(name)), shape, static=True)

    def _add_rig(self, one: ShownPair) -> None:
        """The query's rig at its own pose, on the timeline of pairs, which the poses over time do not fill."""
        traversal = self.dataset.traversal(one.pair_set.query)
        world = self.worlds[traversal.name]
        T_world_rig = traversal.poses.get(one.pair.query_timestamp_ns)
        if T_world_rig is not None:
            self._on_pairs(one.index)
            rig = f"{paths.traversal(world, traversal.name)}/rig"
            self.rec.log(rig, transform(self._moved(T_world_rig, world)))
            self.rec.set_time(paths.QUERY_TIMELINE, timestamp=np.datetime64(one.pair.query_timestamp_ns, "ns"))

    def _on_pairs(self, index: int) -> None:
        self.rec.reset_time()
        self.rec.set_time(paths.PAIR_TIMELINE, sequence=index)

    def _end(self, last: ShownPair, index: int) -> None:
        """Take the last pair of a set away, on the timeline of pairs only: over time, sets may be at once."""
        self._on_pairs(index)
        root = paths.pair_set(self.worlds[last.pair_set.reference], last.pair_set.name)
        self.rec.log(root, rr.Clear(recursive=True))

    def _add_keyframe(self, one: ShownPair, root: str, T_world_ref: Array | None) -> None:
        """The keyframe with image and points, where it is another than that of the pair before."""
        pair_set, time = one.pair_set, one.pair.ref_timestamp_ns
        if self._keyframes.get(pair_set.name) == time:
            return
        self._keyframes[pair_set.name] = time
        if not self.dataset.has_images(pair_set):
            self._add_camera(f"{root}/{paths.KEYFRAME}", None, T_world_ref, _REF, None)
            return
        reference = self.dataset.reference(pair_set, one.pair)
        small = self._add_image(pair_set, paths.KEYFRAME, reference.image, reference.camera)
        self._add_camera(f"{root}/{paths.KEYFRAME}", reference.camera, T_world_ref, _REF, small)
        found = keyframe_points(reference, self.points)
        self.drawn_points += len(found.positions)
        points = rr.Points3D(found.positions, colors=found.colours, radii=rr.Radius.ui_points(1.5))
        if T_world_ref is not None:
            # Beside the camera for the same reason as the labels of methods.
            self.rec.log(f"{root}/points", transform(T_world_ref), points)

    def _add_answer(
        self,
        one: ShownPair,
        root: str,
        method: str,
        answer: ShownAnswer | None,
        camera: Camera | None,
        T_world_ref: Array | None,
    ) -> None:
        """A method's camera, and its errors where they are finite; nothing where it did not answer."""
        placed = None if answer is None else _placed(T_world_ref, answer.T_query_ref)
        entity = f"{root}/answers{paths.path(method)}"
        # Beside the cameras, not within one: what lies within a pinhole is projected into its image.
        label_entity = f"{root}/labels{paths.path(method)}"
        self._add_camera(entity, camera, placed, self.colours[method], None)
        if answer is None:
            return
        if placed is not None:
            label = rr.Points3D([placed[:3, 3]], labels=[f"{method}: {answer.words}"], colors=[self.colours[method]])
            self.rec.log(label_entity, label)
        else:
            self.rec.log(label_entity, rr.Clear(recursive=False))
        for what, value in ((paths.METRES, answer.translation_error_m), (paths.DEGREES, answer.rotation_error_deg)):
            entity = paths.error(what, one.pair_set.name, method)
            if value is not None and isfinite(value):
                self.rec.log(entity, rr.Scalars(value))
            else:
                self.rec.log(entity, rr.Clear(recursive=False))

    def _style_errors(self, name: str) -> None:
        for method, colour in self.colours.items():
            for what in (paths.METRES, paths.DEGREES):
                lines = rr.SeriesLines(colors=[colour], names=[method])
                markers = rr.SeriesPoints(colors=[colour], names=[method], marker_sizes=[3])
                self.rec.log(paths.error(what, name, method), lines, markers, static=True)

    def _add_camera(
        self, entity: str, camera: Camera | None, T_world_cam: Array | None, colour: Colour, small: bytes | None
    ) -> None:
        """A camera with its image at a pose, or where there are no images the axes of the frame.

        What stood there before is taken away where there is no pose.
        """
        if T_world_cam is None:
            self.rec.log(entity, rr.Clear(recursive=True))
            return
        shape = axes(colour) if camera is None else pinhole(camera, colour)
        self.rec.log(entity, transform(T_world_cam), shape)
        if small is not None:
            self.rec.log(f"{entity}/image", rr.EncodedImage(contents=small, media_type="image/jpeg"))

    def _add_image(self, pair_set: PairSet, which: str, image: Image, camera: Camera) -> bytes:
        """Log an image flat, and return the small one that stands in its camera's frustum."""
        if camera.model != "pinhole":
            self.undistorted[pair_set.query_camera if which == paths.QUERY else pair_set.reference_camera] = None
        seen = as_pinhole(image, camera)
        self.images += 1
        entity = paths.images(pair_set.name, which)
        self.rec.log(entity, rr.EncodedImage(contents=jpeg_bytes(seen), media_type="image/jpeg"))
        size = reduced(camera).size
        small = np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return jpeg_bytes(small)

    def _words(self, one: ShownPair) -> str:
        pair_set, pair = one.pair_set, one.pair
        world = self.worlds[pair_set.reference]
        facts = [
            ("pair set", pair_set.name),
            ("pair", f"{one.index} (keyframe {pair.ref_timestamp_ns}, query {pair.query_timestamp_ns})"),
            (
                "conditions",
                " → ".join(str(self.dataset.traversal(t).condition) for t in (pair_set.reference, pair_set.query)),
            ),
            ("world", f"of {world}, less {', '.join(f'{x:.0f}' for x in self.origins[world])} m"),
        ]
        if pair.distance_m is not None:
            facts.append(("keyframe off by", f"{pair.distance_m:.3f} m, {pair.angle_deg:.2f}°"))
        if pair.is_negative:
            facts.append(("different places", "nothing in the images tells the pose"))
        if self.worlds[pair_set.query] != world:
            facts.append(("poses of the query's traversal", "in another world: not shown here"))
        if any(camera in self.undistorted for camera in pair_set.cameras):
            facts.append(("images", "undistorted"))
        lines = [f"- **{name}**: {escaped(value)}" for name, value in facts]
        if self.answers:
            lines += ["", "| method | translation, rotation error | confidence |", "|---|---|---|"]
        for method, by_set in self.answers.items():
            answer = by_set.get(pair_set.name, {}).get(pair.key)
            said = "no result of this set" if answer is None else answer.words
            sure = "" if answer is None or answer.confidence is None else f"{answer.confidence:.2f}"
            lines.append(f"| {escaped(method)} | {escaped(said)} | {sure} |")
        return "\n".join(lines) + "\n"


def _placed(T_world_ref: Array | None, T_query_ref: Array | None) -> Array | None:
    """``T_world_query``, where both are known."""
    if T_world_ref is None or T_query_ref is None:
        return None
    return np.asarray(T_world_ref @ invert(T_query_ref), dtype=np.float64)

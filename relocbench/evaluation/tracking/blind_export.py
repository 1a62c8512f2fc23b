"""Writing a blind export: a dataset that asks the same pairs, without truth, times, poses and order.

It is a dataset like any other, so that `relocbench evaluate` runs on it, with `blind_keys` in place of timestamps.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.errors import ConfigError
from relocbench.evaluation.common.blind_names import blind_name
from relocbench.evaluation.common.opening import check_outside
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.progress import Reporter

_Image = tuple[str, str, int]
"""traversal, camera, timestamp in nanoseconds"""


def export_blind(dataset: Dataset, out: Path, edition: int, reporter: Reporter) -> Dataset:
    """Write all pair sets of a dataset to a folder, blind; an export that was stopped goes on.

    It holds keyframes with depth or points, queries without, cameras, conditions and pairs. Images are written anew
    from their pixels, so that no metadata comes with them. There are no poses, hence no neighbours of keyframes, and
    neither groups nor sigmas of pairs.

    Raises:
        DatasetError: the truth is withheld already, there are no images, or ``out`` holds something else.
        ConfigError: ``out`` lies inside the dataset, or the dataset is a blind export itself.
    """
    check_outside(out, dataset.root)
    dataset.require_images(
        dataset.pair_sets(), "a blind export would hold keys alone, and nobody could tell of which frames they are"
    )
    if blind_name(dataset.name) is not None:
        raise ConfigError(f"'{dataset.name}' is a blind export already", dataset.root)
    keys = BlindKeys(dataset, edition)
    recipe = {"kind": "blind", "options": {"edition": edition}}
    writer = DatasetWriter(out, str(keys.name), recipe, dataset.file.licence)
    keyframes = {(s.reference, s.camera, p.ref_timestamp_ns) for s in dataset.pair_sets() for p in s.evaluated}
    queries = {(s.query, s.camera, p.query_timestamp_ns) for s in dataset.pair_sets() for p in s.evaluated}
    images = sorted(keyframes | queries)
    with reporter.stage("blind export", len(images)) as advance:
        for name, camera, time in images:
            traversal, key = dataset.traversal(name), keys.key(name, time)
            if writer.needs_image(name, camera, key):
                writer.image(name, camera, key, traversal.image(camera, time))
            if (name, camera, time) in keyframes:
                _write_depth(writer, traversal, camera, time, key)
            advance(1)
    for name in sorted({name for name, _, _ in images}):
        _write_traversal(writer, dataset.traversal(name), keys, _of(images, name))
    for pair_set in dataset.pair_sets():
        blind = [Pair(*key, T_query_ref=None) for key in keys.pairs(pair_set)]
        writer.pairs(pair_set.reference, pair_set.query, pair_set.camera, blind)
    return writer.finish(dataset.splits)


def _of(images: list[_Image], traversal: str) -> Iterator[tuple[str, int]]:
    return ((camera, time) for name, camera, time in images if name == traversal)


def _write_depth(writer: DatasetWriter, traversal: Traversal, camera: str, time: int, key: int) -> None:
    points = traversal.points(camera, time)
    if points is not None:
        writer.points(traversal.name, camera, key, points)
    if writer.needs_depth(traversal.name, camera, key):
        depth = traversal.depth(camera, time)
        if depth is not None:
            writer.depth(traversal.name, camera, key, depth)


def _write_traversal(
    writer: DatasetWriter, traversal: Traversal, keys: BlindKeys, images: Iterator[tuple[str, int]]
) -> None:
    """Rig and condition of a drive, without where it was recorded from and how often it took images."""
    writer.traversal(traversal.file.model_copy(update={"source": "", "rate_hz": None}), {})
    own: dict[str, dict[int, int]] = {}
    for camera, time in images:
        if time in traversal.intrinsics(camera):
            own.setdefault(camera, {})[keys.key(traversal.name, time)] = time
    for camera, times in own.items():
        cameras = {key: traversal.camera(camera, times[key]) for key in sorted(times)}
        writer.intrinsics(traversal.name, camera, cameras)

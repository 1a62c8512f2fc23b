"""Writing a blind export: a dataset that asks the same pairs, without truth, times, poses, names and order.

It is a dataset like any other, so that `relocbench evaluate` runs on it, with `blind_keys` in place of timestamps.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.schema import Transform, TraversalFile
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.errors import DatasetError
from relocbench.evaluation.common.blind_names import KIND, check_salt
from relocbench.evaluation.common.opening import check_outside
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.geometry import Camera
from relocbench.progress import Reporter


def export_blind(keys: BlindKeys, out: Path, reporter: Reporter) -> Dataset:
    """Write all pair sets of a dataset to a folder, blind; an export that was stopped goes on.

    It holds keyframes with depth or points, queries without, cameras and pairs. Images are written anew from their
    pixels, so that no metadata comes with them, and in the order of their keys, so that times of files tell nothing.
    There are no poses, hence no neighbours of keyframes; no conditions, places and rigs; no groups and sigmas of pairs.

    Raises:
        DatasetError: the truth is withheld, or follows from options without a salt; there are no images, or ``out``
            holds something else.
        ConfigError: ``out`` lies inside the dataset, or the dataset was built with another salt.
    """
    dataset = keys.dataset
    check_salt(keys.salt, dataset.file.made_by, dataset.name, dataset.root)
    check_outside(out, dataset.root)
    dataset.require_images(
        dataset.pair_sets(), "a blind export would hold keys alone, and nobody could tell of which frames they are"
    )
    for pair_set in dataset.pair_sets():
        if not pair_set.has_truth or not pair_set.evaluated:
            raise DatasetError(
                f"the truth of '{pair_set.name}' is withheld, and answers could not be scored", dataset.root
            )
    recipe = {"kind": KIND, "options": {"name": str(keys.name)}}
    writer = DatasetWriter(out, str(keys.name), recipe, dataset.file.licence)
    sets = dataset.pair_sets()
    keyframes = {(s.reference, s.reference_camera, p.ref_timestamp_ns) for s in sets for p in s.evaluated}
    queries = {(s.query, s.query_camera, p.query_timestamp_ns) for s in sets for p in s.evaluated}
    images = {keys.key(*image): image for image in keyframes | queries}
    own: dict[tuple[str, str], dict[int, Camera]] = defaultdict(dict)
    with reporter.stage("blind export", len(images)) as advance:
        for key, image in sorted(images.items()):
            name, camera, time = image
            traversal, shown = dataset.traversal(name), (keys.drives[name], keys.cameras[camera], key)
            if writer.needs_image(*shown):
                writer.image(*shown, traversal.image(camera, time))
            if image in keyframes:
                _write_depth(writer, traversal, camera, time, shown)
            if time in traversal.intrinsics(camera):
                own[shown[:2]][key] = traversal.camera(camera, time)
            advance(1)
    for name, drive in keys.drives.items():
        cameras = {camera for of, camera, _ in images.values() if of == name}
        writer.traversal(_description(drive, dataset.traversal(name), {c: keys.cameras[c] for c in cameras}), {})
    for place, by_key in own.items():
        writer.intrinsics(*place, by_key)
    for s in sets:
        blind = [Pair(*key, T_query_ref=None) for key in keys.pairs(s)]
        of_keyframes, of_queries = (keys.cameras[camera] for camera in s.cameras)
        writer.pairs(keys.drives[s.reference], keys.drives[s.query], of_keyframes, blind, of_queries)
    return writer.finish({KIND: sorted(map(keys.pair_set, dataset.pair_sets()))})


def _write_depth(
    writer: DatasetWriter, traversal: Traversal, camera: str, time: int, shown: tuple[str, str, int]
) -> None:
    points = traversal.points(camera, time)
    if points is not None:
        writer.points(*shown, points)
    if writer.needs_depth(*shown):
        depth = traversal.depth(camera, time)
        if depth is not None:
            writer.depth(*shown, depth)


def _description(drive: str, traversal: Traversal, cameras: dict[str, str]) -> TraversalFile:
    """The cameras of a drive that are asked, each as if it stood alone, and nothing else."""
    alone = {"T_rig_cam": Transform.of(np.eye(4))}
    entries = {shown: traversal.file.cameras[name].model_copy(update=alone) for name, shown in cameras.items()}
    return TraversalFile(name=drive, cameras=dict(sorted(entries.items())))

"""Programs that are given a blind export and try to learn true poses from anything but what its images show."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.sparse.csgraph import connected_components, shortest_path

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.salt import Salt
from relocbench.datasets.importers.rendered import dataset as rendered
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.execution import Run
from relocbench.geometry import invert, make_transform
from relocbench.metrics import pose_errors
from relocbench.progress import Silent

TOWN = {"preset": "smoke", "conditions": ("Sunny",), "steps": 2, "correspondences": 0, "split": "validation"}
"""what a challenge announces of its towns, or a cheat guesses by the defaults"""
Answers = Mapping[tuple[str, tuple[int, int]], Array]
"""pair set and keys of keyframe and query -> ``T_query_ref``"""


def render_town(out: Path, size: str, seed: int, salt_file: Path | None = None) -> Dataset:
    """A town that follows from a seed and, where one is given, a salt."""
    options = rendered.Options.model_validate({**TOWN, "size": size, "seed": seed, "salt_file": salt_file})
    return rendered.build([], options, out, Silent(), Run(1))


def seeds_named(export: Path) -> set[int]:
    """Every number that a text of the export, or a name in it, calls a seed."""
    texts = [path.read_text() for path in export.rglob("*") if path.suffix in (".yaml", ".csv", ".txt")]
    names = [str(path.relative_to(export)) for path in export.rglob("*")]
    return {int(number) for text in (*texts, *names) for number in re.findall(r"seed\W{0,3}(\d+)", text)}


def rebuild_the_world(export: Dataset, render: Callable[[int], Dataset], seeds: Iterable[int]) -> dict[int, Answers]:
    """Render the towns of seeds, match the export's images and its depth, and read the poses off: seed -> answers."""
    found: dict[int, Answers] = {}
    for seed in dict.fromkeys((*sorted(seeds_named(export.root)), *seeds)):
        town = render(seed)
        poses = {
            town.traversal(name).image(camera, time).tobytes(): town.traversal(name).T_world_cam(camera, time)
            for name in town.traversal_names
            for camera in town.traversal(name).cameras
            for time in town.traversal(name).timestamps(camera)
        }
        answers = {}
        for pair_set in export.pair_sets():
            for pair in pair_set.evaluated:
                views = export.reference(pair_set, pair), export.query(pair_set, pair)
                T_world_ref, T_world_query = (poses.get(view.image.tobytes()) for view in views)
                if T_world_ref is not None and T_world_query is not None:
                    answers[pair_set.name, pair.key] = invert(T_world_query) @ T_world_ref
        if answers:
            found[seed] = answers
    return found


def orders_of(export: Dataset, drive: str) -> dict[str, list[int]]:
    """The images of a drive in every order that the export has, apart from what their pixels show."""
    (folder,) = (export.root / "traversals" / drive / "images").iterdir()
    files, listed = list(folder.iterdir()), (export.root / "manifest.csv").read_text()
    pairs = " ".join(path.read_text() for path in sorted((export.root / "pairs").glob("*.txt"))).split()
    by_file: dict[str, Callable[[Path], float]] = {
        "name": lambda path: int(path.stem),
        "time of writing": lambda path: path.stat().st_mtime_ns,
        "time of change": lambda path: path.stat().st_ctime_ns,
        "inode": lambda path: path.stat().st_ino,
        "manifest": lambda path: listed.index(path.name),
        "pair files": lambda path: pairs.index(path.stem),
    }
    orders = {what: [int(path.stem) for path in sorted(files, key=by)] for what, by in by_file.items()}
    return {**orders, "folder": [int(Path(name).stem) for name in os.listdir(folder)]}  # noqa: PTH208


def answer_by_order(pairs: Iterable[Pair], order: list[int], spacing_m: float) -> dict[tuple[int, int], Array]:
    """Pairs of one drive, whose images are taken to follow each other on a straight road at a known pace."""
    place = {key: index * spacing_m for index, key in enumerate(order)}
    return {
        p.key: make_transform(np.eye(3), [0.0, 0.0, place[p.ref_timestamp_ns] - place[p.query_timestamp_ns]])
        for p in pairs
    }


def mean_error_m(answers: Mapping[tuple[int, int], Array], truth: Mapping[tuple[int, int], Array]) -> float:
    """Mean translation error in metres of answers to all pairs."""
    keys = list(truth)
    errors = pose_errors(np.array([answers[key] for key in keys]), np.array([truth[key] for key in keys]))
    return float(errors.translation_error_m.mean())


def truth_of(dataset: Dataset, salt: Salt, name: str) -> dict[tuple[int, int], Array]:
    """The true poses of a pair set by its blind keys, which the owner of the salt knows."""
    keys, pair_set = BlindKeys(dataset, salt), dataset.pair_set(name)
    found = {}
    for shown, real in keys.pairs(pair_set).items():
        pose = pair_set.by_key[real].T_query_ref
        assert pose is not None
        found[shown] = pose
    return found


def orders_by_pairs(pairs: Sequence[Pair]) -> list[list[int]]:
    """The images of each connected part of the graph of pairs, in an order along the road that the graph tells.

    By classical multidimensional scaling of the numbers of pairs between any two images, in one dimension.
    """
    keys = sorted({key for pair in pairs for key in pair.key})
    row = {key: index for index, key in enumerate(keys)}
    linked = np.zeros((len(keys), len(keys)))
    for pair in pairs:
        linked[row[pair.key[0]], row[pair.key[1]]] = 1
    parts, part = connected_components(linked, directed=False)
    orders = []
    for one in range(parts):
        inside = np.nonzero(part == one)[0]
        squares = shortest_path(linked[np.ix_(inside, inside)], directed=False, unweighted=True) ** 2
        centred = squares - squares.mean(axis=0)
        scaled = -0.5 * (centred - centred.mean(axis=1, keepdims=True))
        place = np.linalg.eigh(scaled)[1][:, -1]
        orders.append([keys[inside[index]] for index in np.argsort(place)])
    return orders

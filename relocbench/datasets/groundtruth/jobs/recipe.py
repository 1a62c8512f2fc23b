"""Recordings to pairs by the plain recipe with Open3D (``--recipe open3d``), by worker processes, kept on disk.

``recipe/REF__QUERY__CAMERA.csv`` has one row for each query image; ``registrations`` and ``graph`` hold the same
between nodes, from which ground truth is inspected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from relocbench.datasets.groundtruth.alignment.two_drives import FirstPose, if_within
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.jobs.writing import Frames, camera_frames
from relocbench.datasets.groundtruth.pairs.pairing import Paired
from relocbench.datasets.groundtruth.pose_graph.files import write_graph
from relocbench.datasets.groundtruth.recipe.answers import between_nodes, outcomes_of, placed
from relocbench.datasets.groundtruth.recipe.chain import ChainUnit, follow
from relocbench.datasets.groundtruth.recipe.open3d_pair import Open3dOptions
from relocbench.datasets.groundtruth.registration.files import read_registrations, write_registrations
from relocbench.datasets.groundtruth.registration.journal import JournaledUnit, register_missing
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.execution import Run
from relocbench.progress import Reporter


def pair_by_recipe(
    drives: Sequence[Drive],
    frames: Sequence[Mapping[str, Frames]],
    folder: Path,
    options: FieldOptions,
    first: FirstPose | None,
    reporter: Reporter,
    run: Run,
    enlarged: float = 1.0,
) -> list[Paired]:
    """Pair every query drive with the reference; pairs of an earlier run are read from disk.

    Args:
        drives: the reference first.
        frames: the images of each drive, by camera.
        folder: of all intermediate results.
        enlarged: how many times the metres of the drives and of the pose given by hand are enlarged, and those of the
            pairs that are returned.

    Raises:
        DatasetError: a scan or an intermediate file is damaged.
    """
    folder = folder.resolve()  # workers of a cluster run in other working directories
    reference, queries = drives[0], drives[1:]
    chains = [
        [
            ChainUnit(
                reference.recording,
                query.recording,
                camera_frames(camera, frames[0][camera], images[camera], enlarged),
                options.submap,
                options.max_distance * enlarged,
                options.max_angle,
                if_within(query.recording, first),
                Open3dOptions(seed=options.seed),
            )
            for camera in images
        ]
        for query, images in zip(queries, frames[1:], strict=True)
    ]
    units = [[_unit(chain, folder / "recipe") for chain in some] for some in chains]
    register_missing("pairs by Open3D", [unit for some in units for unit in some], reporter, run)
    paired = []
    for query, mine, tables in zip(queries, chains, units, strict=True):
        registrations = [read_registrations(unit.table) for unit in tables]
        outcomes = {c.images.camera: outcomes_of(c, pairs) for c, pairs in zip(mine, registrations, strict=True)}
        nodes = between_nodes(mine[0], registrations[0], reference, query)
        name = f"{reference.name}__{query.name}.csv"
        write_registrations(folder / "registrations" / name, nodes, reference.nodes, query.nodes)
        both = placed(nodes, reference, query)
        write_graph(folder / "graph" / name, *both)
        paired.append(Paired(outcomes, *both))
    return paired


def _unit(chain: ChainUnit, folder: Path) -> JournaledUnit:
    table = folder / f"{chain.reference.name}__{chain.query.name}__{chain.images.camera}.csv"
    nodes, steps = (_as_nodes(chain.images.ref_ns), _as_nodes(chain.images.query_ns)), len(chain.images.query_ns)
    about = f"{chain.query.name}, {chain.images.camera}"
    return JournaledUnit(str(chain), partial(follow, chain), steps, table, nodes, about)


def _as_nodes(times_ns: Sequence[int]) -> Nodes:
    """The images of a camera, numbered and timed as the nodes of a table of registrations are."""
    count, times = len(times_ns), np.array(times_ns, dtype=np.int64)
    return Nodes(times, np.tile(np.eye(4), (count, 1, 1)), np.arange(count, dtype=np.float64))

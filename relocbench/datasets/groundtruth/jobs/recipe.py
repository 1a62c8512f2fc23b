"""Recordings to pairs by the plain recipe with Open3D (``--recipe open3d``), by worker processes, kept on disk.

``recipe/REF__QUERY__CAMERA.csv`` has one row for each query image; ``registrations`` and ``graph`` hold the same
between nodes, from which ground truth is inspected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.datasets.groundtruth.alignment.two_drives import FirstPose
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.jobs.writing import Frames
from relocbench.datasets.groundtruth.pairs.pairing import Paired
from relocbench.datasets.groundtruth.pose_graph.files import write_graph
from relocbench.datasets.groundtruth.recipe.answers import between_nodes, outcomes_of, placed
from relocbench.datasets.groundtruth.recipe.chain import ChainUnit, ImageTimes, follow
from relocbench.datasets.groundtruth.recipe.open3d_pair import Open3dOptions
from relocbench.datasets.groundtruth.registration import files as track_files
from relocbench.datasets.groundtruth.registration.journal import Journal, journal_progress
from relocbench.datasets.groundtruth.registration.scene_scale import scaled
from relocbench.datasets.groundtruth.submaps.drive import Drive
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.execution import Run, run_units
from relocbench.progress import Reporter


@dataclass(frozen=True, eq=False)
class _Unit:
    chain: ChainUnit
    journal: Path

    def __str__(self) -> str:
        return str(self.chain)


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
    units = [
        _unit(reference, query, camera, (frames[0][camera], asking[camera]), folder, options, first, enlarged)
        for query, asking in zip(queries, frames[1:], strict=True)
        for camera in asking
    ]
    _follow([unit for unit in units if not _table(unit).exists()], reporter, run)
    paired = []
    for query in queries:
        mine = [unit for unit in units if unit.chain.query is query.recording]
        registrations = [track_files.read_registrations(_table(unit)) for unit in mine]
        outcomes = {u.chain.camera: outcomes_of(u.chain, pairs) for u, pairs in zip(mine, registrations, strict=True)}
        nodes = between_nodes(mine[0].chain, registrations[0], reference, query)
        name = f"{reference.name}__{query.name}.csv"
        track_files.write_registrations(folder / "registrations" / name, nodes, reference.nodes, query.nodes)
        both = placed(nodes, reference, query)
        write_graph(folder / "graph" / name, *both)
        paired.append(Paired(outcomes, *both))
    return paired


def _unit(
    reference: Drive,
    query: Drive,
    camera: str,
    frames: tuple[Frames, Frames],
    folder: Path,
    options: FieldOptions,
    first: FirstPose | None,
    enlarged: float,
) -> _Unit:
    times = query.recording.odometry.times_ns
    chain = ChainUnit(
        reference.recording,
        query.recording,
        camera,
        ImageTimes(scaled(frames[0].stream.T_rig_cam, enlarged), frames[0].times),
        ImageTimes(scaled(frames[1].stream.T_rig_cam, enlarged), frames[1].times),
        options.submap,
        options.max_distance * enlarged,
        options.max_angle,
        first if first is not None and times[0] <= first[1] <= times[-1] else None,
        Open3dOptions(seed=options.seed),
    )
    return _Unit(chain, folder / "recipe" / f"{reference.name}__{query.name}__{camera}.journal")


def _table(unit: _Unit) -> Path:
    return unit.journal.with_suffix(".csv")


def _follow(units: Sequence[_Unit], reporter: Reporter, run: Run) -> None:
    steps = [len(unit.chain.queries.times_ns) for unit in units]
    with (
        reporter.stage("pairs by Open3D", sum(steps)) as advance,
        journal_progress([unit.journal for unit in units], steps, advance) as complete,
    ):
        for index, (pairs, messages) in run_units(_work, units, run):
            unit = units[index]
            for message in messages:
                reporter.note(f"{unit.chain.query.name}, {unit.chain.camera}: {message}")
            ref, query = (_as_nodes(images) for images in (unit.chain.keyframes, unit.chain.queries))
            track_files.write_registrations(_table(unit), pairs, ref, query)
            complete(index)
            unit.journal.unlink(missing_ok=True)


def _work(unit: _Unit) -> tuple[list[Registration], list[str]]:
    messages: list[str] = []
    journal = Journal(unit.journal)
    try:
        return follow(unit.chain, messages.append, journal.remember), messages
    finally:
        journal.close()


def _as_nodes(images: ImageTimes) -> Nodes:
    """The images of a camera, numbered and timed as the nodes of a table of registrations are."""
    count = len(images.times_ns)
    times = np.array(images.times_ns, dtype=np.int64)
    return Nodes(times, np.tile(np.eye(4), (count, 1, 1)), np.arange(count, dtype=np.float64))

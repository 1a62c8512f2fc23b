"""Kind ``poses``: pairs of the poses of trajectories in one world, for predictions that were made elsewhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import DatasetOptions, PairingOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.schema import Transform, TraversalFile
from relocbench.datasets.importers.assembly import open_writer
from relocbench.datasets.motion.orientation import QuaternionOrder, likely_order
from relocbench.datasets.motion.worlds import doubt_of_world
from relocbench.datasets.pairs.pairing import make_pairs, steps_left_out
from relocbench.datasets.pairs.posed_frames import PosedFrames
from relocbench.datasets.sensors.pose_files import read_pose_file
from relocbench.datasets.sensors.pose_tables import PoseTable
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.files import check_distinct, check_name, fitting_name, plain_name
from relocbench.geometry import spaced
from relocbench.progress import Reporter


class Options(PairingOptions):
    """Options of ``relocbench build-dataset poses``."""

    quaternions: QuaternionOrder = Field(
        "xyzw", description="order of quaternions in files of 8 columns: qx qy qz qw, or qw qx qy qz"
    )
    times: tuple[Path, ...] = Field(
        (), description="files of times for poses of 12 columns, one each, in the order of the trajectories"
    )
    traversals: tuple[str, ...] = Field((), description="names of the traversals; default: the files' names")
    frame: str = Field("rig", description="name of the frame whose poses these are, such as cam0 or lidar")
    keyframe_distance: float = Field(
        0.0, ge=0, description="metres driven between keyframes; 0 takes every pose of the reference"
    )
    query_distance: float = Field(
        0.0, ge=0, description="metres driven between queries; 0 takes every pose (nearest rule)"
    )
    revisit_gap: float = Field(
        0.0,
        ge=0,
        description="of a single trajectory: pair only revisits, with a keyframe so many seconds older than its query "
        "at least (nearest rule); 0 pairs any two frames",
    )
    sigma: float | None = Field(
        None, gt=0, description="standard deviation of each pose's position along each axis, metres, if it is known"
    )
    sigma_rotation: float | None = Field(
        None, gt=0, description="standard deviation of each pose's rotation about each axis, degrees, if it is known"
    )

    @model_validator(mode="after")
    def _plain_frame(self) -> Self:
        check_name(self.frame, "frame")
        return self

    @model_validator(mode="after")
    def _one_rule(self) -> Self:
        if self.pair_rule == "step" and (self.revisit_gap or self.query_distance):
            raise ValueError(
                "pair_rule step pairs frames by their numbers: revisit_gap and query_distance do not apply"
            )
        return self


@dataclass(frozen=True, eq=False)
class _Drive:
    """One trajectory."""

    name: str
    table: PoseTable
    """``T_world_frame``"""

    def frames(self, apart_m: float, *, keyframes: bool) -> PosedFrames:
        """Its poses at least ``apart_m`` of its path apart."""
        rows = spaced(self.table.transforms[:, :3, 3], apart_m)
        chosen = tuple(self.table.times_ns[rows].tolist())
        pieces = np.searchsorted(self.table.breaks, rows, side="right")
        frames = self.table.transforms[rows], frozenset(chosen if keyframes else ())
        return PosedFrames(chosen, *frames, pieces=tuple(pieces.tolist()))


def build(sources: list[Path], options: DatasetOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Pair the poses of the first trajectory with those of the others, or its own. Raises as :class:`Importer`."""
    assert isinstance(options, Options)
    names = names_of_files(sources, options.traversals, "files of poses")
    options.check_conditions(names)
    if options.times and len(options.times) != len(sources):
        raise ConfigError(f"--times gives {len(options.times)} files for {len(sources)} trajectories")
    if options.revisit_gap and len(sources) > 1:
        raise ConfigError("--revisit-gap is for a single trajectory, which is paired with itself")
    if options.query_distance and len(sources) == 1 and not (options.revisit_gap or options.pair_rule):
        raise ConfigError(
            "--query-distance does not apply to a single trajectory paired by frame numbers; give --pair-rule nearest, "
            "or --revisit-gap for revisits"
        )
    writer = open_writer("poses", sources, options, out, fitting_name("poses-" + "-".join(names)))
    if writer.complete:
        return Dataset(out)
    job = Build(writer, options, reporter, run)
    files = options.times or (None,) * len(sources)
    with reporter.stage("reading poses", len(sources)) as advance:
        drives = []
        for name, source, times in zip(names, sources, files, strict=True):
            drives.append(_Drive(name, read_pose_file(source, options.given("quaternions"), times, reporter)))
            advance(1)
    _tell_doubts(drives, job)
    for drive in drives:
        writer.traversal(_description(drive, options), drive.table.by_time)
    reference, *others = drives
    with reporter.stage("pairs", len(others) or 1) as advance:
        for query in others or [reference]:
            pairs = _pairs(reference, query, options)
            writer.pairs(reference.name, query.name, options.frame, pairs)
            advance(1)
    return writer.finish()


def _description(drive: _Drive, options: Options) -> TraversalFile:
    return TraversalFile(
        name=drive.name,
        condition=options.condition_of(drive.name),
        cameras={},
        frames={options.frame: Transform.of(np.eye(4))},
        source=f"poses of {drive.table.path.name}",
    )


def _pairs(reference: _Drive, query: _Drive, options: Options) -> list[Pair]:
    """The pairs of two drives, or of one with itself, with the sigmas that follow from those of the poses."""
    same = query is reference
    steps = same and options.pair_rule in (None, "step") and not options.revisit_gap
    keyframes = reference.frames(options.keyframe_distance, keyframes=True)
    asked = keyframes if steps else query.frames(options.query_distance, keyframes=False)
    rule = options if steps or options.pair_rule else options.model_copy(update={"pair_rule": "nearest"})
    pairs = make_pairs(
        keyframes,
        asked,
        rule,
        same_traversal=same,
        source=f"poses of {reference.name}" + ("" if same else f" and {query.name}"),
        where=query.table.path,
        revisit_ns=round(options.revisit_gap * 1e9) if options.revisit_gap else None,
    )
    return [sigma_of_pair(pair, options.sigma, options.sigma_rotation) for pair in pairs]


def _tell_doubts(drives: Sequence[_Drive], job: Build[Options]) -> None:
    """Note what looks like poses that were misread: no number of a pair would tell."""
    order = job.options.quaternions
    for drive in drives:
        if (likely := likely_order(drive.table.transforms, order)) != order:
            job.reporter.note(
                f"{drive.name}: read as {order}, its rotations do not go with its way, and read as {likely} they do: "
                f"expected --quaternions {likely}"
            )
    reference, *others = drives
    for other in others:
        if doubt := doubt_of_world(reference.table.by_time, other.table.by_time):
            job.reporter.note(f"{reference.name} and {other.name} {doubt}")
    frames = reference.frames(job.options.keyframe_distance, keyframes=True)
    if not others and not job.options.revisit_gap and (missing := steps_left_out(frames, job.options)):
        job.reporter.note(f"{reference.name}: {missing}")


def sigma_of_pair(pair: Pair, sigma_m: float | None, sigma_deg: float | None) -> Pair:
    """A pair with its sigmas, the errors of its two poses being independent.

    With ``c = R_world_ref^T (c_query - c_ref)``, first-order propagation gives the covariance
    ``2 sigma_m^2 I + sigma_rad^2 (|c|^2 I - c c^T)``, whose mean variance on an axis is
    ``2 sigma_m^2 + 2/3 |c|^2 sigma_rad^2``; the relative rotation has ``sqrt(2)`` times the sigma of each.

    Args:
        sigma_m: of each pose's position along each axis, metres; None if unknown.
        sigma_deg: of each pose's rotation about each axis, degrees; None if unknown, and not counted.
    """
    translation = None
    if sigma_m is not None:
        lever = float(np.radians(sigma_deg or 0.0)) * (pair.distance_m or 0.0)
        translation = float(np.sqrt(2 * sigma_m**2 + 2 / 3 * lever**2))
    rotation = None if sigma_deg is None else float(np.sqrt(2) * sigma_deg)
    return replace(pair, sigma_translation_m=translation, sigma_rotation_deg=rotation)


def names_of_files(sources: Sequence[Path], given: Sequence[str], what: str) -> list[str]:
    """A name for each file: its stem, or where files share one, as ``poses.csv`` do, that of its folder.

    Args:
        given: names that replace these, one for each file; empty for none.
        what: what the files are, for messages.

    Raises:
        DatasetError: there is no file, it is none, one is given twice, or two have the same name.
        ConfigError: ``given`` does not fit.
    """
    if not sources:
        raise DatasetError(f"no file was given; expected one or more {what}")
    for number, source in enumerate(sources):
        if source.is_dir() or not source.exists():
            raise DatasetError(f"{'is a folder' if source.is_dir() else 'no such file'}; expected {what}", source)
        if source.resolve() in [earlier.resolve() for earlier in sources[:number]]:
            raise DatasetError("is given twice; expected different files", source)
    if given:
        return _checked(given, len(sources))
    stems = Counter(source.stem.casefold() for source in sources)
    names: dict[str, Path] = {}
    for source in sources:
        text = source.stem if stems[source.stem.casefold()] == 1 else source.resolve().parent.name
        try:
            name = plain_name(text, "traversal name")
        except ValueError:
            raise DatasetError(
                "the file's name cannot name a traversal; give names: --traversals A,B", source
            ) from None
        if name in names:
            raise DatasetError(f"is called '{name}' like {names[name]}; give names: --traversals A,B", source)
        names[name] = source
    try:
        check_distinct(names, "traversals")
    except ValueError as bad:
        raise DatasetError(f"{bad}; give names: --traversals A,B") from None
    return list(names)


def _checked(given: Sequence[str], wanted: int) -> list[str]:
    if len(given) != wanted:
        raise ConfigError(f"--traversals gives {len(given)} names for {wanted} files")
    if len(set(given)) < len(given):
        raise ConfigError("--traversals gives a name twice")
    try:
        check_distinct(given, "traversals")
        return [check_name(name, "traversal name") for name in given]
    except ValueError as bad:
        raise ConfigError(f"--traversals: {bad}") from None

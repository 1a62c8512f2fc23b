"""Kind ``pair-files``: the true relative poses of relocalization files, for predictions that were made elsewhere."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from relocbench.arrays import Array
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import DatasetOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_table import read_pairs
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.schema import Transform, TraversalFile
from relocbench.datasets.importers.assembly import open_writer
from relocbench.datasets.motion.orientation import QuaternionOrder
from relocbench.datasets.sensors.pose_files import read_pose_file
from relocbench.datasets.sensors.times import UNITS, unit_of_dates
from relocbench.errors import ConfigError, DatasetError, available
from relocbench.execution import Run
from relocbench.files import check_distinct, check_name, fitting_name, plain_name
from relocbench.geometry import invert
from relocbench.progress import Reporter

_CLOSE_NS = 1000
"""within which times of a pair file and of a trajectory are one: seconds in float64 are only good to 240 ns today"""
_PREFIX = re.compile(r"^reloc(alizationFile)?_")
_NAMES = "expected REF__QUERY__FRAME.txt or [relocalizationFile_]REF_to_QUERY.txt, or names: --traversals REF,QUERY"
SetKey = tuple[str, str, str]
"""reference, query, frame"""


class Options(DatasetOptions):
    """Options of ``relocbench build-dataset pair-files``."""

    traversals: tuple[str, ...] = Field(
        (), description="names of the reference and the query of a single file; default: from the file's name"
    )
    frame: str = Field(
        "cam0", description="name of the frame whose poses these are, for files whose names do not tell it"
    )
    trajectories: tuple[str, ...] = Field(
        (), description="poses of traversals, as NAME=FILE: they place pairs on maps and in exports"
    )
    quaternions: QuaternionOrder = Field(
        "xyzw", description="order of quaternions in trajectories of 8 columns; pair files have qx qy qz qw"
    )
    sigma: float | None = Field(
        None, gt=0, description="standard deviation of the true positions along each axis, metres, if it is known"
    )
    sigma_rotation: float | None = Field(
        None, gt=0, description="standard deviation of the true rotations about each axis, degrees, if it is known"
    )

    @model_validator(mode="after")
    def _plain_frame(self) -> Self:
        check_name(self.frame, "frame")
        return self


@dataclass(frozen=True, eq=False)
class _Listed:
    """The pairs of one file."""

    file: Path
    key: SetKey
    pairs: list[Pair]


def build(sources: list[Path], options: DatasetOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Write a pair set for each file, with its poses, or none, as the truth. Raises as :class:`Importer`."""
    assert isinstance(options, Options)
    keys = _keys(sources, options)
    names = sorted({name for key in keys for name in key[:2]})
    options.check_conditions(names)
    placed = _trajectory_files(options, names)
    default = fitting_name("pairs-" + "-".join(dict.fromkeys(name for key in keys for name in key[:2])))
    writer = open_writer("pair-files", [*sources, *placed.values()], options, out, default)
    if writer.complete:
        return Dataset(out)
    job = Build(writer, options, reporter, run)
    listed = []
    with reporter.stage("reading pairs", len(sources)) as advance:
        for source, key in zip(sources, keys, strict=True):
            listed.append(_Listed(source, key, _read(source, options)))
            advance(1)
    poses = _poses(listed, placed, job)
    for name in names:
        writer.traversal(_description(name, listed, options), poses[name])
    for one in listed:
        writer.pairs(*one.key, one.pairs)
        withheld = sum(p.accepted and p.T_query_ref is None for p in one.pairs)
        if withheld:
            reporter.note(f"{one.file.name}: {withheld} of {len(one.pairs)} pairs have no true pose: it is withheld")
    return writer.finish()


def _keys(sources: Sequence[Path], options: Options) -> list[SetKey]:
    """Which pair set each file is of."""
    if not sources:
        raise DatasetError("no file was given; expected one or more files of pairs")
    if options.traversals and (len(sources) != 1 or len(options.traversals) != 2):
        raise ConfigError("--traversals names the reference and the query of a single file: REF,QUERY")
    keys: dict[SetKey, Path] = {}
    for source in sources:
        if source.is_dir() or not source.exists():
            what = "is a folder" if source.is_dir() else "no such file"
            raise DatasetError(f"{what}; expected a file of pairs (ref_ts query_ts tx ty tz qx qy qz qw)", source)
        key = _key(source, options)
        if key in keys:
            raise DatasetError(
                f"holds pairs of {'__'.join(key)}, as {keys[key]} does; expected one file for each pair set", source
            )
        keys[key] = source
    try:
        check_distinct(sorted({name for key in keys for name in key[:2]}), "traversals")
    except ValueError as bad:
        raise DatasetError(str(bad)) from None
    return list(keys)


def _key(source: Path, options: Options) -> SetKey:
    parts = source.stem.split("__")
    frame = options.frame
    if options.traversals:
        parts = list(options.traversals)
    elif len(parts) == 3:
        *parts, frame = parts
    else:
        parts = _PREFIX.sub("", source.stem).split("_to_")
    if len(parts) != 2:
        raise DatasetError(f"its name does not say which traversals its pairs are of; {_NAMES}", source)
    try:
        reference, query = (plain_name(part, "traversal name") for part in parts)
        return reference, query, check_name(frame, "frame name")
    except ValueError as bad:
        raise DatasetError(f"{bad}; {_NAMES}", source) from None


def _read(source: Path, options: Options) -> list[Pair]:
    """The pairs of a file, with groups, sigmas and rejections where the table of a pair set lies beside it."""
    pairs = read_pairs(source, source.with_suffix(".csv"), allow_non_finite=True)
    if not pairs:
        raise DatasetError("holds no pair", source)
    return [
        replace(
            p,
            source=source.name,
            overlap=None,
            sigma_translation_m=p.sigma_translation_m if options.sigma is None else options.sigma,
            sigma_rotation_deg=p.sigma_rotation_deg if options.sigma_rotation is None else options.sigma_rotation,
        )
        for p in pairs
    ]


def _trajectory_files(options: Options, names: Sequence[str]) -> dict[str, Path]:
    """traversal -> its file of poses."""
    found: dict[str, Path] = {}
    for text in options.trajectories:
        name, equals, file = text.partition("=")
        if not equals or not file:
            raise ConfigError(f"--trajectories: '{text}' is not NAME=FILE")
        if name not in names:
            raise ConfigError(f"--trajectories: no traversal '{name}' in the pairs{available(name, names)}")
        if name in found:
            raise ConfigError(f"--trajectories gives poses of '{name}' twice")
        found[name] = Path(file)
    return found


def _description(name: str, listed: Sequence[_Listed], options: Options) -> TraversalFile:
    frames = sorted({one.key[2] for one in listed if name in one.key[:2]})
    return TraversalFile(
        name=name,
        condition=options.condition_of(name),
        cameras={},
        frames={frame: Transform.of(np.eye(4)) for frame in frames},
        source=", ".join(one.file.name for one in listed if name in one.key[:2])[:200],
    )


def _poses(listed: Sequence[_Listed], placed: Mapping[str, Path], job: Build[Options]) -> dict[str, dict[int, Array]]:
    """Poses of every traversal: its own, or where only its keyframes' are known, those that its pairs give it.

    The last of these are relative to the reference's world, where the query of the first pair of each time stands.
    """
    poses: dict[str, dict[int, Array]] = {name: {} for one in listed for name in one.key[:2]}
    for name, file in placed.items():
        own = read_pose_file(file, job.options.given("quaternions"), reporter=job.reporter).by_time
        times = {t for one in listed for p in one.pairs for n, t in zip(one.key[:2], p.key, strict=True) if n == name}
        if (unit_ns := unit_of_dates(times) or 1) != 1:
            # Pairs keep their times as they stand, by which predictions name them.
            own = {time // unit_ns: pose for time, pose in own.items()}
            job.reporter.note(f"{name}: times of pairs look like {UNITS[unit_ns]} and are kept as they stand")
        poses[name], unmatched = at_times(own, times)
        if unmatched:
            job.reporter.note(f"{file.name}: no pose at {unmatched} of the {len(times)} times of '{name}'")
    for one in listed:
        reference, query = poses[one.key[0]], poses[one.key[1]]
        if one.key[1] in placed:
            continue
        for pair in one.pairs:
            known = pair.accepted and pair.T_query_ref is not None and pair.ref_timestamp_ns in reference
            if known and not pair.is_negative and pair.query_timestamp_ns not in query:
                assert pair.T_query_ref is not None
                query[pair.query_timestamp_ns] = reference[pair.ref_timestamp_ns] @ invert(pair.T_query_ref)
    return poses


def at_times(poses: Mapping[int, Array], times: set[int]) -> tuple[dict[int, Array], int]:
    """Poses with their times replaced by those of ``times`` that are less than a microsecond away.

    Returns the poses, in time order, and how many of ``times`` have none.
    """
    known = np.array(sorted(poses), dtype=np.int64)
    exact: dict[int, int] = {}
    for time in sorted(times):
        at = int(np.searchsorted(known, time))
        near = [int(known[i]) for i in (at - 1, at) if 0 <= i < len(known)]
        best = min(near, key=lambda t: abs(t - time), default=None)
        if best is not None and abs(best - time) < _CLOSE_NS and best not in exact:
            exact[best] = time
    moved = {exact.get(time, time): T for time, T in poses.items()}
    return dict(sorted(moved.items())), len(times) - len(exact)

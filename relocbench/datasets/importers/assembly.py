"""Steps that importers share: the build's configuration, checks of options and folders, and pair sets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from relocbench.datasets.core.build_options import ImportOptions, RuleOptions
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.pairs.correspondences import write_pair_set
from relocbench.datasets.pairs.pairing import make_pairs, posed_frames
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.progress import Reporter


def configuration(kind: str, sources: Sequence[Path], options: ImportOptions) -> dict[str, Any]:
    """Everything that determines the build, in the form that ``build.yaml`` has."""
    return {
        "kind": kind,
        "sources": [str(source.resolve()) for source in sources],
        "options": options.model_dump(mode="json"),
    }


def open_writer(
    kind: str, sources: Sequence[Path], options: ImportOptions, out: Path, default_name: str
) -> DatasetWriter:
    """The writer of a build. Raises DatasetError or ConfigError like :class:`DatasetWriter`."""
    name = options.name or default_name
    return DatasetWriter(out, name, configuration(kind, sources, options), options.licence)


def condition_of(options: ImportOptions, traversal: str) -> Condition:
    """The condition that the options give for a traversal; unknown by default."""
    return options.conditions.get(traversal, Condition())


def check_conditions(options: ImportOptions, traversals: Sequence[str]) -> None:
    """Raise ConfigError if the options give a condition for a traversal that does not exist."""
    for name in options.conditions:
        if name not in traversals:
            raise ConfigError(f"conditions: no traversal '{name}'; there is {', '.join(traversals)}")


def check_folder(path: Path, expected: str) -> None:
    """Raise DatasetError if ``path`` is not a folder."""
    if not path.is_dir():
        raise DatasetError(f"{'is a file' if path.exists() else 'no such folder'}; expected {expected}", path)


def write_pairs(
    writer: DatasetWriter,
    reference: str,
    query: str,
    camera: str,
    options: RuleOptions,
    *,
    source: str,
    where: Path,
    reporter: Reporter,
    run: Run,
    numbers: dict[int, int] | None = None,
    sigma_translation_m: float | None = None,
    sigma_rotation_deg: float | None = None,
) -> str:
    """Write a pair set by the pairing rule of the options, with its correspondences, and return its name.

    The traversals must have been written before, with images and depth.

    Args:
        source: how the poses were obtained.
        where: the recording's folder, for messages.
        numbers: timestamp_ns -> frame number, if the recording's frame numbers have gaps.
        sigma_translation_m, sigma_rotation_deg: one standard deviation of the true poses, if known.
    """
    traversals = {name: Traversal(writer.layout.traversal(name)) for name in (reference, query)}
    pairs = make_pairs(
        posed_frames(traversals[reference], camera, numbers),
        posed_frames(traversals[query], camera, numbers if query == reference else None),
        options,
        same_traversal=query == reference,
        source=source,
        where=where,
        sigma_translation_m=sigma_translation_m,
        sigma_rotation_deg=sigma_rotation_deg,
    )
    _note_unpaired(
        traversals[query], camera, {p.query_timestamp_ns for p in pairs}, options, query == reference, reporter
    )
    return write_pair_set(
        writer,
        reference,
        query,
        camera,
        pairs,
        count=options.correspondences,
        seed=options.seed,
        reporter=reporter,
        run=run,
    )


def _note_unpaired(
    query: Traversal, camera: str, paired: set[int], options: RuleOptions, same_traversal: bool, reporter: Reporter
) -> None:
    """Report query frames without a pair. Under the nearest rule, each should have a keyframe."""
    if options.pair_rule == "step" or (same_traversal and options.pair_rule is None):
        return
    frames = [t for t in query.timestamps(camera) if t in query.poses]
    left_out = sum(t not in paired for t in frames)
    if left_out:
        reporter.note(
            f"{query.name}: {left_out} of {len(frames)} query frames are in no pair: no keyframe is within "
            f"--max-distance {options.max_distance:g} m and --max-angle {options.max_angle:g} deg"
        )

"""Names of traversals and files named by time or number, which several recording formats share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from relocbench.datasets.core.layout import IMAGE_SUFFIXES
from relocbench.datasets.sensors.times import times_in_ns
from relocbench.errors import DatasetError
from relocbench.files import check_distinct, plain_name, whole_number
from relocbench.progress import SILENT, Reporter


def traversal_names(sources: Sequence[Path], endings: Sequence[str] = ()) -> list[str]:
    """A name for each source, that of its folder; characters that pair-set file names cannot hold become ``-``.

    Args:
        endings: of files that are recordings too, named without them; where there are any, nothing has to exist.

    Raises:
        DatasetError: there is no source, a source is not a folder, or two have the same name.
    """
    if not sources:
        raise DatasetError(f"no recording was given; expected one or more folders{' or files' if endings else ''}")
    names: dict[str, Path] = {}
    for source in sources:
        found = source.resolve()
        if not endings and not source.is_dir():
            raise DatasetError("no such folder; expected a recording", source)
        try:
            ending = max((end for end in endings if found.name.endswith(end)), key=len, default="")
            name = plain_name(found.name.removesuffix(ending), "traversal name")
        except ValueError:
            raise DatasetError("its name cannot name a traversal; rename or link it", source) from None
        if name in names and names[name].resolve() == found:
            raise DatasetError("is given twice; expected different recordings", source)
        if name in names:
            raise DatasetError(f"is the second recording called '{name}' (first: {names[name]})", source)
        names[name] = source
    try:
        check_distinct(names, "recordings")
    except ValueError as bad:
        raise DatasetError(str(bad)) from None
    return list(names)


def timed_files(
    folder: Path,
    suffixes: Sequence[str] = IMAGE_SUFFIXES,
    own_ns: int = 1,
    *,
    dates_only: bool = False,
    like: Iterable[Path] = (),
    reporter: Reporter = SILENT,
) -> dict[int, Path]:
    """The files of a folder by the times in their names, in time order; a missing folder has none.

    Other files and hidden ones are skipped.

    Args:
        own_ns, dates_only: as of :func:`~.times.times_in_ns`.
        like: files that are named by the same clock, by whose names too the unit of whole numbers is told.
        reporter: is told of a unit of time that was told from digits.

    Raises:
        DatasetError: a name is not a time or one before 1970, names are in different units, or two files have one time.
    """
    if not folder.is_dir():
        return {}
    files = [p for p in sorted(folder.iterdir()) if not p.name.startswith(".") and p.suffix.lower() in suffixes]
    texts = [path.stem for path in files]
    others = [path.stem for path in like]
    times = times_in_ns(texts, lambda i: (files[i], None), own_ns, dates_only=dates_only, like=others)
    if times.by_digits:
        reporter.note(f"{folder}: times in names of files are read as {times.unit}, told by their number of digits")
    found: dict[int, Path] = {}
    for time, path in zip(times.ns, files, strict=True):
        if time < 0:
            raise DatasetError("its name is a time before 1970", path)
        if time in found:
            raise DatasetError(f"has the same time as {found[time].name}", path)
        found[time] = path
    return dict(sorted(found.items()))


def numbered_files(folder: Path, suffix: str) -> dict[int, Path]:
    """The files of a folder by the numbers in their names, in the order of these; a missing folder has none."""
    found = {number: p for p in folder.glob(f"*{suffix}") if (number := whole_number(p.stem)) is not None}
    return dict(sorted(found.items()))


def with_times(files: dict[int, Path], times: Mapping[int, int], what: str, reporter: Reporter) -> dict[int, Path]:
    """The files, by frame number, of frames that have a time; of how many there is none is noted."""
    kept = {frame: path for frame, path in files.items() if frame in times}
    if len(kept) < len(files):
        reporter.note(f"{what}: {len(files) - len(kept)} of {len(files)} frames have no time and are left out")
    return kept

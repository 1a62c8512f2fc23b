"""Names of traversals that are given as files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from relocbench.errors import ConfigError, DatasetError
from relocbench.files import check_distinct, check_name, plain_name


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

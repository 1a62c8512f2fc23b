"""Which files a folder has from an earlier site: only these are ever replaced or removed."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from relocbench.errors import ConfigError
from relocbench.files import write_text

MANIFEST = "files.txt"
_FIRST = "Files of a site of relocbench, which the next one replaces or removes:"


def earlier_files(site: Path) -> set[Path]:
    """The files of the site that the folder holds; empty for a new or empty folder.

    Hidden files, such as the lock of the command that writes, do not count.

    Raises:
        ConfigError: the folder holds files and no site, so that pages could take the place of somebody's files.
    """
    if not site.exists():
        return set()
    manifest = site / MANIFEST
    if not manifest.is_file():
        entry = next((path for path in sorted(site.iterdir()) if not path.name.startswith(".")), None)
        if entry is None:
            return set()
        raise ConfigError(
            f"holds '{entry.name}' and no earlier site; expected a new or an empty folder for pages", site
        )
    first, *names = manifest.read_text(encoding="utf-8", errors="replace").splitlines() or [""]
    if first != _FIRST:
        raise ConfigError("is not a list of the files of a site; expected a new or an empty folder for pages", manifest)
    return {site / name for name in names if _is_inside(name)}


def write_manifest(site: Path, files: set[Path]) -> None:
    """List the files of the site."""
    names = sorted(path.relative_to(site).as_posix() for path in files)
    write_text(site / MANIFEST, "\n".join([_FIRST, *names]) + "\n")


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return bool(name) and not path.is_absolute() and ".." not in path.parts

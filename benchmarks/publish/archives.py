"""Archives of results for publication: of a method in a dataset its records, answers and errors.

python benchmarks/publish/archives.py RESULTS OUT            # OUT/DATASET/METHOD.tar.xz of every method
python benchmarks/publish/archives.py RESULTS OUT.tar.xz     # one archive of everything
"""

from __future__ import annotations

import lzma
import sys
import tarfile
from collections.abc import Iterable
from pathlib import Path

SUFFIXES = (".yaml", ".txt", ".csv")
"""of records; predictions; and answers, errors and matching quality"""


def pack(results: Path, dataset: str, label: str, out: Path) -> None:
    """Pack all results of a method in a dataset; the same results give the same bytes.

    Args:
        dataset: its name, or a pattern of the names of several that go into one archive.

    Raises:
        ValueError: the method has no results there, or results on two renderings of one dataset.
    """
    folders = [folder for folder in sorted(results.glob(f"{dataset}@*")) if (folder / label).is_dir()]
    names = [folder.name.partition("@")[0] for folder in folders]
    if not folders or len(set(names)) < len(names):
        found = ", ".join(folder.name for folder in folders) or "none"
        raise ValueError(f"{results}: expected one folder with results of {label} for each {dataset}, found {found}")
    files = [path for folder in folders for path in (folder / "dataset.yaml", *sorted((folder / label).iterdir()))]
    _write(files, results, out)


def pack_folder(results: Path, out: Path, *patterns: str) -> None:
    """Pack all records, answers and errors below a folder, or those of some patterns, into one archive.

    The same results give the same bytes.
    """
    found = {path for pattern in patterns or ("**/*",) for path in results.glob(pattern) if path.is_file()}
    _write(sorted(found), results, out)


def _write(files: Iterable[Path], results: Path, out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    part = out.with_suffix(".part")
    with lzma.open(part, "wb", preset=9) as stream, tarfile.open(fileobj=stream, mode="w") as archive:
        for path in files:
            if path.suffix not in SUFFIXES:
                continue
            entry = tarfile.TarInfo(path.relative_to(results).as_posix())
            entry.size = path.stat().st_size
            with path.open("rb") as content:
                archive.addfile(entry, content)
    part.rename(out)


def unpack(archives: Path, to: Path, label: str = "*") -> Path:
    """The folder ``to`` with the results of all archives of a folder, or of those of one method."""
    found = sorted(archives.glob(f"*/{label}.tar.xz"))
    if not found:
        sys.exit(f"{archives}: holds no archive FOLDER/METHOD.tar.xz of results")
    for path in found:
        extract(path, to)
    return to


def extract(path: Path, to: Path) -> None:
    """The content of one archive, in the folder ``to``; exits with its name where it is damaged."""
    try:
        with tarfile.open(path) as archive:
            archive.extractall(to, filter="data")
    except (OSError, EOFError, lzma.LZMAError, tarfile.TarError) as bad:
        sys.exit(f"{path}: expected a whole archive of results: {bad}")


if __name__ == "__main__":
    all_results, to = map(Path, sys.argv[1:])
    if to.suffix == ".xz":
        pack_folder(all_results, to)
        sys.exit()
    for folder in sorted(all_results.glob("*@*/*/")):
        name = folder.parent.name.partition("@")[0]
        pack(all_results, name, folder.name, to / name / f"{folder.name}.tar.xz")

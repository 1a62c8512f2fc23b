"""The photographs of folders: found, checked before anything is made of them, and divided into splits."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from relocbench.arrays import Image
from relocbench.datasets.core import images
from relocbench.datasets.core.image_header import MOST_FILE_BYTES, check_affordable, check_content, read_header
from relocbench.datasets.core.layout import IMAGE_SUFFIXES
from relocbench.datasets.importers.assembly import check_folder
from relocbench.datasets.moved_views.exif import Exif, read_exif
from relocbench.errors import ConfigError, DatasetError
from relocbench.files import read_bytes
from relocbench.progress import Reporter


@dataclass(frozen=True)
class Photograph:
    """A photograph whose file is whole, by its header."""

    name: str
    """path below its folder, which precedes it if there are several"""
    path: Path
    digest: str
    """SHA-256 of the file"""
    size: tuple[int, int]
    """(width, height), upright"""
    exif: Exif

    def read(self) -> Image:
        """The upright photograph, (H, W, 3) RGB.

        Raises:
            DatasetError: the file is damaged, or another one than when it was found.
        """
        image = self.exif.upright(images.as_rgb(images.read_image(self.path)))
        if image.shape[1::-1] != self.size:
            raise DatasetError("was changed while the dataset was made", self.path)
        return image


def find_photographs(folders: Sequence[Path], least: tuple[int, int], reporter: Reporter) -> list[list[Photograph]]:
    """The photographs of each folder and the folders in it, in the order of their names.

    Of files with the same content the first is taken.

    Args:
        least: width and height that every photograph needs at least.

    Raises:
        DatasetError: a folder is missing or holds no photograph, or a photograph is damaged or too small.
        ConfigError: two folders have the same name.
    """
    for folder in folders:
        check_folder(folder, "a folder of photographs")
    titles = [folder.resolve().name for folder in folders]
    if len(set(titles)) < len(titles):
        raise ConfigError(f"folders of photographs have different names, got {', '.join(titles)}")
    files = [_files(folder) for folder in folders]
    seen: set[str] = set()
    found: list[list[Photograph]] = []
    with reporter.stage("photographs", sum(map(len, files))) as advance:
        for folder, title, paths in zip(folders, titles, files, strict=True):
            found.append([])
            for path in paths:
                name = path.relative_to(folder).as_posix()
                photograph = _examined(path, f"{title}/{name}" if len(folders) > 1 else name, least)
                if photograph.digest not in seen:
                    found[-1].append(photograph)
                seen.add(photograph.digest)
                advance(1)
    total = sum(map(len, files))
    if len(seen) < total:
        reporter.note(f"{total - len(seen)} of {total} photographs have the content of another one and are left out")
    return found


def divided(folders: Sequence[Sequence[Photograph]], validation: float, test: float) -> dict[str, list[Photograph]]:
    """Split name -> its photographs: the last ones of each folder by name are the splits ``validation`` and ``test``.

    Frames of one walk have neighbouring names, so that the splits share as little of it as can be.

    Args:
        validation, test: shares of each folder's photographs; if one is not 0, at least one photograph.

    Raises:
        ConfigError: nothing is left to learn from.
    """
    splits: dict[str, list[Photograph]] = {"train": [], "validation": [], "test": []}
    for photographs in folders:
        for_test, for_validation = (_count(share, len(photographs)) for share in (test, validation))
        end = len(photographs) - for_test
        splits["train"] += photographs[: max(end - for_validation, 0)]
        splits["validation"] += photographs[max(end - for_validation, 0) : max(end, 0)]
        splits["test"] += photographs[max(end, 0) :]
    if not splits["train"]:
        raise ConfigError(
            f"{sum(map(len, folders))} photographs leave none for the split 'train'; expected more of them, or smaller "
            f"--validation and --test"
        )
    return {name: photographs for name, photographs in splits.items() if photographs}


def digest_of(folders: Sequence[Sequence[Photograph]]) -> str:
    """SHA-256 of the names and contents of all photographs, by which a resumed build sees that they are the same."""
    lines = (f"{p.digest} {p.name}\n" for photographs in folders for p in photographs)
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _files(folder: Path) -> list[Path]:
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES and not path.is_dir())
    if not paths:
        raise DatasetError(f"holds no photograph; expected files {', '.join(IMAGE_SUFFIXES)}", folder)
    return paths


def _examined(path: Path, name: str, least: tuple[int, int]) -> Photograph:
    data = read_bytes(path, "a photograph", DatasetError, MOST_FILE_BYTES)
    header = read_header(data, path)
    check_affordable(header, path)
    check_content(data, header, path)
    exif = read_exif(data)
    width, height = exif.size(header.size)
    if width < least[0] or height < least[1]:
        raise DatasetError(
            f"is {width}x{height}, too small for keyframes with room around them; expected at least "
            f"{least[0]}x{least[1]} pixels, or a smaller --size",
            path,
        )
    return Photograph(name, path, hashlib.sha256(data).hexdigest(), (width, height), exif)


def _count(share: float, total: int) -> int:
    return max(1, round(share * total)) if share > 0 and total else 0

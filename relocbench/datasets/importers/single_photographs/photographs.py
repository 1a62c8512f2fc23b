"""The photographs of folders: found, checked before anything is made of them, and divided into splits."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from relocbench.arrays import Image
from relocbench.datasets.core import images
from relocbench.datasets.core.image_header import MOST_FILE_BYTES, check_affordable, check_content, read_header
from relocbench.datasets.core.layout import IMAGE_SUFFIXES
from relocbench.datasets.importers.assembly import check_folder
from relocbench.datasets.moved_views.exif import Exif, read_exif
from relocbench.datasets.moved_views.faces import R_FACE_CUBE, SIDES
from relocbench.errors import ConfigError, DatasetError
from relocbench.files import read_bytes
from relocbench.progress import Reporter

_VIEW = re.compile(rf"(?P<place>.+)_(?:(?P<face>{'|'.join(R_FACE_CUBE)})|yaw\d+)")
"""names, without suffix, of files that are one view of a place"""
_ORDER = ("", *R_FACE_CUBE)


@dataclass(frozen=True)
class StoredImage:
    """An image file that is whole, by its header."""

    path: Path
    digest: str
    """SHA-256 of the file"""
    size: tuple[int, int]
    """(width, height), upright"""
    exif: Exif

    def read(self) -> Image:
        """The upright image, (H, W, 3) RGB.

        Raises:
            DatasetError: the file is damaged, or another one than when it was found.
        """
        image = self.exif.upright(images.as_rgb(images.read_image(self.path)))
        if image.shape[1::-1] != self.size:
            raise DatasetError("was changed while the dataset was made", self.path)
        return image


@dataclass(frozen=True)
class Photograph:
    """A photograph, or a cube map, which is a photograph of all sides of one place."""

    name: str
    """path below its folder, which precedes it if there are several; of a cube map without the face"""
    place: str
    """what it shows: that of files NAME_posx.jpg or NAME_yaw030.jpg is NAME, in whichever folder they are"""
    images: tuple[StoredImage, ...]
    """one, or the faces, which have the same size"""
    faces: tuple[str, ...] = ()
    """of a cube map"""

    @property
    def digest(self) -> str:
        """SHA-256 of the file, or of the digests of the faces' files."""
        if not self.faces:
            return self.images[0].digest
        return hashlib.sha256("".join(image.digest for image in self.images).encode()).hexdigest()


def find_photographs(
    folders: Sequence[Path], least: tuple[int, int], least_side: int, reporter: Reporter
) -> list[list[Photograph]]:
    """The photographs of each folder and the folders in it, in the order of their names.

    Files NAME_posx, NAME_negx, NAME_posz, NAME_negz and perhaps NAME_posy and NAME_negy, all in one folder, are the
    faces of one cube map. Of photographs with the same content the first is taken.

    Args:
        least: width and height that every photograph needs at least.
        least_side: width and height that every face of a cube map needs at least.

    Raises:
        DatasetError: a folder is missing or holds no photograph, a photograph is damaged or too small, or the faces of
            a cube map are not complete, not square or of different sizes.
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
            for faces in paths:
                first = next(iter(faces.values()))
                name = first.relative_to(folder).as_posix()
                photograph = _examined(faces, f"{title}/{name}" if len(folders) > 1 else name, least, least_side)
                if photograph.digest not in seen:
                    found[-1].append(photograph)
                seen.add(photograph.digest)
                advance(1)
    total = sum(map(len, files))
    if len(seen) < total:
        reporter.note(f"{total - len(seen)} of {total} photographs have the content of another one and are left out")
    return found


def divided(folders: Sequence[Sequence[Photograph]], validation: float, test: float) -> dict[str, list[Photograph]]:
    """Split name -> its photographs: the last places of each folder by name are the splits ``validation`` and ``test``.

    Frames of one walk have neighbouring names, so that the splits share as little of it as can be. A place that several
    folders have is in one split: the last of those that its folders give it.

    Args:
        validation, test: shares of each folder's places; if one is not 0, at least one place.

    Raises:
        ConfigError: nothing is left to learn from.
    """
    names = "train", "validation", "test"
    given: dict[str, int] = {}
    for photographs in folders:
        places = list(dict.fromkeys(photograph.place for photograph in photographs))
        for_test, for_validation = (_count(share, len(places)) for share in (test, validation))
        for behind, place in enumerate(reversed(places)):
            split = 2 if behind < for_test else 1 if behind < for_test + for_validation else 0
            given[place] = max(split, given.get(place, 0))
    splits = {
        name: [p for photographs in folders for p in photographs if given[p.place] == number]
        for number, name in enumerate(names)
    }
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


def _files(folder: Path) -> list[dict[str, Path]]:
    """The files of each photograph by the names of faces, in the order of cube maps'; that of a single one is ''."""
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES and not path.is_dir())
    if not paths:
        raise DatasetError(f"holds no photograph; expected files {', '.join(IMAGE_SUFFIXES)}", folder)
    found: dict[Path, dict[str, Path]] = {}
    for path in paths:
        view = _VIEW.fullmatch(path.stem)
        face = (view and view["face"]) or ""
        faces = found.setdefault(path.with_name(view["place"]) if view and face else path, {})
        if face in faces:
            raise DatasetError(f"is the face {face} of a cube map, as {faces[face].name} is; expected one file", path)
        faces[face] = path
    return [dict(sorted(faces.items(), key=lambda item: _ORDER.index(item[0]))) for faces in found.values()]


def _examined(files: dict[str, Path], name: str, least: tuple[int, int], least_side: int) -> Photograph:
    stored = [_stored(path) for path in files.values()]
    view = _VIEW.fullmatch(stored[0].path.stem)
    if "" in files:
        if any(have < need for have, need in zip(stored[0].size, least, strict=True)):
            raise DatasetError(
                f"is {_words(stored[0].size)}, too small for keyframes with room around them; expected at least "
                f"{_words(least)} pixels, or a smaller --size",
                stored[0].path,
            )
        return Photograph(name, view["place"] if view else name, tuple(stored))
    assert view is not None
    missing = [face for face in SIDES if face not in files]
    if missing:
        raise DatasetError(
            f"is a face of a cube map whose face {missing[0]} is missing; expected {view['place']}_{missing[0]} "
            f"({', '.join(IMAGE_SUFFIXES)}) beside it",
            stored[0].path,
        )
    for face in stored:
        if face.size[0] != face.size[1] or face.size[0] < least_side:
            raise DatasetError(
                f"is {_words(face.size)}; expected a face of a cube map, a square with sides of at least {least_side} "
                f"pixels for this --size",
                face.path,
            )
        if face.size != stored[0].size:
            raise DatasetError(
                f"is {_words(face.size)}; expected {_words(stored[0].size)} as {stored[0].path.name}, another face of "
                f"the same cube map",
                face.path,
            )
    cube = PurePosixPath(name).with_name(view["place"]).as_posix()
    return Photograph(cube, view["place"], tuple(stored), tuple(files))


def _stored(path: Path) -> StoredImage:
    data = read_bytes(path, "a photograph", DatasetError, MOST_FILE_BYTES)
    header = read_header(data, path)
    check_affordable(header, path)
    check_content(data, header, path)
    exif = read_exif(data)
    return StoredImage(path, hashlib.sha256(data).hexdigest(), exif.size(header.size), exif)


def _words(size: tuple[int, int]) -> str:
    return "x".join(map(str, size))


def _count(share: float, total: int) -> int:
    return max(1, round(share * total)) if share > 0 and total else 0

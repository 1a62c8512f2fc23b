"""Writing a blind export of a retrieval set, and computing its keys again where answers to it are scored."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

from relocbench.datasets.core.images import png_bytes
from relocbench.datasets.cross_view import CrossViewSet
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.errors import ConfigError, DatasetError
from relocbench.evaluation.common.blind_names import BlindName, BlindSecret, blind_name, check_truth, truth_of
from relocbench.evaluation.common.opening import check_outside
from relocbench.evaluation.common.results import write_record
from relocbench.evaluation.retrieval.blind_set import (
    FILE,
    HEADER,
    BlindSetFile,
    BlindTask,
    fingerprint_of,
    image_file,
    keys_file,
)
from relocbench.evaluation.retrieval.opening import OpenedSet
from relocbench.files import sha256_file, write_bytes, write_text
from relocbench.progress import Reporter
from relocbench.retrieval import ImageView, RetrievalTask

_KEY_CHARACTERS = 20
_HELD = {FILE, "images", "images.csv", "tasks"}


class BlindImages:
    """The keys of one blind export of a retrieval set.

    Along drives they follow from the pair files, across views from which image is of which place: whoever is given the
    export has neither.

    Args:
        opened: the set, with its truth.
        edition: exports of other editions have other keys, so that answers to one are not answers to another.

    Raises:
        DatasetError: the truth is withheld.
    """

    def __init__(self, opened: OpenedSet, edition: int = 1) -> None:
        if opened.source is None:
            raise DatasetError(f"the truth of '{opened.name}' is withheld, and keys of a blind export follow from it")
        if isinstance(opened.source, StreetPlaces):
            check_truth(opened.source.dataset)
        self.opened, self.edition, self._source = opened, edition, opened.source

    @cached_property
    def name(self) -> BlindName:
        """What the export is called."""
        return self._secret.name(self.opened.name, self.edition)

    def key(self, image: str) -> str:
        """The key of an image, by its name in the set."""
        return self._secret.digest(f"image {image}").hex()[:_KEY_CHARACTERS]

    def queries(self, task: RetrievalTask) -> dict[str, str]:
        """Keys of the queries of a task -> their names in the set."""
        return {self.key(one.key): one.key for one in task.queries}

    def gallery(self, task: RetrievalTask) -> dict[str, str]:
        """Keys of the gallery of a task -> their names in the set."""
        return {self.key(one.key): one.key for one in task.gallery}

    @cached_property
    def _secret(self) -> BlindSecret:
        named = f"{self.opened.name} {self.opened.fingerprint}"
        if isinstance(self._source, StreetPlaces):
            truth: Iterable[bytes] = truth_of(self._source.dataset)
        else:
            truth = (f"{key} {content}\n".encode() for key, content in _labelled(self._source))
        return BlindSecret.of("relocbench blind export of images 1", self.edition, named, truth)


def export_blind_images(opened: OpenedSet, root: Path, out: Path, edition: int, reporter: Reporter) -> BlindSetFile:
    """Write the images of all tasks of a retrieval set to a folder, blind; an export that was stopped begins anew.

    Images are written anew from their pixels, so that no metadata comes with them, and in the order of their keys.

    Args:
        root: the folder of the dataset.

    Raises:
        DatasetError: the truth is withheld, or an image cannot be read.
        ConfigError: ``out`` lies inside the dataset or holds something else, or the set is a blind export itself.
    """
    check_outside(out, root)
    if blind_name(opened.name) is not None:
        raise ConfigError(f"'{opened.name}' is a blind export already", root)
    keys = BlindImages(opened, edition)
    _check_empty(out, str(keys.name))
    views: dict[str, ImageView] = {}
    for task in opened.all_tasks:
        views |= {keys.key(one.key): one for one in (*task.queries, *task.gallery)}
    lines = [HEADER]
    with reporter.stage("blind export", len(views)) as advance:
        for key, view in sorted(views.items()):
            path = image_file(out, key)
            write_bytes(path, png_bytes(view.read()))
            lines.append(f"{key},{sha256_file(path)}")
            advance(1)
    text = "".join(f"{line}\n" for line in lines)
    sides = {task.name: (sorted(keys.queries(task)), sorted(keys.gallery(task))) for task in opened.all_tasks}
    for name, (queries, gallery) in sides.items():
        write_text(keys_file(out, name, "queries"), "".join(f"{key}\n" for key in queries))
        write_text(keys_file(out, name, "gallery"), "".join(f"{key}\n" for key in gallery))
    write_text(out / "images.csv", text)
    file = BlindSetFile(
        name=str(keys.name),
        licence=opened.source.dataset.file.licence if isinstance(opened.source, StreetPlaces) else "",
        fingerprint=fingerprint_of(str(keys.name), text, sides),
        tasks={task.name: _described(task) for task in opened.all_tasks},
    )
    write_record(out / FILE, file)
    return file


def _check_empty(out: Path, name: str) -> None:
    """Raise ConfigError where a folder holds anything but an export of this name, or a part of one."""
    if not out.exists():
        return
    for path in sorted(out.iterdir()):
        if path.name[0] != "." and path.name not in _HELD:
            raise ConfigError(f"holds '{path.name}'; expected a new or an empty folder for a blind export", out)
    if (out / FILE).exists() and f"name: {name}\n" not in (out / FILE).read_text(encoding="utf-8"):
        raise ConfigError(f"holds another blind export than '{name}'; expected a new or an empty folder", out)


def _described(task: RetrievalTask) -> BlindTask:
    return BlindTask(
        queries=len(task.queries),
        gallery=len(task.gallery),
        view_query="+".join(sorted({one.view for one in task.queries})),
        view_gallery="+".join(sorted({one.view for one in task.gallery})),
        condition_query=task.condition_query,
        condition_gallery=task.condition_gallery,
    )


def _labelled(places: CrossViewSet) -> list[tuple[str, str]]:
    """Names of all test images, which tell their places, with digests of their content."""
    shots = [shot for side in (places.queries, places.galleries) for of in side.values() for shot in of]
    views = {shot.view.key: shot.view for shot in shots}
    return [(key, _content(places.root, view)) for key, view in sorted(views.items())]


def _content(root: Path, view: ImageView) -> str:
    if view.content:
        return view.content
    path = root / view.key
    return sha256_file(path) if path.is_file() else hashlib.sha256(view.read().tobytes()).hexdigest()

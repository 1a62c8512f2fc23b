"""Writing a blind export of a retrieval set, and computing its keys again where answers to it are scored."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from relocbench.datasets.core.images import png_bytes
from relocbench.datasets.core.salt import Salt
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.errors import ConfigError, DatasetError
from relocbench.evaluation.common.blind_names import BlindName, BlindSecret, check_salt
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

    Args:
        opened: the set, with its truth.
        salt: exports with other salts have other keys, and whoever does not have it cannot compute one.
        edition: exports of other editions have other keys, so that answers to one are not answers to another.

    Raises:
        DatasetError: the truth is withheld.
    """

    def __init__(self, opened: OpenedSet, salt: Salt, edition: int = 1) -> None:
        if opened.source is None:
            raise DatasetError(f"the truth of '{opened.name}' is withheld, and answers could not be scored")
        self.opened, self.source, self.salt = opened, opened.source, salt
        self._secret = BlindSecret(salt, "blind export of images 2", opened.content_id, edition)

    @property
    def name(self) -> BlindName:
        """What the export is called."""
        return self._secret.name

    @cached_property
    def tasks(self) -> dict[str, str]:
        """The tasks of the set -> what they are called."""
        return self._secret.numbered("task", (task.name for task in self.opened.all_tasks))

    def key(self, image: str) -> str:
        """The key of an image, by its name in the set."""
        return self._secret.digest(f"image {image}").hex()[:_KEY_CHARACTERS]

    def queries(self, task: RetrievalTask) -> dict[str, str]:
        """Keys of the queries of a task -> their names in the set."""
        return {self.key(one.key): one.key for one in task.queries}

    def gallery(self, task: RetrievalTask) -> dict[str, str]:
        """Keys of the gallery of a task -> their names in the set."""
        return {self.key(one.key): one.key for one in task.gallery}


def export_blind_images(keys: BlindImages, out: Path, reporter: Reporter) -> BlindSetFile:
    """Write the images of all tasks of a retrieval set to a folder, blind; an export that was stopped begins anew.

    Images are written anew from their pixels, so that no metadata comes with them, and in the order of their keys.

    Raises:
        DatasetError: an image cannot be read, or the truth follows from options without a salt.
        ConfigError: ``out`` lies inside the dataset or holds something else, or the set was built with another salt.
    """
    source = keys.source
    root = source.dataset.root if isinstance(source, StreetPlaces) else source.root
    described = source.dataset.file if isinstance(source, StreetPlaces) else source
    check_salt(keys.salt, described.made_by, keys.opened.name, root)
    check_outside(out, root)
    _check_empty(out, str(keys.name))
    views: dict[str, ImageView] = {}
    tasks = sorted(((keys.tasks[task.name], task) for task in keys.opened.all_tasks), key=lambda named: named[0])
    for _, task in tasks:
        views |= {keys.key(one.key): one for one in (*task.queries, *task.gallery)}
    lines = [HEADER]
    with reporter.stage("blind export", len(views)) as advance:
        for key, view in sorted(views.items()):
            path = image_file(out, key)
            write_bytes(path, png_bytes(view.read()))
            lines.append(f"{key},{sha256_file(path)}")
            advance(1)
    text = "".join(f"{line}\n" for line in lines)
    sides = {name: (sorted(keys.queries(task)), sorted(keys.gallery(task))) for name, task in tasks}
    for name, (queries, gallery) in sides.items():
        write_text(keys_file(out, name, "queries"), "".join(f"{key}\n" for key in queries))
        write_text(keys_file(out, name, "gallery"), "".join(f"{key}\n" for key in gallery))
    write_text(out / "images.csv", text)
    file = BlindSetFile(
        name=str(keys.name),
        licence=described.licence,
        fingerprint=fingerprint_of(str(keys.name), text, sides),
        tasks={name: _described(task) for name, task in tasks},
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
    """The counts of a task, and the views that its images are of."""
    return BlindTask(
        queries=len(task.queries),
        gallery=len(task.gallery),
        view_query="+".join(sorted({one.view for one in task.queries})),
        view_gallery="+".join(sorted({one.view for one in task.gallery})),
    )

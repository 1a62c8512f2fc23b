"""Validation of a cross-view set on disk."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.core import images
from relocbench.datasets.core.manifest import read_manifest
from relocbench.datasets.cross_view import content
from relocbench.datasets.cross_view.opening import open_cross_view
from relocbench.errors import DatasetError
from relocbench.files import sha256_file
from relocbench.progress import Reporter


def validate_cross_view(root: Path, reporter: Reporter, *, quick: bool = False) -> Findings:
    """Check the layout, decode every image and, in a rendered set, compare it with the manifest.

    Args:
        quick: neither decode nor hash.
    """
    found = Findings()
    with found.catching():
        opened = open_cross_view(root)
        for note in opened.notes:
            found.note(note, root)
        rows = read_manifest(root / content.MANIFEST_FILE) if (root / content.MANIFEST_FILE).exists() else []
        digests = {key: digest for key, _, digest in rows}
        folders = [*opened.train.values(), *opened.queries.values(), *opened.galleries.values()]
        paths = {Path(p) for folder in folders for p in _paths(shot.view.read for shot in folder)}
        if not quick:
            with reporter.stage("checking images", len(paths)) as advance:
                for path in sorted(paths):
                    with found.catching():
                        images.read_image(path)
                        key = path.relative_to(root).as_posix()
                        if key in digests and sha256_file(path) != digests[key]:
                            raise DatasetError("content was changed after the set was made", path)
                    advance(1)
    return found


def _paths(readers: Iterable[object]) -> Iterable[Path]:
    """The files that images are read from; one contact sheet holds several images."""
    for reader in readers:
        assert isinstance(reader, partial)
        yield reader.args[0]

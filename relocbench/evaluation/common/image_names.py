"""The names of a dataset's images in the files of other tools."""

from __future__ import annotations

from relocbench.datasets.core.traversal import Traversal
from relocbench.errors import DatasetError, quoted


def stored_name(traversal: Traversal, camera: str, timestamp_ns: int) -> str:
    """The path of an image below the dataset's ``traversals``."""
    path = traversal.layout.find_image(camera, timestamp_ns) or traversal.layout.image(camera, timestamp_ns)
    return path.relative_to(traversal.layout.root.parent).as_posix()


def listed_name(traversal: Traversal, camera: str, timestamp_ns: int) -> str:
    """The name of an image where it was imported from, or else :func:`stored_name`, for hloc's lists.

    Raises:
        DatasetError: the name has a blank, which separates names there, or ``#``, which begins a comment.
    """
    name = traversal.names.get(timestamp_ns) or stored_name(traversal, camera, timestamp_ns)
    if name.split() != [name] or "#" in name:
        raise DatasetError(
            f"image {quoted(name)} has a blank or '#' in its name, expected none in hloc's lists, where they separate "
            "names and begin comments",
            traversal.layout.names,
        )
    return name

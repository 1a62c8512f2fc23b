"""What a network has made of the images that it saw last, for data whose images belong to several pairs."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from hashlib import sha256
from typing import Generic, TypeVar

from relocbench.arrays import Image

Found = TypeVar("Found")


class RememberedImages(Generic[Found]):
    """The results for the images that were used last, by their content.

    Args:
        most: number of images; 0: nothing is kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._known: OrderedDict[bytes, Found] = OrderedDict()

    def get(self, image: Image, find: Callable[[Image], Found]) -> Found:
        """What ``find`` makes of an image (H, W) or (H, W, 3), which is asked only if it is not known."""
        if not self._most:
            return find(image)
        content = sha256(repr(image.shape).encode() + image.tobytes()).digest()
        if content not in self._known:
            self._known[content] = find(image)
        self._known.move_to_end(content)
        if len(self._known) > self._most:
            self._known.popitem(last=False)
        return self._known[content]

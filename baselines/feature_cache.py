"""What a network computed of the images that it saw last, for data whose images belong to several pairs."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from hashlib import sha256
from typing import Generic, TypeVar

from relocbench.arrays import Image

Features = TypeVar("Features")


class FeatureCache(Generic[Features]):
    """The features of the images that were used last, by the content of the images.

    Args:
        size: number of images; 0: nothing is kept.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._features: OrderedDict[bytes, Features] = OrderedDict()

    def get(self, image: Image, compute: Callable[[Image], Features]) -> Features:
        """The features of an image (H, W) or (H, W, 3); ``compute`` is called if they are not kept."""
        if not self._size:
            return compute(image)
        content = sha256(repr(image.shape).encode() + image.tobytes()).digest()
        if content not in self._features:
            self._features[content] = compute(image)
        self._features.move_to_end(content)
        if len(self._features) > self._size:
            self._features.popitem(last=False)
        return self._features[content]

"""Maps of a frozen backbone, computed once for some augmented versions of each image and kept in files.

What a frozen part of the network makes of an image does not change in a training, nor does it differ between systems
and seeds that freeze the same part. Each image is augmented ``versions`` times, by a seed that depends on the image and
the number of the version alone, and the map after the frozen part is kept in half precision. A step then reads maps in
place of images. There is one file for each view and version, named by a digest of all that decides its content: images,
size, augmentation, weights and depth. Trainings that agree in these share it.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.files import write_whole
from baselines.lpn.images import as_bytes, as_network_takes_them, resized
from baselines.lpn.network import VIEWS, LpnNetwork, View
from baselines.lpn.training.augmentation import augmented
from baselines.lpn.training.options import TrainOptions
from relocbench.errors import ConfigError, MethodError
from relocbench.progress import Reporter
from relocbench.retrieval import PlaceData

_FORMAT = 1
"""of the files; to be raised whenever the same options give other maps"""
_BATCH = 16
_BYTES = 2
"""of a number in half precision"""
GIGABYTE = 1e9


@dataclass(frozen=True)
class CachedMaps:
    """The maps of all images by view and version; a copy in another process opens the files itself."""

    files: Mapping[View, tuple[Path, ...]]
    """by view: a file for each version, an array (N, C, h, w) float16 of the view's images in order"""
    _open: dict[tuple[View, int], NDArray[np.float16]] = field(default_factory=dict, compare=False)

    def versions(self, view: View) -> int:
        """The number of versions of each image of a view."""
        return len(self.files[view])

    def read(self, view: View, chosen: Sequence[tuple[int, int]]) -> Tensor:
        """Maps (B, C, h, w) float16 of images, each given by its number among the view's images and its version."""
        return torch.from_numpy(np.stack([self._array(view, version)[image] for image, version in chosen]))

    def __reduce__(self) -> tuple[type[CachedMaps], tuple[Mapping[View, tuple[Path, ...]]]]:
        return type(self), (self.files,)

    def _array(self, view: View, version: int) -> NDArray[np.float16]:
        if (view, version) not in self._open:
            self._open[view, version] = np.load(self.files[view][version], mmap_mode="r")
        return self._open[view, version]


class MapsOfFrozen:
    """Computes the maps of a network whose backbone is frozen, where their files are missing.

    Args:
        network: with the weights that the training starts from; it is put into evaluation mode while maps are computed.
        folder: of the files.

    Raises:
        ConfigError: the files would take more room than ``maps_limit``.
    """

    def __init__(
        self, network: LpnNetwork, data: PlaceData, options: TrainOptions, folder: Path, device: torch.device
    ) -> None:
        self._network, self._data, self._options, self._folder, self._device = network, data, options, folder, device
        self._blocks = options.cached_blocks
        self._images = {view: [each for each in data.images if each.image.view == view] for view in options.views}
        gigabytes = sum(self._bytes.values()) / GIGABYTE
        if gigabytes > options.maps_limit:
            most = ", ".join(f"{self._options.versions[view]} of each {view} image" for view in options.views)
            raise ConfigError(
                f"the maps of the frozen backbone ({most}) would take {gigabytes:.2f} GB, more than maps_limit="
                f"{options.maps_limit:g}; expected fewer versions or a higher limit"
            )

    @property
    def summary(self) -> str:
        """What is kept where, in words."""
        counts = ", ".join(
            f"{self._options.versions[view]} versions of {len(images)} {view} images"
            for view, images in self._images.items()
        )
        gigabytes = sum(self._bytes.values()) / GIGABYTE
        return f"maps of the frozen backbone: {counts}, {gigabytes:.2f} GB in {self._folder}"

    def cached(self, reporter: Reporter) -> CachedMaps:
        """All maps; those that are missing are computed first.

        Raises:
            MethodError: a file of maps is damaged.
        """
        files = {view: self._files(view) for view in self._options.views}
        missing = {view: [n for n, path in enumerate(files[view]) if not path.exists()] for view in files}
        total = sum(len(numbers) * len(self._images[view]) for view, numbers in missing.items())
        if total:
            with _evaluating(self._network), reporter.stage("maps of the frozen backbone", total) as advance:
                for view, numbers in missing.items():
                    for version in numbers:
                        stream = io.BytesIO()
                        np.save(stream, self._computed(view, version))
                        write_whole(files[view][version], stream.getvalue())
                        advance(len(self._images[view]))
        for view, paths in files.items():
            for path in paths:
                self._check(view, path)
        return CachedMaps(files)

    @torch.inference_mode()
    def _computed(self, view: View, version: int) -> NDArray[np.float16]:
        images, size = self._images[view], self._options.size
        out = np.empty((len(images), *self._shapes[view]), dtype=np.float16)
        for start in range(0, len(images), _BATCH):
            squares = []
            for number in range(start, min(start + _BATCH, len(images))):
                rng = np.random.default_rng([VIEWS.index(view), number, version])
                square = resized(images[number].image.read(), size)
                squares.append(augmented(square, view, self._options, rng))
            maps = self._network.branch(view).map_after(
                as_network_takes_them(as_bytes(squares), self._device), self._blocks
            )
            out[start : start + _BATCH] = maps.to(torch.float16).cpu().numpy()
        if not np.isfinite(out).all():
            raise MethodError(f"maps of the frozen backbone exceed half precision in images of view '{view}'")
        return out

    def _check(self, view: View, path: Path) -> None:
        """Raise MethodError unless a file holds the maps of all images of a view."""
        expected = (len(self._images[view]), *self._shapes[view])
        try:
            found = np.load(path, mmap_mode="r")
        except (ValueError, OSError, EOFError) as bad:
            raise MethodError(f"not a readable file of maps ({bad}); delete it, and it is made again", path) from bad
        if found.shape != expected or found.dtype != np.float16:
            raise MethodError(f"maps {found.shape} {found.dtype}, expected {expected} float16; delete it", path)

    def _files(self, view: View) -> tuple[Path, ...]:
        o = self._options
        decides = {
            "format": _FORMAT,
            "data": self._data.described,
            "images": [each.image.key for each in self._images[view]],
            "view": view,
            "size": o.size,
            "augmentation": [o.pad, o.flip, o.satellite_turn_deg if view == "satellite" else 0.0],
            "blocks": self._blocks,
            "weights": self._network.branch(view).backbone.digest(self._blocks).hex(),
        }
        digest = hashlib.sha256(json.dumps(decides).encode()).hexdigest()[:16]
        return tuple(self._folder / f"{view}-{digest}-{number:03d}.npy" for number in range(o.versions[view]))

    @cached_property
    def _shapes(self) -> dict[View, tuple[int, int, int]]:
        """(C, h, w) of a map, by view."""
        blank = torch.zeros(1, 3, self._options.size, self._options.size, device=self._device)
        with _evaluating(self._network), torch.inference_mode():
            maps = {view: self._network.branch(view).map_after(blank, self._blocks)[0] for view in self._options.views}
        return {view: (each.shape[0], each.shape[1], each.shape[2]) for view, each in maps.items()}

    @property
    def _bytes(self) -> dict[View, int]:
        return {
            view: _BYTES * len(images) * self._options.versions[view] * math.prod(self._shapes[view])
            for view, images in self._images.items()
        }


@contextmanager
def _evaluating(network: LpnNetwork) -> Iterator[None]:
    """Put a network into evaluation mode, and each of its modules back into its own afterwards."""
    learning = [module for module in network.modules() if module.training]
    network.eval()
    try:
        yield
    finally:
        for module in learning:
            module.training = True

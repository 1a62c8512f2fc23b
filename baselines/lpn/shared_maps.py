"""Maps of images that retrievers of one process share, where their weights are the same up to there.

Systems that were trained behind one frozen backbone differ only in what follows it. Asked one after the other in one
process, they need its maps only once.
"""

from __future__ import annotations

import hashlib

import torch
from torch import Tensor

from baselines.lpn.network import LpnNetwork, View

_MOST = 10_000
"""maps that are kept; of 128 pixels and 320 channels these are 0.8 GB"""
_kept: dict[bytes, Tensor] = {}


class SharedMaps:
    """The maps of a network after ``layer3`` and so many blocks of ``layer4``.

    Args:
        network: in evaluation mode; its weights are no longer changed.
        blocks: as of ``Branch.map_after``.

    Raises:
        OptionError: ``layer4`` has fewer blocks.
    """

    def __init__(self, network: LpnNetwork, blocks: int) -> None:
        self._network, self._blocks = network, blocks
        self._digests = {name: branch.backbone.digest(blocks) for name, branch in network.named_branches()}

    @torch.no_grad()
    def embed(self, view: View, images: Tensor) -> Tensor:
        """The embeddings (B, P, D) of images, as of ``LpnNetwork.embed``."""
        names = [self._name(view, image) for image in images]
        new = [row for row, name in enumerate(names) if name not in _kept]
        fresh: dict[bytes, Tensor] = {}
        if new:
            maps = self._network.branch(view).map_after(images[new], self._blocks)
            fresh = {names[row]: found for row, found in zip(new, maps, strict=True)}
            _kept.update(list(fresh.items())[: max(_MOST - len(_kept), 0)])
        maps = torch.stack([fresh[name] if name in fresh else _kept[name] for name in names])
        return self._network.embed_from(view, maps.contiguous(memory_format=torch.channels_last), self._blocks)

    def _name(self, view: View, image: Tensor) -> bytes:
        digest = hashlib.blake2b(self._digests[self._network.branch_name(view)], digest_size=16)
        digest.update(f"{image.device} {tuple(image.shape)}".encode())
        digest.update(image.contiguous().cpu().numpy().tobytes())
        return digest.digest()

"""LPN and its variants as one network: backbone, attention, partition, part heads.

    image -> stage 3 (-> attention) -> stage 4 (-> attention) -> P parts -> P heads -> embeddings (-> logits)

Drone and satellite images share a branch; street images use it too or have one of their own. All views share the heads
(Wang et al., TCSVT 2021).
"""

from __future__ import annotations

from typing import Literal, NamedTuple, cast, get_args

import torch
from torch import Tensor, nn

from baselines.lpn.attention import LocalAttention
from baselines.lpn.backbone import make_backbone
from baselines.lpn.descriptor import Turns, descriptors, over_symmetries
from baselines.lpn.head import HeadOutput, PartHeads
from baselines.lpn.heatmap import HeatmapPartition
from baselines.lpn.options import NetworkOptions
from baselines.lpn.pooling import Parts
from baselines.lpn.rings import Rings
from baselines.lpn.soft_partition import SoftPartition

View = Literal["satellite", "drone", "street"]
VIEWS: tuple[View, ...] = get_args(View)


class ViewOutput(NamedTuple):
    """The network's output for images of one view."""

    embeddings: Tensor
    """(B, P, D)"""
    logits: Tensor
    """(B, P, classes)"""
    pooled: Tensor
    """(B, C) maximum of each channel of the last map"""
    masks: Tensor | None
    """(B, P, H, W); None if the partition does not depend on the image"""


class Branch(nn.Module):
    """The part of the network that a view may have of its own: backbone, attention and partition."""

    mean: Tensor
    deviation: Tensor

    def __init__(self, options: NetworkOptions, generator: torch.Generator) -> None:
        super().__init__()
        self.backbone = make_backbone(options.backbone, options.last_stride, generator)
        self.attention = nn.ModuleDict(
            {
                stage: LocalAttention(
                    self.backbone.channels[stage], options.attention.kernel, options.attention.residual, generator
                )
                for stage in ("layer3", "layer4")
                if stage in options.attention.after
            }
        )
        self.partition = _partition(options, self.backbone.channels["layer4"], generator)
        for name, values in (("mean", self.backbone.mean), ("deviation", self.backbone.deviation)):
            self.register_buffer(name, torch.tensor(values)[:, None, None], persistent=False)

    def map_after(self, images: Tensor, blocks: int) -> Tensor:
        """The map after ``layer3`` and so many blocks of ``layer4``, of images (B, 3, H, W), RGB in [0, 1].

        Raises:
            ValueError: the images have another shape, or attention lies in front of the blocks.
        """
        if images.ndim != 4 or images.shape[1] != 3:
            raise ValueError(f"images are {tuple(images.shape)}, expected (B, 3, H, W)")
        if blocks and "layer3" in self.attention:
            raise ValueError(f"attention after layer3 lies in front of the {blocks} blocks of layer4")
        x = self.backbone.to_layer3((images - self.mean) / self.deviation)
        return self.backbone.through_last_blocks(x, 0, blocks)

    def last_map_from(self, x: Tensor, blocks: int) -> Tensor:
        """The last map (B, C, h, w) of a map of :meth:`map_after` with the same number of blocks."""
        x = self._attend("layer3", x) if not blocks else x
        x = self.backbone.through_last_blocks(x, blocks, len(self.backbone.last_blocks))
        return self._attend("layer4", x)

    def parts(self, last_map: Tensor) -> Parts:
        """The features (B, P, C) and masks of the parts of the last map."""
        return cast(Parts, self.partition(last_map))

    def _attend(self, stage: str, x: Tensor) -> Tensor:
        return cast(Tensor, self.attention[stage](x)) if stage in self.attention else x


class LpnNetwork(nn.Module):
    """Embeddings and logits of images of each view.

    Args:
        classes: number of buildings in the training set.
        options: the network's shape.
        generator: source of all initial weights; by default of seed 0. Torch's global generator is not used.
            ``backbone_weights.load_backbone`` replaces the weights of a backbone.
    """

    def __init__(
        self, classes: int, options: NetworkOptions | None = None, generator: torch.Generator | None = None
    ) -> None:
        super().__init__()
        if classes < 1:
            raise ValueError(f"{classes} classes, expected at least one")
        self.classes = classes
        self.options = options or NetworkOptions()
        generator = generator or torch.Generator().manual_seed(0)
        names = ("air", "street") if self.options.street == "separate" else ("air",)
        self.branches = nn.ModuleDict({name: Branch(self.options, generator) for name in names})
        channels = self.branch("drone").backbone.channels["layer4"]
        self.heads = PartHeads(
            self.options.parts, channels, self.options.width, classes, self.options.dropout, generator
        )

    def forward(self, view: View, images: Tensor) -> ViewOutput:
        """The output for images (B, 3, H, W) of one view, RGB in [0, 1].

        Raises:
            ValueError: the network does not have the view, or the images have another shape.
        """
        return self.forward_from(view, self.branch(view).map_after(images, 0), 0)

    def forward_from(self, view: View, x: Tensor, blocks: int) -> ViewOutput:
        """The output for maps of ``Branch.map_after`` of one view's images."""
        branch = self.branch(view)
        last_map = branch.last_map_from(x, blocks)
        parts = branch.parts(last_map)
        embeddings, logits = cast(HeadOutput, self.heads(parts.features))
        return ViewOutput(embeddings, logits, last_map.amax((-2, -1)), parts.masks)

    def embed(self, view: View, images: Tensor) -> Tensor:
        """The embeddings (B, P, D) of images, without the classifier; arguments are those of ``forward``."""
        return self.embed_from(view, self.branch(view).map_after(images, 0), 0)

    def embed_from(self, view: View, x: Tensor, blocks: int) -> Tensor:
        """The embeddings (B, P, D) for maps of ``Branch.map_after`` of one view's images."""
        branch = self.branch(view)
        return self.heads.embed(branch.parts(branch.last_map_from(x, blocks)).features)

    @torch.no_grad()
    def describe(self, view: View, images: Tensor, turns: Turns = 1) -> Tensor:
        """The descriptors (B, P * D), of unit norm, of images together with their mirror images (``descriptor``), in
        each of 1 or 4 directions.

        Raises:
            RuntimeError: the network is in training mode, in which a descriptor would depend on the batch.
        """
        if self.training:
            raise RuntimeError("descriptors need evaluation mode: call eval() first")
        return descriptors(over_symmetries(lambda each: self.embed(view, each), images, turns))

    def branch(self, view: View) -> Branch:
        """The branch of a view.

        Raises:
            ValueError: the network does not have the view.
        """
        return cast(Branch, self.branches[self.branch_name(view)])

    def branch_name(self, view: View) -> str:
        """The name of a view's branch; raises as :meth:`branch` does."""
        if view not in VIEWS or (view == "street" and self.options.street == "none"):
            raise ValueError(f"this network has no view '{view}'")
        return "street" if view == "street" and self.options.street == "separate" else "air"

    def named_branches(self) -> list[tuple[str, Branch]]:
        """All branches with their names."""
        return [(name, cast(Branch, branch)) for name, branch in self.branches.items()]


def copy_weights(source: LpnNetwork, target: LpnNetwork) -> None:
    """Copy a network's weights into another one that may have a different partition.

    Weights that only the target's partition has keep their values.

    Raises:
        ValueError: the networks differ in more than their partition.
    """
    given, wanted = source.state_dict(), target.state_dict()
    for name in sorted(given.keys() | wanted.keys()):
        same = name in given and name in wanted and given[name].shape == wanted[name].shape
        if not same and ".partition." not in name:
            raise ValueError(f"the networks differ in more than their partition: '{name}'")
        if same:
            wanted[name] = given[name]
    target.load_state_dict(wanted)


def _partition(options: NetworkOptions, channels: int, generator: torch.Generator) -> nn.Module:
    if options.partition == "soft":
        return SoftPartition(channels, options.parts, options.soft, generator)
    if options.partition == "heatmap":
        return HeatmapPartition(options.parts, options.heatmap, generator)
    return Rings(options.parts, options.ring_mean)

"""The feature network: a U-Net that computes D features for each pixel at each of several resolutions.

Layout, with widths w_0 .. w_n and the finest level f (GN-Net, von Stumberg et al., RA-L 2020, uses a Siamese U-Net:
reference and query pass the same weights):

    encoder   stage k: w_k channels on level f + k (:mod:`baselines.gn_net.encoder`)
    decoder   stage n: as encoded   stage k: 1x1 of the coarser stage, upsampled, plus the encoder's stage k, 3x3
    head      1x1 to D channels, on each of the finest ``levels`` stages; another one to 1 channel, if asked

Features stay aligned with their pixels: convolutions are odd and centred, and upsampling is bilinear about the same
centres. Stage k is level l = f + k, and its pixel i is at pixel 2^l (i + 0.5) - 0.5 of the image.
"""

from __future__ import annotations

import copy
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.gn_net.encoder import Filter, make_encoder
from baselines.gn_net.options import NetworkOptions
from baselines.initialisation import Foldable, convolution, draw_weights
from relocbench.arrays import Image

_LEAST = 1e-6
"""confidence; weights of points must be positive"""


class FeatureNet(nn.Module):
    """Dense features of images at ``options.levels`` resolutions.

    Args:
        options: the network's shape.
        generator: source of the initial weights; by default of seed 0. Torch's global generator is not used.
    """

    def __init__(self, options: NetworkOptions | None = None, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.options = options or NetworkOptions()
        widths, levels, norm = self.options.widths, self.options.levels, self.options.norm == "batch"
        self.encoder = make_encoder(self.options)
        self.reduce = nn.ModuleList(convolution(widths[k + 1], widths[k], 1) for k in range(len(widths) - 1))
        self.decoder = nn.ModuleList(Filter(widths[k], widths[k], norm) for k in range(len(widths) - 1))
        self.heads = nn.ModuleList(convolution(widths[k], self.options.dim, 1) for k in range(levels))
        confident = levels if self.options.confidence else 0
        self.confidences = nn.ModuleList(convolution(widths[k], 1, 1) for k in range(confident))
        self._draw_weights(generator or torch.Generator().manual_seed(0))

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        """Feature maps, finest first.

        Args:
            images: (B, 3, H, W) RGB or (B, 1, H, W) grey, in [0, 1]. Sizes that are no multiple of 2^depth are padded
                at the right and below by repeating the last column and row.

        Returns:
            (B, D, H // 2^l, W // 2^l) for each level l from ``finest`` on. Pixels that cover padding are cut off; these
            are the sizes of the aligner's pyramid.

        Raises:
            ValueError: the shape is wrong, or the images have no pixel on the coarsest level.
        """
        return self.with_confidences(images)[0]

    def with_confidences(self, images: Tensor, first: int = 0) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """Feature maps, and for each the confidence of its pixels; without the option ``confidence`` there are none.

        Args:
            images: as in :meth:`forward`.
            first: finer maps, counted from the finest, are not computed.

        Returns:
            Features as :meth:`forward` returns them, and (B, 1, H // 2^l, W // 2^l) confidences in (0, 1).

        Raises:
            ValueError: as in :meth:`forward`.
        """
        maps = self.stages(images, first)
        height, width = images.shape[-2:]

        def on_levels(heads: nn.ModuleList) -> list[Tensor]:
            return [
                head(of_level)[..., : height >> level, : width >> level]
                for level, (head, of_level) in enumerate(
                    zip(heads[first:], maps, strict=False), start=self.options.finest + first
                )
            ]

        features = on_levels(self.heads)
        if self.options.normalise == "unit":
            features = [functional.normalize(each, dim=1) for each in features]
        return tuple(features), tuple(torch.sigmoid(each).clamp(_LEAST) for each in on_levels(self.confidences))

    def stages(self, images: Tensor, finest: int = 0) -> list[Tensor]:
        """What the heads read: the decoder's maps from stage ``finest`` on, finest first; padding is not cut off.

        Args:
            images: as in :meth:`forward`.
            finest: stages before this one are not computed.

        Returns:
            (B, widths[k], H', W') for each stage k, with H' and W' those of the padded images on level ``finest`` + k.

        Raises:
            ValueError: as in :meth:`forward`.
        """
        skips = cast(list[Tensor], self.encoder(self.padded(images)))
        maps = [skips[-1]]
        for k in reversed(range(finest, len(skips) - 1)):
            # 1x1 convolution before upsampling gives the same numbers as after it, at a quarter of the work.
            up = functional.interpolate(self.reduce[k](maps[0]), scale_factor=2, mode="bilinear", align_corners=False)
            maps.insert(0, self.decoder[k](up.add_(skips[k])))
        return maps

    @property
    def parameters_count(self) -> int:
        """The number of trainable parameters."""
        return sum(parameter.numel() for parameter in self.parameters())

    def for_tracking(self) -> FeatureNet:
        """A copy for inference, with batch normalisation folded into the convolutions."""
        net = copy.deepcopy(self).eval().requires_grad_(False)
        for module in net.modules():
            if isinstance(module, Foldable):
                module.fold()
        for module in net.modules():
            if isinstance(module, nn.Conv2d) and module.kernel_size == (1, 1):
                # It means nothing for a single pixel, but with it torch uses oneDNN also on one thread.
                module.dilation = 2, 2
        return net.to(memory_format=torch.channels_last)

    def padded(self, images: Tensor) -> Tensor:
        """Images (B, 3, H, W) whose sides are multiples of ``options.stride``.

        Raises:
            ValueError: as in :meth:`forward`.
        """
        if images.ndim != 4 or images.shape[1] not in (1, 3):
            raise ValueError(f"images are {tuple(images.shape)}, expected (B, 3, H, W) or (B, 1, H, W)")
        height, width = images.shape[-2:]
        smallest = self.options.smallest_side
        if min(height, width) < smallest:
            raise ValueError(f"images are {height}x{width}: the coarsest level needs {smallest}x{smallest}")
        x = images.expand(-1, 3, -1, -1)
        stride = self.options.stride
        missing = (0, -width % stride, 0, -height % stride)
        return functional.pad(x, missing, mode="replicate") if any(missing) else x

    def _draw_weights(self, generator: torch.Generator) -> None:
        """Initialise as He et al., 2015; heads start with features of about unit norm and equal confidences."""
        draw_weights(self, generator, "fan_in")
        for head in self.confidences:
            nn.init.zeros_(cast(Tensor, head.weight))
        for head in self.heads:
            nn.init.xavier_normal_(cast(Tensor, head.weight), gain=self.options.dim**-0.5, generator=generator)


def image_tensor(image: Image) -> Tensor:
    """(1, 3, H, W) or (1, 1, H, W) float32 in [0, 1] of an (H, W, 3) RGB or (H, W) grey image."""
    channels = image[..., None] if image.ndim == 2 else image
    # The conversion copies; torch does not accept read-only arrays.
    return torch.from_numpy(np.ascontiguousarray(channels, dtype=np.float32)).permute(2, 0, 1)[None] / 255.0

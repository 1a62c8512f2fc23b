"""DINOv2's vision transformer (Oquab et al., TMLR 2024; Dosovitskiy et al., ICLR 2021), without register tokens.

    tokens = [class token, patches W + b] + positions
    x <- x + g1 * attention(norm(x)),   x <- x + g2 * mlp(norm(x))     in each block, g1 and g2 learnt for each channel

Tensors have the names of the authors' files. Positions were learnt on a square grid; for others they are interpolated
bicubically, with the authors' 0.1 patches added to each side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isqrt
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

_HEAD = 64
"""channels of an attention head, in all of DINOv2's networks"""
_EPSILON = 1e-6
"""of the layer normalisations"""
_OFFSET = 0.1
"""patches that the authors add to the sides of the grid that positions are interpolated to"""
_MOST_BLOCKS = 64


@dataclass(frozen=True)
class VitShape:
    """Sizes of a vision transformer; ViT-B/14 has 768 channels, 3072 hidden ones, 12 blocks and a grid of 37 x 37."""

    channels: int
    hidden: int
    blocks: int
    patch: int
    grid: int

    @classmethod
    def of(cls, state: Mapping[str, Tensor], prefix: str) -> VitShape | None:
        """The sizes of the transformer that a state dict has below a prefix; None if it has none, or an odd one."""
        names = ("patch_embed.proj.weight", "pos_embed", "blocks.0.mlp.fc1.weight")
        found = [tuple(state[name].shape) for part in names if (name := f"{prefix}.{part}") in state]
        if [len(shape) for shape in found] != [4, 3, 2]:
            return None
        (channels, _, patch, _), (_, tokens, _), (hidden, _) = found
        begin = f"{prefix}.blocks."
        blocks = len({name.removeprefix(begin).partition(".")[0] for name in state if name.startswith(begin)})
        grid = isqrt(max(tokens - 1, 0))
        if channels % _HEAD or not channels or not patch or not grid or grid**2 != tokens - 1 or blocks > _MOST_BLOCKS:
            return None
        return cls(channels, hidden, blocks, patch, grid)


class _Scale(nn.Module):
    """A factor for each channel."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(channels))

    def forward(self, x: Tensor) -> Tensor:
        return x * self.gamma


class _Attention(nn.Module):
    """Attention of all tokens (B, N, C) to all tokens."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.qkv = nn.Linear(channels, 3 * channels)
        self.proj = nn.Linear(channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        batch, tokens, channels = x.shape
        q, k, v = self.qkv(x).view(batch, tokens, 3, channels // _HEAD, _HEAD).permute(2, 0, 3, 1, 4)
        seen = functional.scaled_dot_product_attention(q, k, v)
        return cast(Tensor, self.proj(seen.transpose(1, 2).reshape(batch, tokens, channels)))


class _Mlp(nn.Module):
    def __init__(self, channels: int, hidden: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(channels, hidden)
        self.fc2 = nn.Linear(hidden, channels)

    def forward(self, x: Tensor) -> Tensor:
        return cast(Tensor, self.fc2(functional.gelu(self.fc1(x))))


class _Block(nn.Module):
    def __init__(self, channels: int, hidden: int) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(channels, eps=_EPSILON)
        self.attn = _Attention(channels)
        self.ls1 = _Scale(channels)
        self.norm2 = nn.LayerNorm(channels, eps=_EPSILON)
        self.mlp = _Mlp(channels, hidden)
        self.ls2 = _Scale(channels)

    def forward(self, x: Tensor) -> Tensor:
        x = x + self.ls1(self.attn(self.norm1(x)))
        return cast(Tensor, x + self.ls2(self.mlp(self.norm2(x))))


class _Patches(nn.Module):
    """Tokens (B, h w, C) of the patches of images, row after row."""

    def __init__(self, channels: int, patch: int) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, channels, patch, stride=patch)

    def forward(self, images: Tensor) -> Tensor:
        return cast(Tensor, self.proj(images).flatten(2).mT)


class DinoV2(nn.Module):
    """The class token (B, C) and the map (B, C, H / patch, W / patch) of normalised images (B, 3, H, W)."""

    def __init__(self, shape: VitShape) -> None:
        super().__init__()
        self.shape = shape
        self.patch_embed = _Patches(shape.channels, shape.patch)
        self.cls_token = nn.Parameter(torch.empty(1, 1, shape.channels))
        self.pos_embed = nn.Parameter(torch.empty(1, 1 + shape.grid**2, shape.channels))
        self.blocks = nn.ModuleList(_Block(shape.channels, shape.hidden) for _ in range(shape.blocks))
        self.norm = nn.LayerNorm(shape.channels, eps=_EPSILON)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        rows, columns = (side // self.shape.patch for side in images.shape[-2:])
        x = torch.cat([self.cls_token.expand(len(images), -1, -1), self.patch_embed(images)], dim=1)
        x = x + self.positions(rows, columns)
        for block in self.blocks:
            x = block(x)
        x = self.norm(x)
        return x[:, 0], x[:, 1:].mT.unflatten(-1, (rows, columns))

    def positions(self, rows: int, columns: int) -> Tensor:
        """What is added to the tokens (1, 1 + rows columns, C) of a grid of patches."""
        grid = self.shape.grid
        if rows == columns == grid:
            return self.pos_embed
        learnt = self.pos_embed[:, 1:].mT.unflatten(-1, (grid, grid))
        factors = ((rows + _OFFSET) / grid, (columns + _OFFSET) / grid)
        placed = functional.interpolate(learnt, scale_factor=factors, mode="bicubic")
        return torch.cat([self.pos_embed[:, :1], placed.flatten(2).mT], dim=1)

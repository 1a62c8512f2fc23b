"""The ground: road, kerbs, pavements, gardens, and the land to the horizon."""

from __future__ import annotations

import numpy as np

from relocbench.datasets.synthetic.town.carriageway import carriageway, laid_on
from relocbench.datasets.synthetic.town.markings import markings
from relocbench.datasets.synthetic.town.mesh import Material, Mesh, Semantic, merge
from relocbench.datasets.synthetic.town.network import StreetNetwork
from relocbench.datasets.synthetic.town.polylines import inset
from relocbench.datasets.synthetic.town.shapes import Shape, at_height, ear_clip, join, quads, single, triangle_shape
from relocbench.datasets.synthetic.town.streets import KERB_M, Block

HORIZON_M = 3000.0
_KERB_TOP_M = 0.18


def ground(network: StreetNetwork, blocks: tuple[Block, ...]) -> Mesh:
    """All flat surfaces: the road plane, raised pavements and blocks, the land to the horizon, and road markings."""
    road = carriageway(network)
    paint = laid_on(join(markings(network, blocks)), road)
    return merge(
        [
            single(road, 0, 0, Semantic.ROAD),
            *(single(_pavement(block), 0, 2, Semantic.PAVEMENT) for block in blocks),
            *(
                single(_inside(block), 0, 3, Semantic.PAVEMENT if block.kind == "square" else Semantic.TERRAIN)
                for block in blocks
            ),
            single(paint, 0, 0, Semantic.MARKING),
        ]
    )


def _pavement(block: Block) -> Shape:
    """Kerb stones and the pavement of a block."""
    count = len(block.face)
    outline = np.concatenate(block.kerb_arcs)
    inner = inset(outline, _KERB_TOP_M)
    after = np.roll(np.arange(len(outline)), -1)
    run = np.concatenate([[0], np.cumsum(np.linalg.norm(outline[after] - outline, axis=1))])
    low, high, top = at_height(outline, 0.0), at_height(outline, KERB_M), at_height(inner, KERB_M)
    face = np.stack([low, low[after], high[after], high], axis=1)
    cap = np.stack([high, high[after], top[after], top], axis=1)
    u = np.stack([run[:-1], run[1:], run[1:], run[:-1]], axis=1)
    face_uv = np.stack([u, np.broadcast_to([0, 0, KERB_M, KERB_M], u.shape)], axis=2)
    cap_uv = np.stack([u, np.broadcast_to([0, 0, _KERB_TOP_M, _KERB_TOP_M], u.shape) + KERB_M], axis=2)
    sizes = [len(a) for a in block.kerb_arcs]
    corner = np.repeat(np.arange(count), sizes)
    slabs = []
    for i in range(len(outline)):
        j = (i + 1) % len(outline)
        a, b = corner[i], corner[j]
        slabs.append([top[i], top[j], *at_height(block.pavement[[b, a]], KERB_M)])
    return join(
        [
            quads(face, Material.KERB, face_uv),
            quads(cap, Material.KERB, cap_uv),
            quads(np.array(slabs), Material.COBBLES if block.kind == "square" else Material.PAVEMENT),
        ]
    )


def _inside(block: Block) -> Shape:
    """The ground behind the pavement: gardens and yards, or for the outside the land to the horizon."""
    material = Material.COBBLES if block.kind == "square" else Material.GRASS
    points = block.pavement
    if block.kind != "outside":
        return triangle_shape(at_height(points, KERB_M), ear_clip(points), material)
    far = points / np.linalg.norm(points, axis=1, keepdims=True) * HORIZON_M
    after = np.roll(np.arange(len(points)), -1)
    near_3d, far_3d = at_height(points, KERB_M), at_height(far, KERB_M)
    return quads(np.stack([near_3d, near_3d[after], far_3d[after], far_3d], axis=1), material)

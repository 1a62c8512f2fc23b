"""Street furniture: lamp posts, signs, benches, bins, bollards, a fountain. Each is at the origin and faces +x."""

from __future__ import annotations

from functools import cache

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.town.mesh import BOARD_M, POSTER_M, SIGN_M, Material
from relocbench.datasets.synthetic.town.shapes import Shape, boxes, boxes_of, fan, join, moved, quads, tube

LAMP_HEAD = np.array([1.25, 0.0, 5.62])
"""position of the light source in the frame of a lamp post"""
SIGN_KINDS = 5
_UP = np.array([0.0, 0.0, 1.0])


@cache
def lamp_post() -> Shape:
    """A 5.8 m post whose arm reaches 1.5 m along +x."""
    post = tube(np.outer([0, 0.9, 0.95, 5.4], _UP), [0.11, 0.10, 0.07, 0.045], 12, Material.METAL)
    arm = tube([[0, 0, 5.38], [0.25, 0, 5.66], [0.7, 0, 5.76], [1.0, 0, 5.76]], 0.035, 8, Material.METAL)
    head = boxes([0.9, -0.14, 5.68], [1.6, 0.14, 5.8], Material.METAL)
    glow = boxes([0.97, -0.1, 5.64], [1.53, 0.1, 5.679], Material.LAMP, without="top")
    return join([post, arm, head, glow])


def _post(height: float) -> Shape:
    return tube(np.outer([0, height], _UP), 0.03, 8, Material.METAL)


def _plate(outline: Array, z: float, row: int, material: Material = Material.TRAFFIC_SIGN) -> Shape:
    """A plate with an outline (P, 2) of (y, z) in front of the post, its face towards +x, its back bare metal.

    ``row`` is that of the pictograms which it can have.
    """
    ring = np.column_stack([np.full(len(outline), 0.045), outline[:, 0], outline[:, 1] + z])
    behind = ring - np.array([0.012, 0, 0])
    face, back = fan(ring, ring.mean(0)), fan(behind, behind.mean(0))[:, [0, 3, 2, 1]]
    rim = np.stack([np.roll(ring, -1, axis=0), ring, behind, np.roll(behind, -1, axis=0)], axis=1)
    uv = face[:, :, 1:] + SIGN_M * np.array([0.5, 0.5 + row]) - np.array([0.0, z])
    return join([quads(face, material, uv), quads(np.concatenate([back, rim]), Material.METAL)])


@cache
def sign(kind: int) -> Shape:
    """One of SIGN_KINDS traffic signs on its post: red discs, triangles, blue plates and discs, or two of them."""
    turn = 2 * np.pi * np.arange(24) / 24
    disc = 0.32 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    triangle = np.array([[-0.38, -0.3], [0.38, -0.3], [0.0, 0.36]])
    square = np.array([[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [-0.3, 0.3]])
    blue = Material.GUIDE_SIGN
    plates = (
        [_plate(disc, 2.4, 0)],
        [_plate(triangle, 2.4, 1)],
        [_plate(square, 2.35, 2, blue)],
        [_plate(disc, 2.75, 0), _plate(square, 2.05, 2, blue)],
        [_plate(disc, 2.4, 3, blue)],
    )[kind]
    return join([_post(3.1 if kind == 3 else 2.75), *plates])


@cache
def street_name() -> Shape:
    """A post with a plate of the street's name on both sides, along the street, which is along y."""
    low, high = np.array([-0.46, 2.35]), np.array([0.46, 2.58])
    face = np.array(
        [(0.04, low[0], low[1]), (0.04, high[0], low[1]), (0.04, high[0], high[1]), (0.04, low[0], high[1])]
    )
    both = np.stack([face, face * [-1, -1, 1]])
    uv = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * (BOARD_M, BOARD_M / 4)
    names = quads(both, Material.STREET_NAME, np.stack([uv, uv]))
    rim = boxes([-0.038, -0.465, 2.345], [0.038, 0.465, 2.585], Material.METAL, without="left right")
    return join([_post(2.7), names, rim])


@cache
def traffic_light(green: bool) -> Shape:
    """A traffic light on a post of 3.3 m, whose three lamps face +x."""
    parts = [tube(np.outer([0, 0.8, 0.82, 3.3], _UP), [0.085, 0.085, 0.055, 0.055], 8, Material.METAL)]
    parts.append(boxes([0.05, -0.17, 2.35], [0.25, 0.17, 3.3], Material.RUBBER))
    turn = 2 * np.pi * np.arange(12) / 12
    for k, lit in enumerate((Material.LIGHT_GREEN if green else None, None, None if green else Material.LIGHT_RED)):
        z = 2.52 + 0.3 * k
        ring = np.stack([np.full(12, 0.253), 0.1 * np.cos(turn), z + 0.1 * np.sin(turn)], axis=1)
        parts.append(quads(fan(ring, [0.253, 0.0, z]), lit or Material.CAR_GLASS))
        hood = np.array(
            [(0.25, 0.12, 0.02), (0.25, 0.09, 0.09), (0.25, 0, 0.125), (0.25, -0.09, 0.09), (0.25, -0.12, 0.02)]
        )
        out = hood + np.array([0.16, 0, 0])
        roof = np.stack([hood[:-1], hood[1:], out[1:], out[:-1]], axis=1) + np.array([0, 0, z])
        parts.append(quads(np.concatenate([roof, roof[:, ::-1]]), Material.RUBBER))
    # The small one for those who cross, at the side.
    parts.append(boxes([-0.11, 0.06, 2.1], [0.11, 0.24, 2.62], Material.RUBBER))
    return join(parts)


@cache
def column() -> Shape:
    """A column of 3.2 m for posters."""
    body = tube(np.outer([0, 0.3, 0.32, 2.75, 2.77, 2.9, 3.05, 3.2], _UP),
                [0.68, 0.68, 0.6, 0.6, 0.72, 0.72, 0.4, 0.05], 16, Material.CONCRETE)  # fmt: skip
    posters = []
    for k, (around, z0) in enumerate((a, z) for z in (0.4, 1.6) for a in range(4)):
        angles = 2 * np.pi * (around + 0.5 * (z0 > 1) + np.linspace(0.08, 0.92, 4)) / 4
        u = np.linspace(0, POSTER_M, 4)
        ring = 0.612 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        low, high = (np.column_stack([ring, np.full(4, z)]) for z in (z0, z0 + 1.12))
        corners = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
        uv = np.stack(
            [np.stack([u[:-1], u[1:], u[1:], u[:-1]], 1), np.tile([0, 0, POSTER_M, POSTER_M], (3, 1))], axis=2
        )
        posters.append(quads(corners, Material.POSTER, uv, variant=np.full(3, 1 + 257 * k)))
    return join([body, *posters])


@cache
def bench() -> Shape:
    """A bench of slats on two cast legs, 1.8 m wide, facing +x."""
    seat = [(x, -0.9, 0.43, x + 0.09, 0.9, 0.47) for x in (-0.05, 0.06, 0.17, 0.28)]
    rest = [(-0.14 - 0.03 * k, -0.9, 0.56 + 0.12 * k, -0.10 - 0.03 * k, 0.9, 0.65 + 0.12 * k) for k in range(3)]
    legs = [(x, y - 0.03, 0.0, x + 0.06, y + 0.03, z) for y in (-0.7, 0.7) for x, z in ((-0.12, 0.9), (0.28, 0.43))]
    legs += [(-0.12, y - 0.03, 0.38, 0.34, y + 0.03, 0.43) for y in (-0.7, 0.7)]
    return join([boxes_of(seat + rest, Material.WOOD), boxes_of(legs, Material.METAL)])


@cache
def bin_shape() -> Shape:
    """A round litter bin with a rim and a lid on a stem."""
    body = tube([[0, 0, 0.08], [0, 0, 0.1], [0, 0, 0.8], [0, 0, 0.8]], [0.2, 0.24, 0.27, 0.25], 16, Material.PLASTIC)
    lid = tube([[0, 0, 0.98], [0, 0, 1.02], [0, 0, 1.1]], [0.29, 0.29, 0.12], 16, Material.PLASTIC)
    stem = tube(np.outer([0, 1.0], _UP), 0.04, 8, Material.METAL)
    return join([body, lid, stem])


@cache
def wheeled_bin() -> Shape:
    """A household bin, as put out at the kerb."""
    body = boxes([-0.28, -0.27, 0.12], [0.28, 0.27, 0.95], Material.PLASTIC)
    lid = boxes([-0.33, -0.29, 0.95], [0.32, 0.29, 1.03], Material.PLASTIC, variant=0x9)
    wheels = [
        moved(tube([[0, y, 0], [0, y + 0.06, 0]], 0.11, 12, Material.RUBBER), -0.24, 0, 0.11) for y in (-0.3, 0.24)
    ]
    return join([body, lid, *wheels])


@cache
def bollard() -> Shape:
    """A cast post of 0.95 m with a ball on top."""
    height = [0, 0.1, 0.12, 0.72, 0.74, 0.78, 0.8, 0.86, 0.92, 0.95]
    radius = [0.1, 0.1, 0.07, 0.055, 0.08, 0.08, 0.05, 0.075, 0.05, 0.01]
    return tube(np.column_stack([np.zeros((10, 2)), height]), radius, 9, Material.METAL)


@cache
def fountain() -> Shape:
    """A stone basin with a column and a bowl, for the middle of a square."""
    profile = np.array(
        [(2.6, 0), (2.6, 0.2), (2.35, 0.25), (2.3, 0.6), (2.45, 0.7), (2.15, 0.72), (2.1, 0.4), (0.5, 0.38),
         (0.35, 0.6), (0.25, 1.5), (0.9, 1.75), (1.1, 1.95), (1.0, 1.95), (0.3, 1.75),
         (0.18, 2.0), (0.22, 2.6), (0.05, 3.0)]
    )  # fmt: skip
    return tube(np.column_stack([np.zeros((len(profile), 2)), profile[:, 1]]), profile[:, 0], 32, Material.STONE)


@cache
def shelter() -> Shape:
    """A bus shelter, open towards +x: posts, glass back and side, roof, and a bench inside."""
    posts = [(x, y, 0, x + 0.07, y + 0.07, 2.35) for x in (-0.7, 0.55) for y in (-1.8, 1.73)]
    roof = boxes([-0.85, -1.95, 2.35], [0.85, 1.95, 2.47], Material.METAL)
    glass = boxes([-0.68, -1.73, 0.15], [-0.65, 1.73, 2.25], Material.CAR_GLASS)
    side = boxes([-0.63, 1.75, 0.15], [0.35, 1.78, 2.25], Material.METAL)
    board = np.array([(-0.6, 0.4), (0.32, 0.4), (0.32, 2.1), (-0.6, 2.1)])
    faces = np.stack([np.insert(board, 1, 1.745, axis=1), np.insert(board[[1, 0, 3, 2]], 1, 1.785, axis=1)])
    uv = POSTER_M * np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    poster = quads(faces, Material.POSTER, np.stack([uv, uv]), variant=np.array([3, 5]))
    seat = boxes([-0.55, -1.2, 0.45], [-0.2, 1.2, 0.5], Material.WOOD)
    feet = boxes([[-0.42, -1.0, 0], [-0.42, 0.95, 0]], [[-0.34, -0.95, 0.45], [-0.34, 1.0, 0.45]], Material.METAL)
    return join([boxes_of(posts, Material.METAL), roof, glass, side, poster, seat, feet])

"""Pairs of photographs of a plane with the homography between them: the layout of the affine covariant regions data.

FOLDER holds the scenes of Mikolajczyk et al., IJCV 2005, each with img1 to img6 and H1to2p to H1to6p, the homographies
from img1 to the others. Image 1 is the keyframe of each pair, and both images are cut to their middle, 704 x 512
pixels, and otherwise as they were taken.

For a camera with known intrinsics K, every homography H with a positive determinant is that of a motion in front of
a plane n, d: ``K^-1 H K = s (R + t n^T / d)``, where s is the middle singular value (Faugeras and Lustman, 1988). The
focal length of these cameras is not known, and 900 pixels are taken. What is exact is that pose and depth together give
H. They are neither the true motion nor the true plane, and a zoom of the lens, as in bark and boat, becomes a motion
ahead. H itself is as accurate as its makers measured it: SIFT's matches differ by 0.3 to 2 pixels in the median.

The plane is 5 m away along the axis; of several that give H, it is the one that is tilted least against the image. A
pair is left out and named if no plane is in front of both cameras all over the keyframe, if its pose does not give H
within a pixel, or if H does not tell the pose: errors of a pixel (one sigma, in each direction) where H takes the four
corners of the keyframe may mean no more than 0.125 m and a degree (one sigma of all directions), half of what an answer
may be off. That leaves out most of zoom, where the query is far from the plane. Where H is the identity, no plane
follows from it, and one across the axis is taken. The images of ubc are registered: all their homographies are that of
the first, the identity.

OUT has a folder of queries for each change: light (leuven), blur (bikes, trees), compression (ubc), viewpoint (graf,
wall) and zoom (bark, boat; zoom and rotation).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from generic_folder import Keyframe, Query, centred, made_up_ns, middle, plane_depth, plane_homography, read

from relocbench.arrays import Array
from relocbench.errors import DatasetError
from relocbench.geometry import apply, hat, make_transform

CHANGES = {
    "light": ("leuven",),
    "blur": ("bikes", "trees"),
    "compression": ("ubc",),
    "viewpoint": ("graf", "wall"),
    "zoom": ("bark", "boat"),
}
REGISTERED = ("ubc",)
"""scenes with one homography for all images"""
SIZE = 704, 512
CAMERA = centred(SIZE, 900.0)
PLANE_M = 5.0
"""depth of the plane along the axis"""
MOST_OFF_PX = 1.0
MOST_SIGMA_M, MOST_SIGMA_DEG = 0.125, 1.0
"""of a pose, for a pixel of its homography"""
IMAGES = range(2, 7)
_CORNERS = np.array([[x, y, 1.0] for x in (0, SIZE[0] - 1) for y in (0, SIZE[1] - 1)])
_RAYS = _CORNERS @ np.linalg.inv(CAMERA.matrix).T
_STILL = 1e-9
"""of a translation over the distance of the plane: less is none"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER")


def made(options: argparse.Namespace) -> dict[str, list[Query]]:
    """The queries of each change. Raises DatasetError: an image or homography that is missing or damaged."""
    found: dict[str, list[Query]] = {}
    asked = 0
    for change, scenes in CHANGES.items():
        found[change] = []
        for scene in scenes:
            for number in IMAGES:
                query = pair_of(options.folder / scene, number, made_up_ns(asked))
                asked += 1
                if query is None:
                    print(
                        f"{scene} {number}: no plane that serves, or H does not tell the pose; left out",
                        file=sys.stderr,
                    )
                else:
                    found[change].append(query)
    return found


def pair_of(scene: Path, number: int, time_ns: int) -> Query | None:
    """The image with a number as the query of the first; None where no pose and plane serve."""
    paths = [_file(scene, f"img{i}.*") for i in (1, number)]
    (image, at), (moved, moved_at) = (middle(read(path), SIZE, path) for path in paths)
    H = (
        _shift(-moved_at)
        @ read_homography(_file(scene, f"H1to{2 if scene.name in REGISTERED else number}p"))
        @ _shift(at)
    )
    found = decomposed(H)
    if found is None:
        return None
    T_query_ref, inverse = found
    return Query(Keyframe(time_ns, image, plane_depth(CAMERA, inverse), CAMERA), time_ns, moved, CAMERA, T_query_ref)


def decomposed(H: Array) -> tuple[Array, Array] | None:
    """Pose ``T_query_ref`` (4, 4) and plane n / d (3,) in the keyframe's frame that give H; None where none serve.

    Args:
        H: (3, 3) from pixels of the keyframe to those of the query.
    """
    _, rotations, translations, normals = cv2.decomposeHomographyMat(H, CAMERA.matrix)
    found = []
    for R, t, n in zip(rotations, translations, normals, strict=True):
        still = np.linalg.norm(t) < _STILL
        normal, over_d = (np.array([0.0, 0.0, 1.0]), np.zeros(3)) if still else (n.ravel(), t.ravel())
        if normal[2] <= 0:
            continue
        distance = PLANE_M * normal[2]
        T_query_ref, inverse = make_transform(R, over_d * distance), normal / distance
        if _serves(H, T_query_ref, inverse):
            found.append((normal[2], T_query_ref, inverse))
    if not found:
        return None
    _, T_query_ref, inverse = max(found, key=lambda each: each[0])
    certain = np.all(sigmas(_corners(T_query_ref, inverse)) <= (MOST_SIGMA_M, MOST_SIGMA_DEG))
    return (T_query_ref, inverse) if certain else None


def _serves(H: Array, T_query_ref: Array, inverse: Array) -> bool:
    """Whether the plane is in front of both cameras in the keyframe's corners, and gives H there."""
    if np.any(_RAYS @ inverse <= 0) or np.any(_corners(T_query_ref, inverse)[:, 2] <= 0):
        return False
    seen, wanted = (_CORNERS @ each.T for each in (plane_homography(CAMERA, T_query_ref, inverse), H))
    return bool(np.all(np.abs(seen[:, :2] / seen[:, 2:] - wanted[:, :2] / wanted[:, 2:]) <= MOST_OFF_PX))


def _corners(T_query_ref: Array, inverse: Array) -> Array:
    """(4, 3) the points of the plane in the keyframe's corners, in the query's frame."""
    return apply(T_query_ref, _RAYS / (_RAYS @ inverse)[:, None])


def sigmas(points: Array) -> Array:
    """By how much a pose is uncertain that pixels tell, each off by one sigma of a pixel: metres and degrees.

    The square roots of the traces of both parts of ``(J^T J)^-1``, J being the derivative of the pixels by a shift v
    and a turn w of the points, ``dY = v + w x Y``.

    Args:
        points: (N, 3) in the query's frame.
    """
    J = np.zeros((len(points), 2, 6))
    for pixel, (x, y, z) in zip(J, points, strict=True):
        by_point = CAMERA.fx / z * np.array([[1.0, 0.0, -x / z], [0.0, 1.0, -y / z]])
        pixel[:] = by_point @ np.hstack([np.eye(3), -hat([x, y, z])])
    J = J.reshape(-1, 6)
    variances = np.diag(np.linalg.inv(J.T @ J))
    return np.array([np.sqrt(variances[:3].sum()), np.degrees(np.sqrt(variances[3:].sum()))])


def read_homography(path: Path) -> Array:
    """(3, 3), the last entry 1. Raises DatasetError: it is not nine numbers, or mirrors the image."""
    try:
        H: Array = np.loadtxt(path).reshape(3, 3)
    except ValueError as bad:
        raise DatasetError(f"expected three rows of three numbers: {bad}", path) from None
    H = H / H[2, 2]
    if not np.linalg.det(H) > 0:
        raise DatasetError("expected a homography that does not mirror the image", path)
    return H


def _file(scene: Path, pattern: str) -> Path:
    """The one file of a scene with a name."""
    found = sorted(scene.glob(pattern))
    if len(found) != 1:
        raise DatasetError(f"{len(found)} files named {pattern}; expected one", scene)
    return found[0]


def _shift(by: Array) -> Array:
    return np.array([[1.0, 0.0, by[0]], [0.0, 1.0, by[1]], [0.0, 0.0, 1.0]])

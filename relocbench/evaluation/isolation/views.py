"""What a tracker is shown of an image: read-only arrays under a token, without the name, and usually the time, of it.

A key such as ``drive/camera/timestamp`` and a time in nanoseconds say where along a drive an image was taken, to a
method that has learnt how drives go. Both are replaced before a method sees the image.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints, Query, Reference

Scalar = TypeVar("Scalar", bound=np.generic)

_TOKEN_CHARACTERS = 16


def masked_query(query: Query, times: bool = False) -> Query:
    """A query as a tracker sees it: read-only, with a token for its key, and without its time unless ``times``."""
    image = read_only(query.image)
    return replace(
        query, key=_token(query.camera, image), timestamp_ns=query.timestamp_ns if times else None, image=image
    )


def masked_reference(reference: Reference, times: bool = False) -> Reference:
    """A keyframe as a tracker sees it: read-only, with a token for its key, and without its time unless ``times``."""
    points, depth = reference.sparse_points, reference.depth
    return replace(
        reference,
        key=_token(reference.camera, reference.image),
        timestamp_ns=reference.timestamp_ns if times else None,
        image=read_only(reference.image),
        depth=None if depth is None else read_only(depth),
        sparse_points=None
        if points is None
        else KeyframePoints(read_only(points.uv), read_only(points.inverse_depth), read_only(points.sigma)),
        neighbours=tuple(
            replace(each, image=read_only(each.image), T_neighbour_ref=read_only(each.T_neighbour_ref))
            for each in reference.neighbours
        ),
    )


def read_only(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """A read-only view: a method that writes to it gets a ValueError instead of changing the next method's input."""
    shown = array.view()
    shown.flags.writeable = False
    return shown


def _token(camera: Camera, image: NDArray[Any]) -> str:
    """A digest of image and camera, which tells a method nothing that it does not see anyway.

    It is the same in every run, so that a method that seeds its random numbers by the key repeats its answers.
    """
    digest = hashlib.sha256(f"{camera!r} {image.dtype} {image.shape}".encode())
    digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()[:_TOKEN_CHARACTERS]

"""From what large models answer to a metric pose: three adapters, one for each kind of model.

- Pixel matches (RoMa, LoFTR, LightGlue, the matches of MASt3R): :func:`from_matches`. The keyframe's depth makes them
  matches of points with pixels, and a PnP solver finds the pose in metres. No scale is left open.
- A relative pose up to scale (Reloc3r, essential matrices): :func:`from_direction`. The length of the translation comes
  from matches of points with depth. A model that answers a pose alone needs matches from elsewhere, of any matcher:
  only their agreement with one length along the given direction counts, so that a third of them may be wrong.
- Point maps or depth up to scale (DUSt3R, MASt3R, VGGT): :func:`from_model_depth`. The model's depth of the keyframe
  is compared with the depth that is known.

Pixels are those of the image as it was given, with centres at integers. A model that works on a resized image has its
own: with w the width of the original and w' that of the resized one, u = (u' + 0.5) w / w' - 0.5.
"""

from __future__ import annotations

import numpy as np
from contract import Answer, Array, Keyframe, View
from numpy.typing import NDArray

from relocbench.geometry import ScaleError, depth_scale, make_transform, rotation_angle, translation_scale

FEWEST = 12
"""matches with depth below which no pose is claimed"""


def points_at(keyframe: Keyframe, uv: Array, reach: int = 1) -> Array:
    """(N, 3) metric points of the keyframe at pixels (N, 2): those of the nearest pixel with depth.

    NaN where none is within ``reach`` pixels. A sparse map needs a larger reach, or a model that can be asked for
    matches of ``keyframe.uv`` themselves, as dense matchers can.
    """
    height, width = keyframe.image.shape[:2]
    row_at = np.full((height + 2 * reach, width + 2 * reach), -1)
    u, v = np.rint(keyframe.uv).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    farthest_first = np.argsort(-keyframe.depth[inside], kind="stable")  # of one pixel the nearest is seen
    order = np.nonzero(inside)[0][farthest_first]
    row_at[v[order] + reach, u[order] + reach] = order
    asked: NDArray[np.bool_] = np.isfinite(uv).all(axis=1)
    at = np.rint(np.where(asked[:, None], uv, -9.0)).astype(int)
    asked &= (at >= 0).all(axis=1) & (at < [width, height]).all(axis=1)
    at[~asked] = 0
    found, nearest = np.full(len(uv), -1), np.full(len(uv), np.inf)
    for dv in range(-reach, reach + 1):
        for du in range(-reach, reach + 1):
            rows = row_at[at[:, 1] + dv + reach, at[:, 0] + du + reach]
            nearer = asked & (rows >= 0) & (du * du + dv * dv < nearest)
            found[nearer], nearest[nearer] = rows[nearer], du * du + dv * dv
    points = np.full((len(uv), 3), np.nan)
    points[found >= 0] = keyframe.points[found[found >= 0]]
    return points


def from_matches(keyframe: Keyframe, view: View, uv_ref: Array, uv_query: Array, max_error_px: float = 2.0) -> Answer:
    """The pose from pixel matches: PnP with RANSAC, refined on what agrees. Needs OpenCV.

    Args:
        uv_ref: (N, 2) pixels of the keyframe.
        uv_query: (N, 2) the pixels of the query that show the same.
        max_error_px: distance in the query up to which a match agrees.
    """
    import cv2

    points = points_at(keyframe, uv_ref)
    rays, seen = view.camera.unproject(uv_query)
    usable = seen & np.isfinite(points).all(axis=1) & (rays[:, 2] > 0)
    if usable.sum() < FEWEST:
        return Answer(None, message=f"{usable.sum()} matches with depth, at least {FEWEST} are needed")
    X, x = points[usable], rays[usable, :2] / rays[usable, 2:]  # without the lens, so that K is the identity
    focal = (view.camera.fx + view.camera.fy) / 2
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        X, x, np.eye(3), None, iterationsCount=2000, reprojectionError=max_error_px / focal, confidence=0.9999
    )
    if not found or inliers is None or len(inliers) < FEWEST:
        return Answer(None, message=f"fewer than {FEWEST} matches agree with one pose")
    agree = inliers[:, 0]
    rotation, translation = cv2.solvePnPRefineLM(X[agree], x[agree], np.eye(3), None, rotation, translation)
    T_query_ref = make_transform(cv2.Rodrigues(rotation)[0], translation[:, 0])
    return Answer(T_query_ref, len(agree) / len(X), info={"matches": len(X), "inliers": len(agree)})


def from_direction(
    keyframe: Keyframe, view: View, uv_ref: Array, uv_query: Array, rotation: Array, direction: Array
) -> Answer:
    """The pose from a relative pose up to scale and matches, which may come from another model.

    Args:
        uv_ref: (N, 2) pixels of the keyframe.
        uv_query: (N, 2) the pixels of the query that show the same.
        rotation: (3, 3) of ``T_query_ref``. A model that answers the pose of the query in the keyframe's camera has
            its inverse: rotation R^T and direction -R^T t.
        direction: (3,) the translation of ``T_query_ref`` up to scale.
    """
    points = points_at(keyframe, uv_ref)
    try:
        scale = translation_scale(points, uv_query, view.camera, rotation, direction)
    except ScaleError as bad:
        return Answer(None, message=str(bad))
    agree = int(scale.inliers.sum())
    if agree < FEWEST:
        return Answer(None, message=f"{agree} matches agree with one length, at least {FEWEST} are needed")
    usable = int(np.isfinite(points).all(axis=1).sum())
    length_m = scale.value * float(np.linalg.norm(direction))
    info = {"matches": usable, "inliers": agree, "length_m": length_m, "error_px": scale.spread}
    return Answer(make_transform(rotation, scale.value * direction), agree / usable, info=info)


def from_model_depth(keyframe: Keyframe, T_query_ref: Array, model_depth: NDArray[np.floating]) -> Answer:
    """The pose from a model whose depth and translation have one unknown scale.

    Args:
        T_query_ref: (4, 4) in the units of the model. A model that answers a point map of the query in the keyframe's
            camera, (H, W, 3), leaves the pose to PnP: its points with their own pixels in the query.
        model_depth: (H, W) the model's depth along z of the keyframe, at the size of the keyframe's image; 0 or not
            finite where the model has none. Of a point map it is the third component.
    """
    u, v = np.rint(keyframe.uv).astype(int).T
    height, width = model_depth.shape
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    try:
        scale = depth_scale(keyframe.depth[inside], model_depth[v[inside], u[inside]], keyframe.relative_sigma[inside])
    except ScaleError as bad:
        return Answer(None, message=str(bad))
    metric = make_transform(T_query_ref[:3, :3], scale.value * T_query_ref[:3, 3])
    info = {"scale": scale.value, "scale_sigma": scale.sigma, "depth_spread": scale.spread}
    info["rotation_deg"] = float(np.degrees(rotation_angle(metric[:3, :3])))
    return Answer(metric, 1.0 / (1.0 + scale.spread), info=info)

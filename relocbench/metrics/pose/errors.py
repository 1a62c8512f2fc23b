"""The errors of one pair.

With ``T_query_ref = [[R, t], [0, 1]]`` the query camera's centre in the reference frame is ``c = -R^T t``.

- ``rotation_error_deg``: angle of ``R_pred R_gt^T``.
- ``translation_error_m`` (primary): ``||c_pred - c_gt||``, the position error of a vehicle that uses the answer. It
  does not depend on the choice of the reference frame (both poses times one transform on the right).
- ``joint_error(metres, degrees)``: the larger one of the position error over ``metres`` and the rotation error over
  ``degrees``. It is at most 1 exactly where both are within their thresholds.
- ``mlad_translation_error_m``: ``||t_pred - t_gt||``, as scored by hloc and by the MLAD and 4Seasons challenges.
  It does not depend on the choice of the query frame (both poses times one transform on the left).

The two translation errors are equal when the rotation is exact, and they swap roles when poses are stored the
other way round. That is why each has its own name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from relocbench.arrays import Array, Mask
from relocbench.geometry import rotation_angle
from relocbench.metrics.pose.failure_policy import answered_pairs, infinite_where_failed


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of all N pairs of a set, in the set's order; inf where there is no answer."""

    rotation_error_deg: Array
    """(N,) degrees, [0, 180] or inf"""
    translation_error_m: Array
    """(N,) metres between the camera centres, or inf"""
    mlad_translation_error_m: Array
    """(N,) metres between the translations of T_query_ref, or inf"""

    def __post_init__(self) -> None:
        shapes = {e.shape for e in (self.rotation_error_deg, self.translation_error_m, self.mlad_translation_error_m)}
        if len(shapes) > 1 or len(shapes.pop()) != 1:
            raise ValueError("pose errors must be three arrays of one length")

    def __len__(self) -> int:
        return len(self.translation_error_m)

    @property
    def answered(self) -> Mask:
        """(N,) whether each pair has an answer: by the failure policy, exactly the pairs with finite errors."""
        return np.isfinite(self.translation_error_m)

    @classmethod
    def joined(cls, parts: Sequence[PoseErrors]) -> PoseErrors:
        """The errors of several sets, one after the other."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def joint_error(self, metres: float, degrees: float) -> Array:
        """(N,) ``max(translation_error_m / metres, rotation_error_deg / degrees)``: no unit, inf without an answer.

        Raises:
            ValueError: a threshold that is not positive.
        """
        if not (metres > 0 and degrees > 0):
            raise ValueError(f"the thresholds of a joint error must be positive, got {metres} m and {degrees} degrees")
        return np.maximum(self.translation_error_m / metres, self.rotation_error_deg / degrees)


def pose_errors(T_pred: ArrayLike, T_gt: ArrayLike, answered: ArrayLike | None = None) -> PoseErrors:
    """The errors of predicted against true poses.

    Args:
        T_pred: (N, 4, 4) predicted ``T_query_ref``, rigid where answered, anything where not.
        T_gt: (N, 4, 4) true ``T_query_ref``.
        answered: (N,) False where the method failed or was never run; None if NaN poses mark those pairs.

    Raises:
        ValueError: the shapes do not fit, or a true pose is not finite.
    """
    pred, gt = np.asarray(T_pred, dtype=np.float64), np.asarray(T_gt, dtype=np.float64)
    valid = answered_pairs(pred, answered)
    if gt.shape != pred.shape:
        raise ValueError(f"true poses must have the shape {pred.shape} of the predicted ones, got {gt.shape}")
    if not np.isfinite(gt).all():
        raise ValueError("true poses must be finite: a pair without ground truth is not in the set")
    pred = np.where(valid[:, None, None], pred, np.eye(4))  # a placeholder to compute with; its errors become inf

    R_pred, t_pred = pred[:, :3, :3], pred[:, :3, 3]
    R_gt, t_gt = gt[:, :3, :3], gt[:, :3, 3]
    with np.errstate(over="ignore", invalid="ignore"):  # a pose that is absurdly far off overflows to an infinite error
        rotation = np.degrees(rotation_angle(R_pred @ _transposed(R_gt)))
        centre = np.linalg.norm(_camera_centre(R_pred, t_pred) - _camera_centre(R_gt, t_gt), axis=-1)
        mlad = np.linalg.norm(t_pred - t_gt, axis=-1)
    valid &= np.isfinite(rotation) & np.isfinite(centre) & np.isfinite(mlad)
    return PoseErrors(*(infinite_where_failed(error, valid) for error in (rotation, centre, mlad)))


def _camera_centre(R: Array, t: Array) -> Array:
    """``-R^T t``: the query camera's centre in the reference frame. (N, 3, 3), (N, 3) -> (N, 3)."""
    return -(_transposed(R) @ t[..., None])[..., 0]


def _transposed(R: Array) -> Array:
    return np.swapaxes(R, -1, -2)

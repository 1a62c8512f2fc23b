"""SE(3), interpolation, paths, camera models, projection and metric scale. Needs nothing but NumPy."""

from relocbench.geometry.camera import Camera, CameraModel, camera_from_dict
from relocbench.geometry.paths import path_lengths, spaced
from relocbench.geometry.robust import robust_sigma
from relocbench.geometry.scale import Scale, ScaleError, depth_scale, translation_scale
from relocbench.geometry.se3 import (
    adjoint,
    apply,
    compose,
    hat,
    interpolate,
    interpolate_trajectory,
    invert,
    is_rotation,
    make_transform,
    project_to_rotation,
    quaternion_from_rotation,
    rotation_angle,
    rotation_from_quaternion,
    se3_exp,
    se3_log,
    so3_exp,
    so3_log,
    transform_from_tq,
    transform_to_tq,
)

__all__ = [
    "Camera",
    "CameraModel",
    "Scale",
    "ScaleError",
    "adjoint",
    "apply",
    "camera_from_dict",
    "compose",
    "depth_scale",
    "hat",
    "interpolate",
    "interpolate_trajectory",
    "invert",
    "is_rotation",
    "make_transform",
    "path_lengths",
    "project_to_rotation",
    "quaternion_from_rotation",
    "robust_sigma",
    "rotation_angle",
    "rotation_from_quaternion",
    "se3_exp",
    "se3_log",
    "so3_exp",
    "so3_log",
    "spaced",
    "transform_from_tq",
    "transform_to_tq",
    "translation_scale",
]

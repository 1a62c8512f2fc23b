"""A registration as plain values and as files."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import pose_fields
from relocbench.datasets.groundtruth.clouds.cloud import Cloud
from relocbench.datasets.groundtruth.clouds.pictures import write_before_after, write_residuals
from relocbench.datasets.groundtruth.clouds.register import CloudRegistration
from relocbench.files import strict_json, write_bytes, write_text
from relocbench.geometry import apply, make_transform, rotation_angle, transform_to_tq


def T_files(registration: CloudRegistration, a: Cloud, b: Cloud) -> Array:
    """``T_a_b`` (4, 4) in the files' own coordinates, without the origins that were subtracted."""
    zero = np.zeros(3)
    to_a = make_transform(np.eye(3), zero if a.origin is None else a.origin)
    of_b = make_transform(np.eye(3), -(zero if b.origin is None else b.origin))
    return np.asarray(to_a @ registration.T_a_b @ of_b)


def as_values(registration: CloudRegistration, a: Cloud, b: Cloud) -> dict[str, Any]:
    """The registration as plain values: metres, radians, and degrees where the name says so."""
    known = bool(np.isfinite(registration.T_a_b).all())
    pose: dict[str, Any] = {"T_a_b": None}
    if known:
        translation, quaternion = transform_to_tq(registration.T_a_b)
        pose = {
            "T_a_b": registration.T_a_b.tolist(),
            "translation_m": translation.tolist(),
            "quaternion_xyzw": quaternion.tolist(),
            "rotation_deg": float(np.degrees(rotation_angle(registration.T_a_b[:3, :3]))),
            "T_files": T_files(registration, a, b).tolist(),
        }
    return {
        "a": a.name,
        "b": b.name,
        "trusted": registration.trusted,
        "reason": registration.reason,
        "rests_on": registration.rests_on,
        "unobservable": registration.unobservable,
        "copied_share": registration.copied,
        **pose,
        "origin_a": None if a.origin is None else a.origin.tolist(),
        "origin_b": None if b.origin is None else b.origin.tolist(),
        "sigma_m": registration.sigma_m.tolist(),
        "sigma_rotation_deg": registration.sigma_deg,
        "middle_of_b_m": registration.T_b_middle[:3, 3].tolist(),
        "information": registration.information.tolist(),
        "covariance": registration.covariance.tolist(),
        "evidence": {**asdict(registration.evidence), "unexplained": registration.unexplained},
        "rival": None
        if registration.rival is None
        else {"T_a_b": registration.rival[0].tolist(), "unexplained": registration.rival[1]},
        "scale": registration.scale.factor,
        "scale_reason": registration.scale.reason,
        **{f"sensor_{name}": side.sensor for name, side in zip("ab", registration.sides, strict=False)},
        "guesses": registration.guesses,
    }


def write_registration(
    folder: Path, registration: CloudRegistration, a: Cloud, b: Cloud, names: tuple[str, str], *, cloud: bool
) -> list[Path]:
    """Write pose, covariance, evidence and pictures into a folder; ``cloud``: also B in the frame of A.

    The pose is written whether or not it is trusted: ``registration.json`` says so. Returns the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / "registration.json", folder / "covariance.txt"]
    write_text(written[0], json.dumps(strict_json(as_values(registration, a, b)), indent=1) + "\n")
    header = "# covariance of xi = (rho, phi) in T_a_b exp(xi), metres and radians; see registration.json\n"
    write_text(written[1], header + _rows(registration.covariance))
    if np.isfinite(registration.T_a_b).all():
        pose, tum = folder / "pose.txt", folder / "pose_tum.txt"
        write_text(pose, _rows(registration.T_a_b))
        write_text(tum, f"# t tx ty tz qx qy qz qw  T_a_b\n0 {' '.join(pose_fields(registration.T_a_b))}\n")
        written += [pose, tum]
    if registration.sides:
        pictures = folder / "before_after.png", folder / "residuals.png"
        write_before_after(pictures[0], registration, names)
        write_residuals(pictures[1], registration)
        written += pictures
    if cloud and np.isfinite(registration.T_a_b).all():
        path = folder / "b_in_a.ply"
        moved = apply(registration.T_a_b, b.points) + (0.0 if a.origin is None else a.origin)
        header = (
            f"ply\nformat binary_little_endian 1.0\nelement vertex {len(moved)}\n"
            "property double x\nproperty double y\nproperty double z\nend_header\n"
        )
        write_bytes(path, header.encode() + np.ascontiguousarray(moved, dtype="<f8").tobytes())
        written.append(path)
    return written


def _rows(matrix: Array) -> str:
    return "".join(" ".join(repr(float(value)) for value in row) + "\n" for row in matrix)

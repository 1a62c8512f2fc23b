"""Whether calibration and times of a recording are right: lidar points, seen by its camera, against the true depth."""

from __future__ import annotations

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.geometry import Camera, apply, invert


def true_depth(scene: LidarScene, camera: Camera, T_world_cam: Array) -> Array:
    """Depth (H, W) along z in metres by casting a ray a pixel; inf where it meets nothing."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays, _ = camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float64))
    directions = rays @ T_world_cam[:3, :3].T
    origins = np.broadcast_to(T_world_cam[:3, 3], directions.shape)
    out: Array = scene.hits(origins, directions).range.reshape(camera.height, camera.width)
    return out


def depth_errors(
    recording: FieldRecording, camera: str, index: int, depth: Array, *, lidar: int = 0, farthest_m: float = 25.0
) -> Array:
    """Differences (N,) in metres of the depths of lidar points in an image and the true depth at their pixels.

    The points are those of the scan nearest in time, moved by the recording's own odometry to the time of the image.

    Args:
        depth: (H, W) the true depth.
    """
    seen, stream = recording.cameras[camera], recording.lidars[lidar]
    moment = int(seen.times_ns[index])
    scan = stream.read(int(np.argmin(np.abs(stream.times_ns - moment))))
    known = recording.odometry.covers(scan.times_ns)
    T_cam_odom = invert(recording.odometry.at(np.array([moment]))[0] @ seen.T_rig_cam)
    T_cam_lidar = T_cam_odom @ recording.odometry.at(scan.times_ns[known]) @ stream.T_rig_lidar
    points = apply(T_cam_lidar, scan.points[known][:, None, :])[:, 0]
    uv, valid = seen.camera.project(points)
    valid &= seen.camera.contains(uv) & (points[:, 2] < farthest_m)
    u, v = np.rint(uv[valid]).astype(int).T
    there = depth[v, u]
    off: Array = points[valid, 2] - there
    kept: Array = off[np.isfinite(there)]
    return kept


def agrees(errors: Array, least: int = 200) -> bool:
    """Whether depths agree within centimetres at most places.

    They need not at edges, which a lidar beside the camera sees past, and on ground that is far away, where the next
    pixel is decimetres off.
    """
    if len(errors) < least:
        return False
    return bool(np.median(np.abs(errors)) < 0.04 and np.mean(np.abs(errors) < 0.2) > 0.85)

"""How exactly the rolling shutter of rendered images follows the rays of its rows.

`build-dataset synthetic --rolling-shutter` moves what a global shutter's image shows (`camera/rolling_shutter.py`).
Here the ray of every pixel is cast from the pose that the camera has at the time of the pixel's row, and the point
that it meets is projected into the global image: that is where the content of the pixel should have been taken from.
Printed are the distance from there to the place that was taken, and for comparison how far the shutter moves the
content. Points that the global image does not show, because something nearer hides them or they are outside of it,
have no such place; their share is printed.

    python benchmarks/truth/rolling_shutter.py [--frames N]
"""

from __future__ import annotations

import argparse

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.synthetic.camera.rolling_shutter import Readout, row_poses, sources
from relocbench.datasets.synthetic.camera.shot import camera_twists
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS
from relocbench.datasets.synthetic.drives.drive import RATE_HZ, DriveStyle, drive, route_length
from relocbench.datasets.synthetic.drives.rig import rig_named
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.geometry import Camera, apply, invert

PLACE = scenes.DistrictSpec(0, "validation", 250.0)
FACTORS = CONDITIONS["Sunny"].factors
STEPS = 100
READOUTS_S = (0.01, 0.03, 0.06)
HIDDEN_M = 0.05
"""distance by which a point must be nearer than what the global image shows there to be called hidden"""


def frame_errors(camera: Camera, T_world_cam: Array, readout: Readout) -> tuple[Array, Array, float]:
    """Errors (N,) and shifts (N,) in pixels of what both images show, and the share of pixels that have no source."""
    v, u = (axis.ravel().astype(float) for axis in np.mgrid[: camera.height, : camera.width])
    pixels = np.column_stack([u, v])
    origins, directions, lengths = scenes.pixel_rays(camera, T_world_cam, pixels)
    scene = scenes.static_scene(PLACE, FACTORS)
    found = scene.hits(origins, directions)
    depth = np.where(np.isfinite(found.range), found.range / lengths, 0.0).reshape(camera.height, camera.width)
    taken = sources(depth.astype(np.float32), camera, readout).reshape(-1, 2)

    T_world_row = (T_world_cam @ row_poses(camera.height, readout))[v.astype(int)]
    rays = camera.unproject(pixels)[0]
    along = np.einsum("nij,nj->ni", T_world_row[:, :3, :3], rays)
    there = scene.hits(T_world_row[:, :3, 3], along).range
    surface = np.isfinite(there)
    points = T_world_row[surface, :3, 3] + there[surface, None] * along[surface]
    in_global = apply(invert(T_world_cam), points)
    expected, _ = camera.project(in_global)
    inside = camera.contains(expected) & (in_global[:, 2] > 0)
    column, row = np.rint(expected[inside]).astype(int).T
    before = depth[row, column]
    hidden = (before > 0) & (before < in_global[inside, 2] * (1 - 0.02) - HIDDEN_M)
    kept = np.flatnonzero(inside)[~hidden]
    error = np.linalg.norm(taken[surface][kept] - expected[kept], axis=1)
    shift = np.linalg.norm(pixels[surface][kept] - expected[kept], axis=1)
    return error, shift, 1 - len(kept) / np.count_nonzero(surface)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=10)
    frames = parser.parse_args().frames
    style = DriveStyle()
    route = scenes.district(PLACE).network.drive(route_length(STEPS, style), PLACE.seed)
    camera, T_rig_cam = rig_named("front").cameras(320, 240)["front"]
    poses = drive(route, STEPS, style, np.random.default_rng(PLACE.seed)).T_world_rig @ T_rig_cam
    twists = camera_twists(poses, 1 / RATE_HZ)
    print("readout    shift (median, 95 %)    error (median, 95 %)    without source")
    for seconds in READOUTS_S:
        each = [
            frame_errors(camera, poses[i], Readout(seconds, twists[i]))
            for i in np.linspace(0, STEPS - 1, frames).astype(int)
        ]
        error, shift = (np.concatenate([e[k] for e in each]) for k in (0, 1))
        lost = np.mean([e[2] for e in each])
        half, most = ([float(np.percentile(values, q)) for values in (shift, error)] for q in (50, 95))
        print(
            f"{1e3 * seconds:4.0f} ms    {half[0]:6.2f} {most[0]:6.2f} px"
            f"        {half[1]:6.3f} {most[1]:6.3f} px       {lost:6.1%}"
        )


if __name__ == "__main__":
    main()

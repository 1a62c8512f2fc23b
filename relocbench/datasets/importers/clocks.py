"""The clock of a recording's poses: found by its images, given, or left as it is, and recorded with the drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.clock.check import ClockCheck, check_clock
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ClockOptions
from relocbench.datasets.core.schema import TraversalFile
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.errors import DatasetError

_APART_S = 0.003
"""seconds by which the clocks of two cameras of a rig may differ"""


def write_posed_traversal(
    job: Build[ClockOptions],
    file: TraversalFile,
    trajectory: Trajectory,
    times: Sequence[int],
    write_frames: Callable[[Mapping[int, Array]], None],
    given_s: float | None,
    none_posed: DatasetError,
) -> None:
    """Write a drive with its frames, each with the pose at its time plus an offset.

    The images must exist before they can tell the offset: the frames are written with the poses as recorded or as
    given, and the poses again where an offset was found. Frames that then have no pose are removed. An offset that is
    given is applied whatever the images tell, which is recorded beside it.

    Args:
        trajectory: poses of the rig as they were recorded.
        times: of the images, nanoseconds.
        write_frames: writes images and depth of frames that have poses.
        given_s: the offset, or None where the images shall tell it.
        none_posed: is raised where no image has a pose.

    Raises:
        DatasetError: ``none_posed``, or as ``write_frames`` does.
    """
    poses = poses_at(trajectory, times, given_s or 0.0)
    if not poses:
        raise none_posed
    job.writer.traversal(file, poses)
    write_frames(poses)
    traversal = Traversal(job.writer.layout.traversal(file.name))
    checks = [check_clock(traversal, camera, trajectory, job.work) for camera in file.cameras]
    for check in checks:
        job.reporter.note(f"{file.name}: {check.words}{f'; {check.left}' if check.left else ''}")
    best = _chosen(checks)
    if best is None:
        job.reporter.note(f"{file.name}: the cameras' clocks differ, so that no offset is applied")
    found_s = best.correction_s if best else 0.0
    entry = (best or checks[0]).entry(found_s if given_s is None else given_s)
    if given_s is None and found_s:
        job.reporter.note(f"{file.name}: images at t have the poses at t {1000 * found_s:+.0f} ms")
        shifted = poses_at(trajectory, times, found_s)
        for time in poses.keys() - shifted.keys():
            for camera in file.cameras:
                job.writer.remove_frame(file.name, camera, time)
        poses = {time: pose for time, pose in shifted.items() if time in poses}
    job.writer.traversal(file.model_copy(update={"clock": entry}), poses)


def poses_at(trajectory: Trajectory, times: Sequence[int], offset_s: float) -> dict[int, Array]:
    """The poses (4, 4) of images at their times plus an offset, without those outside the trajectory or in a gap."""
    wanted = np.array(times, dtype=np.int64) + round(offset_s * 1e9)
    covered = np.flatnonzero(trajectory.covers(wanted)).tolist()
    found = trajectory.at(wanted[covered]) if covered else ()
    return {times[row]: pose for row, pose in zip(covered, found, strict=True)}


def _chosen(checks: list[ClockCheck]) -> ClockCheck | None:
    """The finding of the camera that tells most; None where two cameras tell different offsets."""
    told = [check for check in checks if check.verdict in ("one clock", "offset")]
    if not told:
        return checks[0]
    best = min(told, key=lambda check: check.sigma_s)
    apart = [abs(check.offset_s - best.offset_s) - 3 * (check.sigma_s + best.sigma_s) for check in told]
    return best if max(apart) <= _APART_S else None

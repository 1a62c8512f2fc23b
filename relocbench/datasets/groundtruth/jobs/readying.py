"""From recordings as they were read to recordings that can be registered: checked, measured, and with odometry."""

from __future__ import annotations

from collections.abc import Sequence

from relocbench.datasets.core.build import Build
from relocbench.datasets.groundtruth.jobs.inputs import check_space, driven_m, faults_of, motion_faults
from relocbench.datasets.groundtruth.jobs.measuring import scale_of_build
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.jobs.scaling import enlarged, in_metres
from relocbench.datasets.groundtruth.odometry.deferred import computed, is_pending, kept_in
from relocbench.datasets.groundtruth.odometry.jumps import interrupted
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.errors import raise_all
from relocbench.progress import Reporter


def ready(
    recordings: Sequence[FieldRecording], cameras: Sequence[str], job: Build[FieldOptions]
) -> tuple[list[FieldRecording], list[FieldRecording], SceneScale]:
    """Check all recordings, measure their scale, compute the odometry that is missing, and check the way driven.

    Odometry is interrupted where it jumps.

    Args:
        cameras: the cameras whose images are paired.

    Returns:
        the recordings in metres, those in metres that are enlarged to the size of a street, and the scale.

    Raises:
        DatasetError: what is wrong with the recordings; all faults that can be found at once.
    """
    options, reporter, root = job.options, job.reporter, job.writer.layout.root
    faults = [fault for recording in recordings for fault in faults_of(recording, cameras)]
    folder, scale = root / "groundtruth", SceneScale(1.0, "")
    if not faults:
        # Steps that no vehicle can have driven are judged in metres as they are.
        recordings = [r if is_pending(r) else interrupted(r, reporter) for r in recordings]
        scale = scale_of_build(recordings, options, folder, reporter)
        known = [recording for recording in recordings if not is_pending(recording)]
        faults = [fault for one in known for fault in motion_faults(one, options, reporter, scale.factor)]
    raise_all(faults)
    out = []
    for recording in recordings:
        kept = kept_in(folder / "odometry" / f"{recording.name}.csv")
        out.append(_moved(recording, kept, scale.factor, reporter))
    pending = [after for before, after in zip(recordings, out, strict=True) if is_pending(before)]
    raise_all([fault for one in pending for fault in motion_faults(one, options, reporter, scale.factor)])
    large = [enlarged(recording, scale.factor) for recording in out]
    check_space(root, sum(driven_m(recording) for recording in large))
    return out, large, scale


def _moved(recording: FieldRecording, kept: FromLidar, factor: float, reporter: Reporter) -> FieldRecording:
    """The recording with its odometry, which is computed in enlarged metres if there is none."""
    if not is_pending(recording):
        return recording
    large = computed(enlarged(recording, factor), kept, reporter)
    return interrupted(in_metres(recording, large, factor), reporter)

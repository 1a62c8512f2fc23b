"""The cameras of a bag: their calibration, and their poses on the rig."""

from __future__ import annotations

import numpy as np

from relocbench.datasets.core.schema import CameraEntry
from relocbench.datasets.importers.rosbag.pictures import calibration_of
from relocbench.datasets.importers.rosbag.reading import Reading
from relocbench.datasets.importers.rosbag.roles import CameraTopic
from relocbench.datasets.importers.rosbag.streams import BagCamera, read_picture
from relocbench.datasets.sensors.recording import CameraStream
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import make_transform

_UPRIGHT = float(np.cos(np.radians(30)))
"""of the angle between the optical axis and the vertical: nearer to it, no camera of a car looks"""


def camera_stream(reading: Reading, camera: CameraTopic) -> CameraStream | None:
    """A camera; None if it cannot be read and nobody asked for it, which is reported."""
    try:
        return _read_camera(reading, camera)
    except (DatasetError, ConfigError) as bad:
        if {camera.name, camera.images} & set(reading.settings.wanted.cameras):
            raise
        reading.note(f"the camera '{camera.name}' is not read: {bad}")
        return None


def _read_camera(reading: Reading, camera: CameraTopic) -> CameraStream:
    """A camera whose images can be read.

    Raises:
        DatasetError: it is not calibrated, or nothing tells its pose on the rig.
    """
    topic, known = camera.images, reading.settings.extrinsics.camera(camera)
    messages, times = reading.messages(topic)
    first, path = read_picture(messages, 0)
    size = first.shape[1], first.shape[0]
    entry, pose = known if known is not None else (None, None)
    if isinstance(entry, CameraEntry):
        if entry.camera.size != size:
            expected = "x".join(map(str, entry.camera.size))
            raise DatasetError(f"{topic} has images of {size[0]}x{size[1]}, expected {expected} (--extrinsics)", path)
        assert pose is not None
        return BagCamera(camera.name, messages, entry.camera, pose, times)
    if not camera.info:
        raise DatasetError(f"{topic} has no CameraInfo; give its intrinsics by --extrinsics", reading.source)
    try:
        found = calibration_of(reading.survey.first(camera.info), size, camera.rectified)
    except ValueError as bad:
        raise DatasetError(f"{camera.info}: {bad}", reading.source) from None
    if pose is None:
        frame = reading.survey.topics[topic].frame
        pose = reading.frames.transform(reading.base, frame)
        if abs(pose[2, 2]) > _UPRIGHT and "optical" not in frame:
            raise DatasetError(
                f"{topic} would look {'up' if pose[2, 2] > 0 else 'down'}: its frame {frame!r} seems to have x "
                "forward, where images need z forward, x right, y down; give the pose of the camera by --extrinsics",
                reading.source,
            )
        pose = pose @ make_transform(found.R_optical_camera, [0.0, 0.0, 0.0])
    return BagCamera(camera.name, messages, found.camera, pose, times)

"""Faults of recordings are found before any work begins, all at once; lengths that are needed are stated."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from refusals import Notes, assert_names, refused

from relocbench.arrays import Array, Image, Times
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.jobs import inputs
from relocbench.datasets.groundtruth.jobs.inputs import check_space, driven_m, faults_of
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.odometry.deferred import later
from relocbench.datasets.sensors.recording import FieldRecording, Scan, Trajectory
from relocbench.errors import DatasetError, ManyFaults, raise_all
from relocbench.geometry import Camera, make_transform

TENTH = 100_000_000


@dataclass(frozen=True, eq=False)
class Scans:
    """A lidar whose scans have few points; some are damaged, and its driver may send each of them several times."""

    times_ns: Times
    damaged: tuple[int, ...] = ()
    empty: bool = False
    name: str = "top"
    pattern: str = "spinning"
    max_range_m: float = 100.0
    sigma_m: float = 0.02
    sent: int = 1
    measured: int = 1000
    """scans until the lidar stops"""

    @property
    def T_rig_lidar(self) -> Array:
        return np.eye(4)

    def read(self, index: int) -> Scan:
        if index in self.damaged:
            raise DatasetError("is cut off", Path(f"{index}.bin"))
        rng = np.random.default_rng(min(index, self.measured) // self.sent)
        points = rng.normal(size=(0 if self.empty else 20, 3))
        return Scan(points, np.full(len(points), self.times_ns[index]))


@dataclass(frozen=True, eq=False)
class Images:
    times_ns: Times
    size: tuple[int, int] = (40, 30)
    name: str = "front"
    camera: Camera = field(default_factory=lambda: Camera("pinhole", 40, 30, 30.0, 30.0, 20.0, 15.0))

    @property
    def T_rig_cam(self) -> Array:
        return np.eye(4)

    def read(self, index: int) -> Image:
        return np.zeros(self.size[::-1], dtype=np.uint8)

    def file(self, index: int) -> Path | None:
        return Path(f"{index}.png")


def times(count: int, first: int = 0) -> Times:
    return first + TENTH * np.arange(count, dtype=np.int64)


def drive(
    scans: Scans | None = None, images: Images | None = None, metres: float = 40.0, name: str = "summer", shift: int = 0
) -> FieldRecording:
    """Forty scans on a straight road."""
    at = times(40, shift)
    poses = make_transform(np.tile(np.eye(3), (40, 1, 1)), np.linspace([0, 0, 0], [metres, 0, 0], 40))
    cameras = {"front": images} if images else {}
    lidars = (scans or Scans(times(40)),)
    return FieldRecording(name, Path(name), Condition(), Trajectory(at, poses), lidars, cameras)  # type: ignore[arg-type]


def test_a_sound_recording_has_no_fault() -> None:
    assert faults_of(drive(images=Images(times(40))), ["front"]) == []


@pytest.mark.parametrize(
    ("recording", "names"),
    [
        (drive(Scans(times(4))), ("top", 4, 10)),
        (drive(Scans(times(40), damaged=(20,))), ("20.bin",)),
        (drive(Scans(times(40), empty=True)), ("top", "100 m")),
        (drive(images=Images(times(0))), ("front",)),
        (drive(images=Images(times(40), size=(50, 30))), ("front", "50x30", "40x30")),
        (
            drive(images=Images(times(40, 1_700_000_000 * 10**9))),
            ("2023-11-14 22:13:20", "2023-11-14 22:13:23", "0.000 s", "3.900 s"),
        ),
    ],
)
def test_what_is_wrong_with_scans_and_images_is_one_line(recording: FieldRecording, names: tuple[object, ...]) -> None:
    faults = faults_of(recording, ["front"])
    assert faults
    assert_names(str(faults[0]), "", None, *names)
    assert "\n" not in str(faults[0])


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("sent", "measured", "names"),
    [(2, 1000, (20, 40, TENTH)), (5, 1000, (32, 40)), (1, 0, (39, 40)), (1, 30, (9, 31, 30))],
)
def test_a_lidar_that_repeats_its_scans_is_refused(
    sent: int, measured: int, names: tuple[object, ...], known: bool
) -> None:
    recording = drive(Scans(times(40), sent=sent, measured=measured))
    if not known:
        recording = replace(recording, odometry=later(recording.lidars[0]))
        if measured == 30:  # as if the car had stopped there
            assert faults_of(recording, []) == []
            return
    assert_names(str(faults_of(recording, [])[0]), "", None, "top", *names)


def test_a_car_that_stands_may_measure_the_same_again() -> None:
    assert faults_of(drive(Scans(times(40), sent=2), metres=0.1), []) == []


def test_images_that_are_not_paired_are_not_looked_at() -> None:
    assert faults_of(drive(images=Images(times(40), size=(50, 30))), ["rig"]) == []


@pytest.mark.parametrize(
    ("recording", "names"),
    [
        (drive(metres=3.0), ("5 m", "60 m")),
        (drive(shift=10**12), ("top", "1000.000 s", "1003.900 s")),
    ],
)
def test_motion_that_cannot_work_is_a_fault(recording: FieldRecording, names: tuple[object, ...]) -> None:
    faults = inputs.motion_faults(recording, FieldOptions(), Notes())
    assert_names(str(faults[0]), "", None, *names)


def test_a_drive_shorter_than_a_submap_is_noted_with_what_is_possible() -> None:
    notes = Notes()
    assert driven_m(drive()) == pytest.approx(40, abs=0.5)
    assert inputs.motion_faults(drive(), FieldOptions(), notes) == []
    assert_names(notes.notes[0], "", None, "summer", "40 m", "--submap 60")
    assert inputs.motion_faults(drive(), FieldOptions(submap=30.0), notes) == []
    assert len(notes.notes) == 1


def test_a_disk_without_room_is_told_before_it_is_full(tmp_path: Path) -> None:
    check_space(tmp_path / "not" / "yet", 100.0)
    with refused(DatasetError, tmp_path):
        check_space(tmp_path, 1e12)


def test_all_faults_are_one_exception_with_a_line_each() -> None:
    faults = [DatasetError("is cut off", "a.bin"), DatasetError("is empty", "b.bin")]
    with pytest.raises(ManyFaults) as caught:
        raise_all(faults)
    assert str(caught.value) == "a.bin: is cut off\nb.bin: is empty"
    with refused(DatasetError, "a.bin") as one:
        raise_all(faults[:1])
    assert one.value is faults[0]
    raise_all([])


def generic(folder: Path, number: int, fault: bytes) -> Path:
    """A drive of the generic layout without poses, whose odometry would be computed; its last scan has a fault."""
    scans = folder / "lidar" / "top"
    scans.mkdir(parents=True)
    rng = np.random.default_rng(number)
    for k in range(12):
        points = np.column_stack([rng.uniform(-20, 20, size=(500, 3)), rng.random(500)]).astype("<f4")
        (scans / f"{k * TENTH}.bin").write_bytes(points.tobytes())
    last = scans / f"{11 * TENTH}.bin"
    last.write_bytes(last.read_bytes() + fault)
    settings = "lidars: {top: {pattern: spinning, columns: [x, y, z, intensity], dtype: float32}}\n"
    (folder / "lidar.yaml").write_text(settings)
    return folder


def test_the_command_tells_the_faults_of_all_drives_before_it_computes_odometry(tmp_path: Path) -> None:
    drives = [generic(tmp_path / f"drive {number}", number, b"xyz") for number in range(2)]
    outcome = relocbench("build-dataset", "generic-lidar", *drives, "--out", tmp_path / "d", "-j", 1)
    assert outcome.status == 2
    lines = [line for line in outcome.err.splitlines() if line.startswith("relocbench: ")]
    assert len(lines) == 2
    for number, line in enumerate(lines):
        assert_names(line, f"drive {number}/lidar/top/{11 * TENTH}.bin")
    assert "odometry from" not in outcome.err

"""Drives through small scenes: enlarged to the size of a street before, and reduced after, which is exact."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import relocbench
from hypothesis import given
from hypothesis import strategies as st
from lidar_street import Street, drive_street
from recorded_street import StreetDrive, record_street
from refusals import Notes
from small_scenes import Walk, record

from relocbench.arrays import Array, Floats
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.groundtruth.calibration.unknowns import Cause, DriveLidars, Sensors
from relocbench.datasets.groundtruth.jobs.build import build_ground_truth
from relocbench.datasets.groundtruth.jobs.measuring import scale_of_drives
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.groundtruth.jobs.scaling import ReducedReporter, enlarged, reduced_outcome
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.pairs.reasons import kind_of, reduced_words
from relocbench.datasets.groundtruth.registration.scene_scale import read_scale
from relocbench.datasets.sensors.derived_lidar import DerivedLidar
from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, Scan, Trajectory
from relocbench.execution import Run
from relocbench.geometry import invert, make_transform, rotation_angle, se3_exp, se3_log, so3_exp, transform_to_tq
from relocbench.progress import Silent

EIGHTH = 1 / 8


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("no keyframe within 40 m: nearest 64 m", "no keyframe within 5 m: nearest 8 m"),
        ("sigma along the street 0.07 m exceeds 0.05 m", "sigma along the street 0.0088 m exceeds 0.0063 m"),
        ("scans 0.8 m apart fit to 3.2 cm", "scans 0.1 m apart fit to 0.4 cm"),
        (
            "overlap 61 %: 16 mistakes, 12 min, 0.5 deg, 16 ms late",
            "overlap 61 %: 16 mistakes, 12 min, 0.5 deg, 16 ms late",
        ),
        ("nothing within 1200 m of walk2 m", "nothing within 150 m of walk2 m"),
    ],
)
def test_lengths_in_words_are_reduced_and_nothing_else(words: str, expected: str) -> None:
    assert reduced_words(words, 8.0) == expected
    assert reduced_words(words, 1.0) == words
    assert kind_of(reduced_words(words, 8.0)) == kind_of(words)
    told = Notes()
    ReducedReporter(told, 8.0).note(words)
    assert told.notes == [expected]


@given(factor=st.floats(0.05, 100), seed=st.integers(0, 1000))
def test_a_reduced_outcome_is_as_far_off_in_its_sigmas(factor: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = make_transform(so3_exp(rng.normal(size=3)), rng.normal(size=3))
    xi, A = 1e-3 * rng.normal(size=6), rng.normal(size=(6, 6))
    large = np.array(true)
    large[:3, 3] *= factor
    said = large @ se3_exp(np.concatenate([factor * xi[:3], xi[3:]]))
    grown = np.repeat([factor, 1.0], 3)
    covariance = grown[:, None] * (A @ A.T) * grown
    found = reduced_outcome(PairOutcome(1, 2, said, covariance, 3 * factor, factor, factor, 0.1), factor)
    assert found.T_query_ref is not None
    assert found.covariance is not None
    np.testing.assert_allclose(se3_log(invert(true) @ found.T_query_ref), xi, atol=1e-10)
    np.testing.assert_allclose(found.covariance, A @ A.T, rtol=1e-9)
    assert found.sigma_along_m == pytest.approx(3.0)
    assert found.sigma_rotation_deg == 0.1


@pytest.mark.thorough
def test_a_street_stays_as_it_is_and_one_of_an_eighth_is_enlarged() -> None:
    street = drive_street(Street(length_m=60.0, sigma=0.01))
    assert scale_of_drives([street], "auto", Silent()).factor == 1.0
    assert enlarged(street, 1.0) is street
    small = scale_of_drives([_shrunk(street)], "auto", Silent())
    assert 4 < small.factor < 8
    assert scale_of_drives([street], 3.0, Silent()).factor == 3.0


def test_the_noise_of_points_limits_how_much_a_room_is_enlarged() -> None:
    walk = record(1, 0, "lidar", laps=0.3, step_deg=4.0, period_ns=200_000_000)
    factor = scale_of_drives([walk.recording], "auto", Silent()).factor
    assert 3 < factor < 6
    noisy = replace(walk.recording, lidars=tuple(_Noisy(s) for s in walk.recording.lidars))
    assert scale_of_drives([noisy], "auto", Silent()).factor < 0.6 * factor


def test_the_limit_on_sigma_shrinks_with_the_scene_unless_it_is_given() -> None:
    assert FieldOptions().max_sigma_at(8.0) == pytest.approx(0.05 / 8)
    assert FieldOptions(max_sigma=0.05).max_sigma_at(8.0) == 0.05
    assert FieldOptions().max_sigma_at(0.5) == 0.05
    limits = FieldOptions(max_distance=2.0, max_sigma=0.01).limits_at(8.0)
    assert (limits.distance_m, limits.sigma_m, limits.evidence_m) == pytest.approx((16.0, 0.08, 15.0))


def test_what_is_known_of_mountings_does_not_shrink_with_the_scene() -> None:
    lidars = (DriveLidars("a", ("top",)), DriveLidars("b", ("top",)))
    street, room = Sensors(lidars), Sensors(lidars, 8.0)
    metres, factors = np.sqrt(np.diag(street.prior())), np.sqrt(np.diag(room.prior()))
    ratio = np.divide(factors, metres, out=np.ones_like(metres), where=metres > 0).reshape(-1, 7)
    np.testing.assert_allclose(ratio, np.tile([8.0] * 3 + [1.0] * 4, (2, 1)))
    assert Cause("a", "time") in room.causes()


@dataclass(frozen=True, eq=False)
class _Small(DerivedLidar):
    """A lidar in a scene of an eighth of the size, written without the code that enlarges it again."""

    @property
    def T_rig_lidar(self) -> Array:
        return _eighth(self.stream.T_rig_lidar)

    @property
    def max_range_m(self) -> float:
        return self.stream.max_range_m * EIGHTH

    @property
    def sigma_m(self) -> float:
        return self.stream.sigma_m * EIGHTH

    def read(self, index: int) -> Scan:
        scan = self.stream.read(index)
        return Scan(scan.points * EIGHTH, scan.times_ns)


@dataclass(frozen=True, eq=False)
class _Noisy(_Small):
    """A lidar with noise of 3 cm."""

    @property
    def T_rig_lidar(self) -> Array:
        return self.stream.T_rig_lidar

    @property
    def max_range_m(self) -> float:
        return self.stream.max_range_m

    def read(self, index: int) -> Scan:
        scan = self.stream.read(index)
        noise = np.random.default_rng(index).normal(size=scan.points.shape)
        return Scan(scan.points + 0.03 * noise, scan.times_ns)


@dataclass(frozen=True, eq=False)
class _SmallCamera:
    stream: CameraStream

    @property
    def T_rig_cam(self) -> Array:
        return _eighth(self.stream.T_rig_cam)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.stream, name)


def _eighth(T: Array) -> Array:
    return np.asarray(np.vstack([np.hstack([T[:3, :3], T[:3, 3:] * EIGHTH]), T[3:]]))


def _shrunk(recording: FieldRecording) -> FieldRecording:
    def trajectory(t: Trajectory) -> Trajectory:
        return replace(t, T_odom_rig=np.array([_eighth(T) for T in t.T_odom_rig]))

    return replace(
        recording,
        odometry=trajectory(recording.odometry),
        lidars=tuple(_Small(lidar) for lidar in recording.lidars),
        cameras={name: _SmallCamera(stream) for name, stream in recording.cameras.items()},
        prior=None if recording.prior is None else trajectory(recording.prior),
        prior_sigma_m=recording.prior_sigma_m * EIGHTH,
    )


def _built(recordings: list[FieldRecording], options: FieldOptions, out: Path) -> tuple[Dataset, Notes]:
    spoken = Notes()
    writer = DatasetWriter(out, "drives", {"options": options.recorded()}, "unknown")
    return build_ground_truth(recordings, Build(writer, options, spoken, Run(1))), spoken


@pytest.mark.thorough
def test_a_street_of_an_eighth_gives_poses_of_an_eighth_and_accepts_the_same(tmp_path: Path) -> None:
    """Also depth, which is drawn from enlarged submaps."""
    drives: list[StreetDrive] = [record_street(tmp_path / "street", number, azimuths=360) for number in range(2)]
    recordings = [drive.source for drive in drives]
    how: dict[str, Any] = {
        "submap": 20,
        "depth_submap": 12,
        "correspondences": 50,
        "matcher": "fgr",
        "calibration": "given",
    }
    lengths = {"keyframe_distance": 2.0, "query_distance": 5.0, "max_distance": 5.0, "max_sigma": 0.05}
    street, spoken = _built(recordings, FieldOptions(**how, **lengths), tmp_path / "large")
    assert any("as large as a street" in note for note in spoken.notes), spoken.notes
    assert not (tmp_path / "large" / "groundtruth" / "scale.yaml").exists()
    short = {name: length * EIGHTH for name, length in lengths.items()}
    options = FieldOptions(**how, **short, scale=8.0)
    small, spoken = _built([_shrunk(r) for r in recordings], options, tmp_path / "small")
    assert "scale: enlarged 8 times, as given" in spoken.notes
    assert read_scale(tmp_path / "small" / "groundtruth").max_sigma_m == pytest.approx(0.05 / 8)
    pairs = [dataset.pair_sets()[0].all_pairs for dataset in (street, small)]
    assert [p.key for p in pairs[0]] == [p.key for p in pairs[1]]
    assert [p.accepted for p in pairs[0]] == [p.accepted for p in pairs[1]]
    assert sum(p.accepted for p in pairs[0]) >= 3, [p.reason for p in pairs[0]]
    for large, reduced in zip(*pairs, strict=True):
        assert kind_of(large.reason) == kind_of(reduced.reason)
        if large.accepted:
            assert large.T_query_ref is not None
            assert reduced.T_query_ref is not None
            np.testing.assert_allclose(reduced.T_query_ref, _eighth(large.T_query_ref), atol=2e-5)
            assert reduced.sigma_along_m == pytest.approx(large.sigma_along_m * EIGHTH, rel=0.02)
            assert reduced.sigma_rotation_deg == pytest.approx(large.sigma_rotation_deg, rel=0.02)
    camera, name = "camera", recordings[0].name
    time = pairs[0][0].ref_timestamp_ns
    large_depth, small_depth = (_depth(dataset, name, camera, time) for dataset in (street, small))
    both = (large_depth > 0) & (small_depth > 0)
    assert both.mean() > 0.9 * (large_depth > 0).mean() > 0.1
    np.testing.assert_allclose(np.median(small_depth[both] / large_depth[both]), EIGHTH, rtol=1e-3)


def _depth(dataset: Dataset, traversal: str, camera: str, time_ns: int) -> Floats:
    depth = dataset.traversal(traversal).depth(camera, time_ns)
    assert depth is not None
    return depth


def _write_clouds(walk: Walk, folder: Path) -> Path:
    """The walk as a folder of clouds with times in their names and poses, as ``build-dataset clouds`` takes it."""
    folder.mkdir(parents=True)
    lidar = walk.recording.lidars[0]
    for index, time in enumerate(lidar.times_ns.tolist()):
        (folder / f"{time}.bin").write_bytes(lidar.read(index).points.astype("<f4").tobytes())
    t, q = transform_to_tq(walk.recording.odometry.T_odom_rig)
    rows = zip(lidar.times_ns.tolist(), np.hstack([t, q]).tolist(), strict=True)
    lines = [f"{ns / 1e9:.9f} {' '.join(map(repr, values))}" for ns, values in rows]
    (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.thorough
def test_two_walks_through_a_room_are_built_resumed_and_looked_at(tmp_path: Path) -> None:
    walks = [record(1, walk, "lidar", laps=0.7, step_deg=4.0, period_ns=200_000_000) for walk in range(2)]
    folders = [_write_clouds(walk, tmp_path / f"walk {number}") for number, walk in enumerate(walks)]
    out = tmp_path / "D"
    at = [len(walk.truth.times_ns) // 2 for walk in walks]
    T_ref_query = invert(walks[0].truth.T_odom_rig[at[0]]) @ walks[1].truth.T_odom_rig[at[1]]
    t, q = transform_to_tq(T_ref_query)
    by_hand = [*(int(w.truth.times_ns[k]) for w, k in zip(walks, at, strict=True)), *(t + 0.02).tolist(), *q.tolist()]
    asked = ("--keyframe-distance", 0.2, "--query-distance", 0.3, "--first-pose", " ".join(map(repr, by_hand)), "-j", 1)
    outcome = relocbench("build-dataset", "clouds", *folders, "--out", out, *asked)
    assert outcome.status == 0, outcome.err
    assert "times to the size of a street" in outcome.err
    dataset = Dataset(out)
    factor = read_scale(out / "groundtruth").factor
    assert 3 < factor < 6
    pairs = dataset.pair_sets()[0].all_pairs
    accepted = [p for p in pairs if p.accepted]
    assert len(accepted) >= 0.8 * len(pairs) >= 4
    for pair in accepted:
        assert pair.T_query_ref is not None
        T_world_ref = walks[0].truth.at(np.array([pair.ref_timestamp_ns]))[0]
        T_world_query = walks[1].truth.at(np.array([pair.query_timestamp_ns]))[0]
        E = pair.T_query_ref @ invert(T_world_ref) @ T_world_query
        assert np.linalg.norm(invert(E)[:3, 3]) < 0.015
        assert np.degrees(rotation_angle(E[:3, :3])) < 0.3
        assert pair.sigma_along_m is not None
        assert pair.sigma_along_m < 0.05 / factor
    again = relocbench("build-dataset", "clouds", *folders, "--out", out, *asked)
    assert again.status == 0, again.err
    assert Dataset(out).fingerprint == dataset.fingerprint
    other = relocbench("build-dataset", "clouds", *folders, "--out", out, *asked, "--scale", 3)
    assert other.status == 2, other.err
    looked = relocbench("inspect", out, "--ground-truth", tmp_path / "check", "--pairs", 1)
    assert looked.status == 0, looked.err
    page = (tmp_path / "check" / "index.html").read_text()
    assert f"enlarged {factor:.3g} times" in page
    assert relocbench("validate", out).status == 0
    wrong = relocbench("build-dataset", "clouds", *folders, "--out", tmp_path / "E", "--scale", "huge")
    assert wrong.status == 2
    assert "--scale" in wrong.complaint

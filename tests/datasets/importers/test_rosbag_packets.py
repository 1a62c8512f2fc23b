"""Bags with packets of a Velodyne: points, times, clocks, and faults."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_bags import SECOND, Bag
from refusals import ErrorData, refused
from velodyne_packets import BLOCK_US, DUAL, ELEVATION_DEG, FIRING_US, packet, turn_of

from relocbench.arrays import Array
from relocbench.datasets.importers.rosbag.packets import PacketReading, check_calibration, packet_points
from relocbench.datasets.importers.rosbag.reading import BagSettings
from relocbench.datasets.importers.rosbag.recording import open_bag, read_bag
from relocbench.datasets.importers.rosbag.roles import Wanted
from relocbench.errors import ConfigError, DatasetError

START = 1_501_822_800 * SECOND
"""a whole hour"""
WALL_M = 12.0
CROSSING_M = 0.02
"""beams leave the lidar up to so far from its origin"""


def message(packets: list[tuple[int, bytes]], stamp: int | None = None) -> Any:
    """A VelodyneScan: nanoseconds and bytes of packets; the stamp is that of the last, as drivers have it."""

    def at(time: int) -> Any:
        return SimpleNamespace(sec=time // SECOND, nanosec=time % SECOND)

    found = [SimpleNamespace(stamp=at(time), data=np.frombuffer(raw, np.uint8)) for time, raw in packets]
    return SimpleNamespace(header=SimpleNamespace(stamp=at(packets[-1][0] if stamp is None else stamp)), packets=found)


def wall_ahead(azimuth: Array, elevation: Array, at: Array) -> Array:
    """Ranges of a wall across the direction of azimuth 0."""
    cosine = np.cos(np.radians(azimuth)) * np.cos(np.radians(elevation))
    return np.where(cosine > 0.15, WALL_M / np.where(cosine > 0.15, cosine, 1.0), 0.0)


def stamped(packets: list[tuple[int, bytes]], offset_us: int = 0) -> list[tuple[int, bytes]]:
    return [(START + (time + offset_us) * 1000, raw) for time, raw in packets]


def test_a_wall_is_where_the_beams_met_it() -> None:
    points, _ = packet_points(message(stamped(turn_of(wall_ahead, 10.0, 0))), PacketReading())
    assert len(points) > 20_000
    np.testing.assert_allclose(points[:, 0], WALL_M, atol=CROSSING_M + 0.01)
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    apart = np.abs(elevation[:, None] - ELEVATION_DEG)
    assert apart.min(axis=1).max() < 0.12
    assert len(np.unique(apart.argmin(axis=1))) == 32
    assert points[:, 1].min() < -10
    assert points[:, 1].max() > 10


def test_azimuths_grow_to_the_right_and_with_each_firing() -> None:
    """A lidar that turns fast: between the first and the last beam of a block it turns by a quarter of a degree."""
    ranges = np.zeros((12, 32))
    ranges[3, [0, 31]] = 20.0
    azimuths = 4500 + np.arange(12) * 34
    points, offsets = packet_points(message([(START, packet(azimuths, ranges, 0))]), PacketReading())
    turned = np.degrees(np.arctan2(-points[:, 1], points[:, 0]))
    between = 34 * 31 * FIRING_US / BLOCK_US
    np.testing.assert_allclose(turned, (4500 + 3 * 34 + np.array([0, between])) / 100, atol=0.006)
    np.testing.assert_allclose(offsets, 1000 * (3 * BLOCK_US + np.array([0, 31 * FIRING_US])), atol=2)


def test_points_have_the_times_of_their_firings_across_the_hour() -> None:
    """The sensor's clock begins anew each hour; host stamps jitter by milliseconds."""
    begin = 3_600_000_000 - 40_000
    jitter = np.random.default_rng(3)
    turn = turn_of(lambda azimuth, elevation, at: 5.0 + azimuth / 36, 10.0, begin)
    packets = [(START + (time + int(jitter.integers(-900, 900))) * 1000, raw) for time, raw in turn]
    scan = message(packets)
    points, offsets = packet_points(scan, PacketReading())
    stamp = packets[-1][0]
    azimuth = 36 * (np.linalg.norm(points, axis=1) - 5.0)
    since_begin = stamp + offsets - (START + begin * 1000)
    assert np.median(np.abs(since_begin - azimuth / 3600 * 1e9)) < 300_000
    assert np.ptp(since_begin - azimuth / 3600 * 1e9) < 250_000  # ranges tell azimuths to half a degree


def test_a_sensor_clock_that_makes_no_sense_is_not_used() -> None:
    packets = stamped(turn_of(wall_ahead, 10.0, 0))
    still = [(time, raw[:-6] + bytes(4) + raw[-2:]) for time, raw in packets]
    expected = packet_points(message(packets), PacketReading())
    found = packet_points(message(still), PacketReading())
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_allclose(found[1], expected[1], atol=2000)


def test_both_returns_of_a_beam_are_read() -> None:
    ranges = np.zeros((12, 32))
    ranges[0::2], ranges[1::2] = 30.0, 10.0
    azimuths = np.repeat(np.arange(6) * 17, 2)
    points, offsets = packet_points(message([(START, packet(azimuths, ranges, 0, DUAL))]), PacketReading())
    distance = np.linalg.norm(points, axis=1)
    assert np.sum(distance > 20) == np.sum(distance < 20) == 6 * 32
    assert offsets.max() == pytest.approx(1000 * (5 * BLOCK_US + 31 * FIRING_US), abs=2)


def test_old_packets_that_name_no_model_are_read_if_it_is_known() -> None:
    packets = stamped(turn_of(wall_ahead, 10.0, 0))
    old = message([(time, raw[:-2] + b"\0\0") for time, raw in packets])
    found = packet_points(old, PacketReading(hdl_32e=True))
    np.testing.assert_array_equal(found[0], packet_points(message(packets), PacketReading())[0])
    with refused(ValueError, "", None, "0x00", "HDL-32E", "VLP-16"):
        packet_points(old, PacketReading())


@pytest.mark.parametrize(
    ("scan", "words"),
    [
        (lambda p: message([(p[0][0], p[0][1][:-7])]), ("", None, "1199", "1206")),
        (lambda p: message(p, START + 5 * SECOND), ("", None, "-5.0")),
        (lambda p: message([p[0], (p[1][0] + 9 * SECOND, p[1][1])], p[0][0]), ("", None, "9.0")),
        (lambda p: message([(p[0][0], p[0][1][:-1] + b"\x22"), p[1]]), ()),
    ],
)
def test_damaged_packets_are_told(scan: Callable[[Any], Any], words: ErrorData) -> None:
    with refused(ValueError, *words):
        packet_points(scan(stamped(turn_of(wall_ahead, 10.0, 0))), PacketReading())


def test_another_model_than_the_known_one_is_told() -> None:
    raw = packet(np.arange(12), np.full((12, 32), 9.0), 0, product=0x22)
    with refused(ValueError, "", None, "VLP-16", "HDL-32E"):
        packet_points(message([(START, raw)]), PacketReading(hdl_32e=True))


def test_a_calibration_of_the_beams_turns_them(tmp_path: Path) -> None:
    path = tmp_path / "lidar intrinsics.yaml"
    rows = [
        f"- {{dist_correction: 0.0, dist_correction_x: 0.0, dist_correction_y: 0.0, laser_id: {k}, "
        f"rot_correction: -1.5707963267948966, vert_correction: {np.radians(angle)}, vert_offset_correction: 0.0}}\n"
        for k, angle in enumerate(ELEVATION_DEG)
    ]
    path.write_text("lasers:\n" + "".join(rows) + "num_lasers: 32\ndistance_resolution: 0.002\n")
    check_calibration(path)
    scan = message(stamped(turn_of(wall_ahead, 10.0, 0)))
    points, _ = packet_points(scan, PacketReading(calibration=path))
    assert np.abs(np.abs(points[:, 1]) - WALL_M).max() < 0.02
    (tmp_path / "broken.yaml").write_text("lasers: [1, 2\n")
    for name, words in (("broken.yaml", "broken.yaml: is not a calibration of the beams"), ("none.yaml", "missing")):
        with pytest.raises(DatasetError, match=words):
            check_calibration(tmp_path / name)


def bag_of_packets(ros1: bool = True) -> Bag:
    """A standing lidar that sees a wall."""
    bag = Bag(ros1)
    for k in range(12):
        packets = stamped(turn_of(wall_ahead, 10.0, 0), k * 100_000)
        bag.packets("/velodyne_packets", packets[-1][0], packets, "lidar")
        bag.odometry("/odom", START + k * SECOND // 10, (k * 0.5, 0, 0, 0, 0, 0, 1))
    bag.odometry("/odom", START + 2 * SECOND, (6, 0, 0, 0, 0, 0, 1))
    bag.tf(START, ("base_link", "lidar", (1.0, 0.0, 1.8, 0.0, 0.0, 0.0, 1.0)))
    return bag


@pytest.mark.parametrize("storage", ["rosbag1", "rosbag2", "mcap"])
def test_a_bag_of_packets_is_read_like_one_of_clouds(tmp_path: Path, storage: str) -> None:
    bag = bag_of_packets(storage == "rosbag1")
    path = bag.write(tmp_path / f"drive{'.bag' if storage == 'rosbag1' else ''}", storage)
    lidar = read_bag(open_bag(path, Wanted()), "drive", BagSettings())[0].lidars[0]
    assert (lidar.name, lidar.pattern) == ("velodyne_packets", "spinning")
    scan = lidar.read(3)
    np.testing.assert_allclose(scan.points[:, 0], WALL_M, atol=0.03)
    times = scan.times_ns - START - 300_000_000
    assert -100_000 < times.min() < 1_000_000
    assert 99_000_000 < times.max() < 100_100_000
    still = BagSettings(motion="compensated")
    scan = read_bag(open_bag(path, Wanted()), "drive", still)[0].lidars[0].read(3)
    assert len(np.unique(scan.times_ns)) == 1


def test_clouds_are_preferred_to_packets_and_packets_can_be_named(tmp_path: Path) -> None:
    bag = bag_of_packets()
    cloud = np.zeros(50, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))
    cloud["x"], cloud["y"], cloud["z"] = 5.0, np.linspace(-3, 3, 50), np.tile([0, 1], 25)
    for k in range(12):
        bag.cloud("/velodyne_points", START + k * SECOND // 10, cloud)
    path = bag.write(tmp_path / "drive.bag")
    roles = open_bag(path, Wanted()).roles
    assert list(roles.lidars.values()) == ["/velodyne_points"]
    assert roles.why["/velodyne_packets"] == ("-", "there are clouds")
    named = open_bag(path, Wanted(lidars=("/velodyne_packets",)))
    assert len(read_bag(named, "drive", BagSettings())[0].lidars[0].read(0).points) > 20_000


@pytest.mark.thorough
def test_a_damaged_packet_names_topic_and_time_and_an_option_that_does_not_fit_is_told(tmp_path: Path) -> None:
    from relocbench.datasets.sensors.point_times import PointTimes

    bag = bag_of_packets()
    scan = [m for _, topic, m in bag.rows if topic == "/velodyne_packets"][4]
    scan.packets[7].data[-1] = 0x77
    path = bag.write(tmp_path / "drive.bag")
    opened = open_bag(path, Wanted())
    with refused(DatasetError, "drive.bag", None, "velodyne_packets", "0x77"):
        read_bag(opened, "drive", BagSettings())[0].lidars[0].read(4)
    with refused(ConfigError, "", None, "--point-time", "velodyne_packets"):
        read_bag(opened, "drive", BagSettings(point_times=PointTimes("time", "s", "scan")))

"""Readers of point clouds, lidar scans and what is kept of lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fuzz.asking import write
from fuzz.parser import Parser, Place

if TYPE_CHECKING:
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles
    from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, LidarStream

_NAMES = ("x", "y", "z", "intensity")


def points(count: int = 12) -> np.ndarray:
    """(count, 4) x, y, z, intensity: eighths of metres, which every format holds exactly."""
    rng = np.random.default_rng(1)
    return rng.integers(8, 160, (count, 4)) / 8


def write_clouds(root: Path) -> None:
    """The same points in every format that is read."""
    folder = root / "clouds"
    folder.mkdir()
    cloud = points()
    text = "".join(" ".join(f"{v:g}" for v in row) + "\n" for row in cloud)
    binary = cloud.astype("<f4").tobytes()
    properties = "".join(f"property float {name}\n" for name in _NAMES)
    for kind, body in (
        ("ascii", text.encode()),
        ("binary_little_endian", binary),
        ("binary_big_endian", cloud.astype(">f4").tobytes()),
    ):
        head = f"ply\nformat {kind} 1.0\ncomment made up\nelement vertex {len(cloud)}\n{properties}end_header\n"
        (folder / f"{kind}.ply").write_bytes(head.encode() + body)
    faces = "property list uchar int vertex_indices"
    faces = f"ply\nformat ascii 1.0\nelement vertex {len(cloud)}\n{properties}element face 1\n{faces}\nend_header\n"
    (folder / "faces.ply").write_text(f"{faces}{text}3 0 1 2\n")
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\n"
        f"COUNT 1 1 1 1\nWIDTH {len(cloud)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(cloud)}\nDATA "
    )
    (folder / "ascii.pcd").write_text(f"{head}ascii\n{text}")
    (folder / "binary.pcd").write_bytes(f"{head}binary\n".encode() + binary)
    (folder / "packed.pcd").write_bytes(
        f"{head}binary_compressed\n".encode() + _packed(cloud.astype("<f4").T.tobytes())
    )


def write_map_clouds(root: Path) -> None:
    """The same points as LAS of versions 1.2 and 1.4, LAZ, E57, and text with headers of several kinds."""
    import laspy
    import pye57

    folder = root / "clouds"
    folder.mkdir()
    cloud = points(30)
    x, y, z = cloud[:, :3].T
    keys = np.array([1, 1, 0, 2, 1024, 0, 1, 1, 3076, 0, 1, 9003], "<u2").tobytes()
    text = b'PROJCS["a",GEOGCS["b",UNIT["degree",0.0174]],UNIT["foot",0.3048]]\0'
    for name, version, kind, record in (
        ("feet.las", "1.2", 0, (34735, keys)),
        ("text.las", "1.4", 6, (2112, text)),
        ("packed.laz", "1.2", 3, (34735, keys)),
        ("packed14.laz", "1.4", 6, (2112, text)),
    ):
        made = laspy.LasData(laspy.LasHeader(point_format=kind, version=version))
        made.header.scales = np.full(3, 0.125)
        made.vlrs.append(laspy.VLR("LASF_Projection", record[0], "", record[1]))
        if version == "1.4":
            made.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("LASF_Projection", 2112, "", text)])
        made.x, made.y, made.z = x, y, z
        made.write(str(folder / name))
    with pye57.E57(str(folder / "setups.e57"), mode="w") as file:
        for _ in range(2):
            file.write_scan_raw(
                {"cartesianX": x, "cartesianY": y, "cartesianZ": z},
                rotation=np.array([1.0, 0, 0, 0]),
                translation=np.zeros(3),
            )
    rows = cloud.tolist()
    for name, head, mark in (
        ("id.csv", ["id,x,y,z,time"], ","),
        ("compare.asc", ["//X Y Z Intensity", str(len(rows))], " "),
        ("scans.pts", [str(len(rows))], " "),
        ("semicolons.txt", ["y;x;z[m];i"], ";"),
    ):
        numbered = name == "id.csv"
        lines = [mark.join(f"{v:g}" for v in ([k, *row] if numbered else row)) for k, row in enumerate(rows)]
        write(folder / name, *head, *lines)


def _packed(data: bytes) -> bytes:
    """LZF that only quotes: runs of up to 32 literal bytes, each after its length less one."""
    runs = b"".join(bytes([len(part) - 1]) + part for part in (data[i : i + 32] for i in range(0, len(data), 32)))
    return len(runs).to_bytes(4, "little") + len(data).to_bytes(4, "little") + runs


def write_lidar_folder(root: Path) -> None:
    """A generic folder whose one lidar has a scan in each format."""
    cloud = points()
    write_clouds(root)
    folder = root / "drive" / "lidar" / "top"
    folder.mkdir(parents=True)
    for number, name in enumerate(("binary_little_endian.ply", "binary.pcd")):
        (folder / f"{number}00000000{Path(name).suffix}").write_bytes((root / "clouds" / name).read_bytes())
    cloud.astype("<f4").tofile(folder / "200000000.bin")
    np.save(folder / "300000000.npy", cloud.astype(np.float32))
    columns = [(name, "<f4") for name in _NAMES]
    np.save(folder / "400000000.npy", np.array([tuple(row) for row in cloud], dtype=columns))
    write(
        root / "drive" / "lidar.yaml",
        "lidars:",
        "  top: {pattern: spinning, max_range: 80, min_range: 0.5, sigma: 0.02, columns: [x, y, z, intensity]}",
        "rig_axes: forward-left-up",
    )
    write(root / "drive" / "poses.txt", *(f"{i}.5 {i} 0 0 0 0 0 1" for i in range(3)))


def write_kept(root: Path) -> None:
    """What a build of ground truth keeps: blocks, registrations, graphs, its journal."""
    from relocbench.datasets.groundtruth.blocks.blocks import Block, Nodes
    from relocbench.datasets.groundtruth.blocks.store import write_block
    from relocbench.datasets.groundtruth.pose_graph.files import PlacedDrive, write_graph
    from relocbench.datasets.groundtruth.registration.files import write_registrations
    from relocbench.datasets.groundtruth.registration.hypotheses import SearchResult
    from relocbench.datasets.groundtruth.registration.journal import Journal
    from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration

    folder = root / "kept"
    folder.mkdir()
    cloud = points()[:, :3].astype(np.float32)
    flat = np.zeros(len(cloud))
    block = Block(cloud, cloud, cloud, flat.astype(np.uint8), flat.astype(np.float32))
    write_block(folder / "000000.npz", block)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = range(3)
    times = np.arange(3, dtype=np.int64) * 10**9
    nodes = Nodes(times, poses, np.arange(3.0))
    evidence = Evidence(0.5, 0.5, 0.25, 0.25, 0.0, 0.0, 0.5, (1.0, 0.0, 0.0), 0.5)
    found = [Registration(i, i, poses[i], np.eye(6), evidence, "too few points agree" if i else "") for i in range(3)]
    write_registrations(folder / "a__b.csv", found, nodes, nodes)
    ways = np.tile([1.0, np.inf], (3, 1))
    drives = [PlacedDrive(name, times, poses, ways, {1: "", 2: "far"}) for name in ("a", "b")]
    write_graph(folder / "graph.csv", drives[0], drives[1])
    journal = Journal(folder / "journal.jsonl")
    for i in range(2):
        journal.remember(f"pair {i}", lambda i=i: SearchResult(found[i]))  # type: ignore[misc]
    journal.close()


def _cloud(place: Place) -> None:
    from relocbench.datasets.sensors.cloud_formats.point_clouds import read_point_cloud

    read_point_cloud(place.target)


def _any_cloud(place: Place) -> list[str]:
    from relocbench.datasets.sensors.cloud_files import read_cloud

    return list(read_cloud(place.target).notes)


def _e57_with_checksums(place: Place) -> list[str]:
    """Read an E57 file whose pages have right checksums, without which damage to its points is not looked at."""
    from relocbench.datasets.sensors.cloud_files import read_cloud

    if not place.target.is_file() or place.target.stat().st_size > 2**16:
        return list(read_cloud(place.target).notes)
    data = place.target.read_bytes()
    pages = [data[at : at + 1020] for at in range(0, len(data), 1024)]
    target = place.out / "right.e57"
    target.write_bytes(b"".join(page + _crc32c(page).to_bytes(4, "big") for page in pages))
    return list(read_cloud(target).notes)


def _crc32c(data: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def read_all(recording: FieldRecording | DriveFiles) -> None:
    """Every scan and image of a recording."""
    streams: list[LidarStream | CameraStream] = [*recording.lidars, *recording.cameras.values()]
    for stream in streams:
        for index in range(len(stream.times_ns)):
            stream.read(index)


def _velodyne(place: Place) -> None:
    from relocbench.datasets.sensors.velodyne import read_scan

    read_scan(place.target)


def _lidar_folder(place: Place) -> None:
    from relocbench.datasets.importers.generic.recording import read_generic

    read_all(read_generic(place.root / "drive", odometry="poses"))


def _block(place: Place) -> None:
    from relocbench.datasets.groundtruth.blocks.store import read_block

    read_block(place.target)


def _registrations(place: Place) -> None:
    from relocbench.datasets.groundtruth.registration.files import read_registrations

    read_registrations(place.target)


def _graph(place: Place) -> None:
    from relocbench.datasets.groundtruth.pose_graph.files import read_graph

    read_graph(place.target, "a", "b")


def _journal(place: Place) -> None:
    from relocbench.datasets.groundtruth.registration.journal import Journal

    Journal(place.target).close()


SEEDS = {"clouds": write_clouds, "map-clouds": write_map_clouds, "lidar-folder": write_lidar_folder, "kept": write_kept}
PARSERS = (
    Parser("ply", "clouds", ("clouds/*.ply",), _cloud),
    Parser("pcd", "clouds", ("clouds/*.pcd",), _cloud),
    Parser("las", "map-clouds", ("clouds/*.las",), _any_cloud),
    Parser("laz", "map-clouds", ("clouds/*.laz",), _any_cloud),
    Parser("e57-checksums", "map-clouds", ("clouds/*.e57",), _e57_with_checksums),
    Parser("e57", "map-clouds", ("clouds/*.e57",), _any_cloud),
    Parser(
        "text-clouds",
        "map-clouds",
        tuple(f"clouds/*.{kind}" for kind in ("csv", "asc", "pts", "txt")),
        _any_cloud,
        text=True,
    ),
    Parser("velodyne", "lidar-folder", ("drive/lidar/top/*.bin",), _velodyne),
    Parser("scans", "lidar-folder", ("drive/lidar/top/*",), _lidar_folder, names=True),
    Parser("lidar.yaml", "lidar-folder", ("drive/lidar.yaml",), _lidar_folder, text=True),
    Parser("blocks", "kept", ("kept/*.npz",), _block, brief=False),
    Parser("registrations", "kept", ("kept/a__b.csv",), _registrations, text=True, brief=False),
    Parser("graph", "kept", ("kept/graph.csv",), _graph, text=True, brief=False),
    Parser("registration-journal", "kept", ("kept/journal.jsonl",), _journal, text=True, resumes=True, brief=False),
)

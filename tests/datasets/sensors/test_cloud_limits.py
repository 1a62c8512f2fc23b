"""Lidar scans: what their headers declare is held against the file; damaged ones are refused in one line."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike
from refusals import ErrorData, refused

from relocbench.datasets.core.npy import parse_npz
from relocbench.datasets.groundtruth.blocks.store import read_block
from relocbench.datasets.importers.generic.scans import GenericLidar, GenericLidarStream
from relocbench.datasets.sensors.cloud_formats.lzf import decompress
from relocbench.datasets.sensors.cloud_formats.point_clouds import read_point_cloud
from relocbench.datasets.sensors.velodyne import read_scan
from relocbench.errors import DatasetError

XYZ = "property float x\nproperty float y\nproperty float z\n"
POINTS = np.arange(12, dtype="<f4").reshape(4, 3)
PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\nPOINTS {count}\nDATA {data}\n"


def ply(
    encoding: str = "ascii", count: object = 4, properties: str = XYZ, body: bytes = b"", before: str = ""
) -> bytes:
    head = f"ply\nformat {encoding} 1.0\n{before}element vertex {count}\n{properties}end_header\n"
    return head.encode() + body


def pcd(data: str = "ascii", count: object = 4, body: bytes = b"", head: str = PCD) -> bytes:
    return head.format(count=count, data=data).encode() + body


def npy(header: str, body: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + body


def npy_of(shape: str, dtype: str = "'<f4'", body: bytes = b"") -> bytes:
    return npy(f"{{'descr': {dtype}, 'fortran_order': False, 'shape': {shape}, }}\n", body)


def saved(values: ArrayLike) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


BINARY = "binary_little_endian"
COMPRESSED = struct.pack("<II", 100, 4 * 12)
REFUSED: dict[str, tuple[str, bytes, ErrorData]] = {
    "a long word in a PLY's header": ("ply", ply(before="comment " + "x" * 60000 + "\n"), (None,)),
    "a longer one": ("ply", ply(before="x" * 10_000_000 + "\n"), (None,)),
    "10^15 points": ("ply", ply(BINARY, 10**15, body=bytes(48)), (None, "1000000000000000", "4")),
    "10^15 points as text": ("ply", ply("ascii", 10**15, body=b"1 2 3\n"), (None, "1000000000000000", "1")),
    "5000 digits": ("ply", ply(BINARY, "9" * 5000), (None,)),
    "a superscript": ("ply", ply(BINARY, "²"), (None,)),
    "a negative count": ("ply", ply(BINARY, -1), (None,)),
    "a list of each point": ("ply", ply(BINARY, 4, XYZ + "property list uchar int a\n", bytes(99)), (None,)),
    "a type that there is not": ("ply", ply(BINARY, 4, XYZ + "property quad a\n", bytes(99)), (None,)),
    "faces first": ("ply", ply(before="element face 3\nproperty list uchar int a\n"), (None, "vertex")),
    "no format": ("ply", b"ply\nelement vertex 1\n" + XYZ.encode() + b"end_header\n", (None,)),
    "no properties": ("ply", ply(BINARY, 10**12, ""), (None,)),
    "no properties, as text": ("ply", ply("ascii", 10**12, "", b"1\n"), (None,)),
    "no z": ("ply", ply(BINARY, 1, "property float x\nproperty float y\n", bytes(8)), (None,)),
    "twice x": ("ply", ply(BINARY, 1, XYZ + "property float x\n", bytes(16)), (None,)),
    "a word in place of a number": ("ply", ply(body=b"1 2 3\n4 5 6\n7 eight 9\n1 2 3\n"), (10,)),
    "a number too many": ("ply", ply(body=b"1 2 3\n4 5 6 7\n7 8 9\n1 2 3\n"), (9, "3")),
    "a line without end": ("ply", ply(count=1, body=b"1 " * 1_000_000), (8, "3")),
    "cut in a point": ("ply", ply(BINARY, body=bytes(47)), (None, "4", "3")),
    "a header alone": ("ply", b"ply\nformat ascii 1.0\n", (None,)),
    "an empty PLY": ("ply", b"", (None,)),
    "PCD of 10^15 points": ("pcd", pcd("binary", 10**15, bytes(48)), (None, "1000000000000000", "4")),
    "PCD of text": ("pcd", pcd("ascii", 4, b"1 2 3\n4 5 six\n7 8 9\n0 0 0\n"), (11,)),
    "PCD without sizes": ("pcd", pcd(head=PCD.replace("SIZE 4 4 4\n", "")), (None,)),
    "PCD of odd sizes": ("pcd", pcd(head=PCD.replace("SIZE 4 4 4", "SIZE 4 4 3")), (None,)),
    "PCD of huge counts": ("pcd", pcd(head=PCD.replace("COUNT 1 1 1", "COUNT 1 1 99999999")), (None, "COUNT")),
    "PCD of zero counts": ("pcd", pcd(head=PCD.replace("COUNT 1 1 1", "COUNT 1 1 0")), (None, "COUNT")),
    "PCD without points": ("pcd", pcd(head=PCD.replace("POINTS {count}\n", "")), (None,)),
    "PCD of other data": ("pcd", pcd("zipped"), (None, "DATA")),
    "PCD bomb": ("pcd", pcd("binary_compressed", 10**9, struct.pack("<II", 9, 2**32 - 1) + bytes(9)), (None,)),
    "PCD whose sizes lie": ("pcd", pcd("binary_compressed", 4, COMPRESSED + bytes(9)), (None, "100")),
    "PCD, damaged": ("pcd", pcd("binary_compressed", 4, struct.pack("<II", 4, 48) + b"\xff" * 4), (None,)),
    "PCD, cut": ("pcd", pcd("binary_compressed", 4, b"\0\0"), (None, "0")),
    "an array of 10^15": ("npy", npy_of("(1000000000000000, 4)"), (None, "4000000000000000")),
    "an array too large for 64 bits": ("npy", npy_of("(10**9, 4)".replace("10**9", "9" * 60)), (None,)),
    "an array of negative size": ("npy", npy_of("(-5, 4)"), (None,)),
    "an array of objects": ("npy", saved(np.array([[1, "a"]], dtype=object)), (None,)),
    "an array of words": ("npy", saved(np.array([["x", "y", "z", "i"]])), (None,)),
    "an array of nothing": ("npy", npy_of("(1000000000000, 4)", "'|V0'"), (None,)),
    "an array of complex": ("npy", saved(np.zeros((3, 4), complex)), (None,)),
    "brackets": ("npy", npy("(" * 5000), (None,)),
    "no array": ("npy", b"\x93NUMPY\x09\x00abc", (None,)),
    "one dimension": ("npy", saved(np.zeros(12, np.float32)), (None, "12")),
    "no dimension": ("npy", saved(np.float32(3)), (None,)),
    "records without x": ("npy", saved(np.zeros(3, [("y", "f4"), ("z", "f4")])), (None,)),
    "records of vectors": ("npy", saved(np.zeros(3, [("x", "f4", 3), ("y", "f4"), ("z", "f4")])), (None,)),
    "half a point": ("bin", bytes(17), (None, "17")),
}  # fmt: skip


def stream(path: Path, **settings: object) -> GenericLidarStream:
    lidar = GenericLidar(pattern="spinning", **settings)
    return GenericLidarStream("top", lidar, np.eye(4), (path,), np.array([10**18]))


@pytest.mark.thorough
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", REFUSED)
def test_a_damaged_scan_is_refused_in_one_line_and_takes_little_memory(tmp_path: Path, case: str) -> None:
    suffix, data, (line, *names) = REFUSED[case]
    path = tmp_path / f"0.{suffix}"
    path.write_bytes(data)
    decompress(np.array([0, 0], np.uint8), 1)  # its kernel is compiled
    tracemalloc.start()  # numpy tells it what it takes
    with refused(DatasetError, path.name, line, *names) as caught:
        stream(path, columns=("x", "y", "z", "intensity"), dtype="float32").read(0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    assert len(caught.value.expected) < 250
    assert peak < 4 * len(data) + 2**22


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npy", "bin"])
def test_a_folder_a_device_and_a_missing_file_are_refused_by_name(tmp_path: Path, suffix: str) -> None:
    folder, device, missing = (tmp_path / f"{n}.{suffix}" for n in range(3))
    folder.mkdir()
    device.symlink_to("/dev/zero")
    for path, names in ((folder, ("folder",)), (device, ("device",)), (missing, ())):
        with refused(DatasetError, path.name, None, *names):
            stream(path).read(0)
        with refused(DatasetError, path.name, None, *names, "lidar scan"):
            read_scan(path)


@pytest.mark.parametrize("encoding", ["ascii", BINARY, "binary_big_endian"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_a_ply_is_read_whatever_its_encoding(tmp_path: Path, encoding: str, line_end: str) -> None:
    row = [("x", "f8"), ("flag", "u1"), ("y", "f4"), ("z", "i2")]
    values = np.array([(0.1, 200, 2.5, -3), (np.nan, 0, 1e30, 32767), (1e-300, 7, -0.0, 5)], dtype=row)
    head = (
        ply(
            encoding,
            3,
            "property double x\nproperty uchar flag\nproperty float y\nproperty int16 z\n",
            before="comment end_header comes later\nobj_info nothing\n",
        )
        .decode()
        .replace("end_header\n", "element face 1\nproperty list uchar int vertex_indices\nend_header\n")
    )
    head = head.replace(
        "comment element face 1\nproperty list uchar int vertex_indices\nend_header", "comment end_header"
    )
    if encoding == "ascii":
        body = line_end.join(" ".join(repr(v) for v in point) for point in values.tolist()).encode() + line_end.encode()
    else:
        body = values.astype(values.dtype.newbyteorder("<" if encoding == BINARY else ">")).tobytes()
    path = tmp_path / "0.ply"
    path.write_bytes(head.replace("\n", line_end).encode() + body + b"3 0 1 2")
    found = read_point_cloud(path)
    assert list(found) == ["x", "flag", "y", "z"]
    for name, values_of in found.items():
        as_text = encoding == "ascii" and name == "y"  # text keeps all its digits
        assert values_of.dtype == (np.dtype("f8") if as_text else values[name].dtype)
        values_of = values_of.astype(values[name].dtype)
        assert np.array_equal(values_of, values[name], equal_nan=values_of.dtype.kind == "f")


def test_lzf_repeats_what_it_is_still_writing() -> None:
    packed = np.array(
        [1, 7, 9, 0xE0, 3, 1, 0x20, 0], dtype=np.uint8
    )  # 7 9, then 12 bytes from two back, then 3 from one
    found = decompress(packed, 17)
    assert found is not None
    assert found.tolist() == [7, 9] * 7 + [9, 9, 9]
    for size in (0, 16, 18):
        assert decompress(packed, size) is None
    for cut in range(1, len(packed)):
        assert decompress(packed[:cut], 17) is None
    assert decompress(np.array([0x20, 0], np.uint8), 3) is None  # from before the beginning


@pytest.mark.parametrize("suffix", ["ply", "pcd"])
@pytest.mark.parametrize("how", ["ascii", "binary", "compressed"])
def test_scans_that_open3d_writes_are_read_as_it_reads_them(tmp_path: Path, suffix: str, how: str) -> None:
    import open3d as o3d

    rng = np.random.default_rng(1)
    path = tmp_path / f"0.{suffix}"
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(rng.normal(0, 30, (500, 3)).astype(np.float32)))
    cloud.point["intensity"] = o3d.core.Tensor.from_numpy(rng.random((500, 1)).astype(np.float32))
    cloud.point["t"] = o3d.core.Tensor.from_numpy(rng.random((500, 1)))
    cloud.point["ring"] = o3d.core.Tensor.from_numpy(np.repeat(np.arange(50, dtype=np.uint8), 10)[:, None])
    cloud.point["normals"] = o3d.core.Tensor.from_numpy(rng.normal(size=(500, 3)).astype(np.float32))
    assert o3d.t.io.write_point_cloud(path, cloud, write_ascii=how == "ascii", compressed=how == "compressed")
    theirs = o3d.t.io.read_point_cloud(path).point
    found = read_point_cloud(path)
    for i, axis in enumerate("xyz"):
        assert np.array_equal(found[axis].astype(np.float32), theirs["positions"].numpy()[:, i])
    for name in ("intensity", "t", "ring"):
        kind = theirs[name].numpy().dtype
        assert np.array_equal(found[name].astype(kind), theirs[name].numpy()[:, 0])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("kind", "value"), [("f8", 1e300), ("f8", 1e10), ("u8", 2**64 - 1), ("i8", -(2**63)), ("i8", 2**62)]
)
def test_times_that_would_come_round_to_near_ones_are_refused(tmp_path: Path, kind: str, value: float) -> None:
    values = np.ones(2, dtype=[("x", "f4"), ("y", "f4"), ("z", "f4"), ("t", kind)])
    values["t"] = [0, value]
    path = tmp_path / "0.npy"
    np.save(path, values)
    for unit in ("s", "ns"):
        if (unit, value) != ("ns", 1e10):
            with refused(DatasetError, "0.npy", None, "1 s away"):
                stream(path, time="t", time_unit=unit).read(0)


def test_values_beyond_all_ranges_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "0.npy"
    np.save(path, np.array([[1e300, 1, 1, 0], [np.nan, 1, 1, 0], [1, 2, 2, 0], [np.inf, 0, 0, 0]]))
    assert stream(path).read(0).points.tolist() == [[1.0, 2.0, 2.0]]


def block(tmp_path: Path, compression: int = zipfile.ZIP_STORED, points: bytes | None = None) -> Path:
    path = tmp_path / "000000.npz"
    vectors = saved(np.zeros((5, 3), np.float32))
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr("points.npy", vectors if points is None else points)
        for name in ("normals", "origins"):
            archive.writestr(f"{name}.npy", vectors)
        archive.writestr("surface.npy", saved(np.zeros(5, np.uint8)))
        archive.writestr("steady.npy", saved(np.zeros(5, np.float32)))
        archive.writestr("lidar.npy", saved(np.zeros(5, np.uint8)))
    return path


def test_a_block_is_read(tmp_path: Path) -> None:
    assert read_block(block(tmp_path)).points.shape == (5, 3)


@pytest.mark.parametrize(
    ("compression", "points", "words"),
    [
        (zipfile.ZIP_STORED, npy_of("(1000000000000, 3)"), ("points", "3000000000000")),
        (zipfile.ZIP_STORED, saved(np.float32(1)), ("points", "float32")),
        (zipfile.ZIP_DEFLATED, npy_of("(900000, 3)", body=bytes(900_000 * 12)), ("points", "compressed")),
    ],
)
def test_a_block_that_is_packed_or_promises_too_much_is_refused(
    tmp_path: Path, compression: int, points: bytes, words: tuple[str, ...]
) -> None:
    with refused(DatasetError, "000000.npz", None, *words):
        read_block(block(tmp_path, compression, points))


def test_a_block_whose_directory_lies_is_refused(tmp_path: Path) -> None:
    data = bytearray(block(tmp_path).read_bytes())
    at = data.find(b"PK\x01\x02")
    data[at + 20 : at + 28] = struct.pack("<II", 2**31, 2**31)  # both sizes of the first entry
    with refused(DatasetError, "0.npz"):
        parse_npz(bytes(data), ["points"], Path("0.npz"))

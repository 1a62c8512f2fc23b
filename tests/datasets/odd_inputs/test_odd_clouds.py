"""Point clouds and other binary files that look right and are not: read as what they are, or refused with a reason."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pye57
import pytest
from odd_inputs import odd_input
from refusals import ErrorData, Notes, noted, refused

from baselines.published_weights import read_weights
from baselines.weights_file import read_tensors
from relocbench.arrays import Floats
from relocbench.datasets.core.images import read_image
from relocbench.datasets.importers.boreas import recording as boreas
from relocbench.datasets.importers.clouds.recording import read_clouds
from relocbench.datasets.importers.complex_urban import recording as complex_urban
from relocbench.datasets.importers.generic.scans import GenericLidar, GenericLidarStream
from relocbench.datasets.importers.helipr import recording as helipr
from relocbench.datasets.importers.kitti360 import recording as kitti360
from relocbench.datasets.importers.mulran import recording as mulran
from relocbench.datasets.importers.nclt import recording as nclt
from relocbench.datasets.importers.robotcar import velodyne
from relocbench.datasets.importers.rosbag.bag import parts_of
from relocbench.datasets.sensors.cloud_files import SUFFIXES, read_cloud
from relocbench.datasets.sensors.scan_files import Decoder, ScanFiles
from relocbench.datasets.sensors.velodyne import read_scan
from relocbench.errors import DatasetError, MethodError, RelocbenchError

LFS = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'4d' * 32}\nsize 132735\n"
OPENERS: dict[str, tuple[Callable[[Path], object], type[RelocbenchError]]] = {
    **{f"a{suffix}": (read_cloud, DatasetError) for suffix in SUFFIXES},
    "scan.bin": (read_scan, DatasetError),
    "image.png": (read_image, DatasetError),
    "drive.bag": (parts_of, DatasetError),
    "drive.mcap": (parts_of, DatasetError),
    "weights.safetensors": (read_tensors, MethodError),
    "weights.pth": (read_weights, MethodError),
}


@pytest.mark.parametrize("name", OPENERS)
def test_a_pointer_of_git_lfs_is_named_as_such_wherever_a_file_is_opened(tmp_path: Path, name: str) -> None:
    opener, kind = OPENERS[name]
    (tmp_path / name).write_text(LFS)
    with refused(kind, name, None, "LFS", "132735"):
        opener(tmp_path / name)


def las(points: int = 300, minor: int = 2, **fields: tuple[str, int, object]) -> bytes:
    """A LAS file of format 0 whose ``points`` are tenths of metres, with some fields of its header as given."""
    head = bytearray(375 if minor == 4 else 227)
    struct.pack_into("<4s20xBB", head, 0, b"LASF", 1, minor)
    struct.pack_into("<HIIBHI", head, 94, len(head), len(head), 0, 0, 20, points)
    struct.pack_into("<6d", head, 131, 0.1, 0.1, 0.1, 0.0, 0.0, 0.0)
    for form, at, value in fields.values():
        struct.pack_into(form, head, at, *(value if isinstance(value, tuple) else (value,)))
    rows = np.zeros((points, 20), np.uint8)
    rows[:, :12] = np.random.default_rng(1).integers(-200, 200, (points, 3)).astype("<i4").view(np.uint8)
    return bytes(head) + rows.tobytes()


def with_records(data: bytes, *records: tuple[int, bytes]) -> bytes:
    """The file with records of variable length that state its coordinate system."""
    body = b"".join(struct.pack("<2x16sHH32x", b"LASF_Projection", n, len(content)) + content for n, content in records)
    head = bytearray(data[:227])
    struct.pack_into("<II", head, 96, 227 + len(body), len(records))
    return bytes(head) + body + data[227:]


def geo_keys(**keys: int) -> bytes:
    codes = {"model": 1024, "projected": 3072, "unit": 3076, "vertical": 4099, "heights": 4096, "geographic": 2048}
    rows = [(codes[name], 0, 1, value) for name, value in keys.items()]
    return struct.pack(f"<{4 + 4 * len(rows)}H", 1, 1, 0, len(rows), *sum(rows, ()))


PROMISES: dict[str, tuple[bytes, ErrorData]] = {
    "a billion records": (las(count=("<I", 107, 10**9)), (10**9, 300)),
    "a billion records in 1.4": (las(minor=4, count=("<Q", 247, 10**12), old=("<I", 107, 0)), (10**12, 300)),
    "a billion records of variable length": (las(vlrs=("<I", 100, 10**9)), (10**9, 0)),
    "a billion extended ones": (las(minor=4, evlrs=("<QI", 235, (375, 10**9))), (10**9,)),
    "cut at a whole record": (las()[:-4000], (300, 100)),
    "points beyond the end": (las(offset=("<I", 96, 10**6)), (10**6,)),
    "records too short": (las(record=("<H", 105, 12)), (12,)),
    "more records than promised": (las(count=("<I", 107, 200)), (200, 100)),
    "none promised": (las(count=("<I", 107, 0)), (0, 300)),
    "two counts": (las(minor=4, count=("<Q", 247, 200)), (200, 300)),
    "no scale": (las(scale=("<d", 131, 0.0)), ()),
    "version 2.0": (las(version=("<BB", 24, (2, 0))), ("2.0",)),
}


@pytest.mark.parametrize("case", PROMISES)
def test_a_las_file_is_refused_for_what_its_header_promises_and_it_lacks(tmp_path: Path, case: str) -> None:
    data, names = PROMISES[case]
    (tmp_path / "a.las").write_bytes(data)
    with refused(DatasetError, "a.las", None, *names):
        read_cloud(tmp_path / "a.las")


@pytest.mark.parametrize(
    ("at", "form", "value", "names"),
    [
        ("count", "<I", 10**9, (10**9, 1)),
        ("table", "<q", 10**9, (10**9,)),
        ("chunks", "<I", 10**9, (10**9, 300)),
        ("end", "", 0, ("truncated",)),
    ],
)
def test_chunks_of_a_laz_file_are_checked(
    tmp_path: Path, at: str, form: str, value: int, names: tuple[object, ...]
) -> None:
    made = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
    made.x, made.y, made.z = np.random.default_rng(1).uniform(-9, 9, (3, 300))
    made.write(str(tmp_path / "a.laz"))
    assert len(read_cloud(tmp_path / "a.laz").points) == 300
    data = bytearray((tmp_path / "a.laz").read_bytes())
    begin = int.from_bytes(data[96:100], "little")
    table = int.from_bytes(data[begin : begin + 8], "little")
    if at == "end":
        data = data[: table + 2]
    else:
        struct.pack_into(form, data, {"count": 107, "table": begin, "chunks": table + 4}[at], value)
    (tmp_path / "a.laz").write_bytes(data)
    with refused(DatasetError, "a.laz", None, *names):
        read_cloud(tmp_path / "a.laz")


def test_the_odd_las_files_are_refused_at_once_with_the_true_reason() -> None:
    counts = odd_input("29_las_counts")
    for name, told in {
        "vlr_1e9": (1069128089,),
        "cut_at_record_100": (300, 100),
        "promises_90_million": (90000000, 300),
    }.items():
        with refused(DatasetError, f"{name}.las", None, *told):
            read_cloud(counts / f"{name}.las")
    assert len(read_cloud(counts / "full.las").points) == 300
    with refused(DatasetError, "saturated.las", None, 300, "y", "32-bit"):
        read_cloud(odd_input("28_las_saturated") / "saturated.las")
    with refused(DatasetError, "degrees.las", None, "degrees"):
        read_cloud(odd_input("28_las_saturated") / "degrees.las")


def test_a_few_points_at_the_limit_of_integers_are_left_out_with_their_number(tmp_path: Path) -> None:
    data = bytearray(las())
    struct.pack_into("<i", data, 227 + 20 * 7 + 4, -(2**31))
    (tmp_path / "a.las").write_bytes(data)
    found = read_cloud(tmp_path / "a.las")
    assert (len(found.points), noted(found.notes, "1 of 300", "y", "32-bit")) == (299, True)


GEOGRAPHIC = 'GEOGCS["g",DATUM["d",SPHEROID["s",6378137,298.25]],PRIMEM["p",0],UNIT["degree",0.0174532925]]'
PROJECTED = f'PROJCS["p",{GEOGRAPHIC},PROJECTION["Transverse_Mercator"],UNIT["%s",1]]'
WKT = f'COMPD_CS["x",{PROJECTED % "metre"},VERT_CS["v",VERT_DATUM["v",2005],UNIT["foot",0.3048]]]\0'


@pytest.mark.parametrize(
    ("records", "factors", "word"),
    [
        ([(34735, geo_keys(model=1, projected=2225, unit=9003))], [1200 / 3937] * 3, "US survey feet"),
        ([(34735, geo_keys(model=1, unit=9002, vertical=9001))], [0.3048, 0.3048, 1.0], "feet"),
        ([(34735, geo_keys(model=1, projected=32633, unit=9001))], [1.0, 1.0, 1.0], ""),
        ([(34735, geo_keys(model=1, projected=2225))], [1200 / 3937] * 3, "US survey feet"),
        ([(34735, geo_keys(model=1, projected=32633, heights=6360))], [1.0, 1.0, 1200 / 3937], "US survey feet"),
        ([(34735, geo_keys(model=1, projected=32767))], [1.0, 1.0, 1.0], "not stated"),
        ([(2112, WKT.encode())], [1.0, 1.0, 0.3048], "z feet"),
        ([(2112, (PROJECTED % "US survey foot").encode())], [1200 / 3937] * 3, "US survey feet"),
        ([(2112, b'PROJCS["of nowhere"')], [1.0, 1.0, 1.0], "of nowhere"),
    ],
)
def test_feet_become_metres_and_are_reported(
    tmp_path: Path, records: list[tuple[int, bytes]], factors: list[float], word: str
) -> None:
    (tmp_path / "metres.las").write_bytes(las())
    (tmp_path / "a.las").write_bytes(with_records(las(), *records))
    found = read_cloud(tmp_path / "a.las")
    np.testing.assert_allclose(found.points, read_cloud(tmp_path / "metres.las").points * factors)
    assert noted(found.notes, word) if word else found.notes == ()


@pytest.mark.parametrize(
    "record",
    [(34735, geo_keys(model=2, geographic=4326)), (2112, GEOGRAPHIC.encode())],
)
def test_degrees_are_refused(tmp_path: Path, record: tuple[int, bytes]) -> None:
    (tmp_path / "a.las").write_bytes(with_records(las(), record))
    with refused(DatasetError, "a.las", None, "degrees"):
        read_cloud(tmp_path / "a.las")


def test_coordinates_of_a_map_in_single_precision_are_read_with_a_note_of_their_steps(tmp_path: Path) -> None:
    points = np.random.default_rng(1).uniform(-30, 30, (500, 3)) + np.array([691_234, 5_334_987, 512])
    np.save(tmp_path / "single.npy", points.astype(np.float32))
    np.save(tmp_path / "cast.npy", points.astype(np.float32).astype(np.float64))
    np.save(tmp_path / "double.npy", points)
    np.save(tmp_path / "rounded.npy", np.round(points))
    for name, told in {"single": True, "cast": True, "double": False, "rounded": False}.items():
        notes = read_cloud(tmp_path / f"{name}.npy").notes
        assert noted(notes, "float32", "50 cm", "6.25 cm") == told, name


def test_longitude_and_latitude_are_refused_in_files_that_state_no_unit(tmp_path: Path) -> None:
    points = np.random.default_rng(1).uniform(-1, 1, (500, 3)) * [1e-3, 1e-3, 10] + np.array([11.57, 48.14, 520])
    np.save(tmp_path / "a.npy", points)
    with refused(DatasetError, "a.npy", None, "degrees"):
        read_cloud(tmp_path / "a.npy")
    np.save(tmp_path / "pole.npy", points * [200, 200, 1])  # a lamp post
    assert len(read_cloud(tmp_path / "pole.npy").points) == 500


ROWS = [[1.5, 2.25, 3.0], [4.0, 5.0, 6.0]]
TEXTS: dict[str, tuple[str, ErrorData | list[list[float]]]] = {
    "a header with an id first": ("id,x,y,z\n7,1.5,2.25,3\n8,4,5,6\n", ROWS),
    "a header in another order": ("y,x,z\n2.25,1.5,3\n5,4,6\n", ROWS),
    "CloudCompare": ("//X Y Z R G B\n2\n1.5 2.25 3 9 9 9\n4 5 6 9 9 9\n", ROWS),
    "capitals": ("X Y Z R G B\n1.5 2.25 3 9 9 9\n4 5 6 9 9 9\n", ROWS),
    "an index without a name": (",x,y,z\n0,1.5,2.25,3\n1,4,5,6\n", ROWS),
    "ParaView": ('"i","Points:0","Points:1","Points:2"\n0,1.5,2.25,3\n1,4,5,6\n', ROWS),
    "units": ("x[m]; y[m]; z[m]\n1.5;2.25;3\n4;5;6\n", ROWS),
    "a title": ("scanned on a Friday\n1.5 2.25 3 9\n4 5 6 9\n", ROWS),
    "two blocks of .pts": ("1\n1.5 2.25 3\n1\n4 5 6\n", ROWS),
    "a sentence with x y z": ("# columns are x y z\n1.5 2.25 3\n4 5 6\n", ROWS),
    "decimal commas": ("1,5 2,25 3,0\n", (1, "1,5 2,25 3,0")),
    "decimal commas between semicolons": ("x;y;z\n1,5;2,25;3\n", (2, "1,5;2,25;3")),
    "decimal commas between commas": ("x,y,z\n1,5,2,25,3,0\n", (2, 6, 3)),
    "longitude and latitude": ("lon,lat,height\n11.5,48.1,500\n", (1, "lon lat")),
    "millimetres": ("x_mm,y_mm,z_mm\n1,2,3\n", (1, "mm")),
    "a header without x": ("id,intensity,range\n1,2,3\n", (1, "id intensity range")),
    "fewer points than promised": ("3\n1 2 3\n4 5 6\n", (1, 3, 2)),
    "more points than promised": ("1\n1 2 3\n4 5 6\n", (1, 1, 2)),
    "an index and no header": ("".join(f"{k} 1.5 2.25 3\n" for k in range(30)), (None, "0")),
    "a word": ("1 2 3\n1 two 3\n", (2, "1 two 3")),
    "a word in the first line": ("1_0 2 3\n1 2 3\n", (1, "1_0 2 3")),
}  # fmt: skip


@pytest.mark.parametrize("case", TEXTS)
def test_columns_of_a_text_are_those_of_its_header(tmp_path: Path, case: str) -> None:
    text, expected = TEXTS[case]
    (tmp_path / "a.csv").write_text(text)
    if isinstance(expected, list):
        np.testing.assert_array_equal(read_cloud(tmp_path / "a.csv").points, expected)
        return
    with refused(DatasetError, "a.csv", expected[0], *expected[1:]):
        read_cloud(tmp_path / "a.csv")


HEADS = {
    "pcd": "VERSION .7\nFIELDS X Y Z\nSIZE 4 4 4\nTYPE f f f\nCOUNT 1 1 1\n"
    "WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {kind}\n",
    "ply": "ply\nformat {kind} 1.0\nelement vertex {n}\n"
    "property float X\nproperty float Y\nproperty float Z\nend_header\n",
}  # fmt: skip
KINDS = [("pcd", "ascii"), ("pcd", "binary"), ("ply", "ascii"), ("ply", "binary_little_endian")]


@pytest.mark.parametrize(("suffix", "kind"), KINDS)
@pytest.mark.parametrize("promised", [0, 30, 40, 41])
def test_as_many_points_as_the_header_promises(tmp_path: Path, suffix: str, kind: str, promised: int) -> None:
    points = np.random.default_rng(1).uniform(-9, 9, (40, 3)).astype("<f4")
    lines = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.astype(float).tolist())
    body = lines.encode() if kind == "ascii" else points.tobytes()
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(HEADS[suffix].format(n=promised, kind=kind).encode() + body)
    if promised == 40:
        np.testing.assert_array_equal(read_cloud(path).points, points)
        path.write_bytes(path.read_bytes() + bytes(4096) * (kind != "ascii"))  # a padded page is no point
        assert len(read_cloud(path).points) == 40
        return
    with refused(DatasetError, path.name, None, promised, 40 if promised > 40 else 40 - promised):
        read_cloud(path)


def test_width_and_height_of_a_pcd_are_its_number_of_points(tmp_path: Path) -> None:
    head = HEADS["pcd"].format(n=2, kind="ascii")
    (tmp_path / "a.pcd").write_text(head.replace("HEIGHT 1", "HEIGHT 2") + "1 2 3\n4 5 6\n")
    with refused(DatasetError, "a.pcd", None, "2 x 2", 2):
        read_cloud(tmp_path / "a.pcd")


def test_text_keeps_its_digits_whatever_the_header_says_and_may_have_commas_between_numbers(tmp_path: Path) -> None:
    head = HEADS["pcd"].format(n=1, kind="ascii")
    for between in " ", "\t", ",":
        (tmp_path / "a.pcd").write_text(head + f"{between.join(['289814.15', '4320978.61', '170.76'])}\n")
        found = read_cloud(tmp_path / "a.pcd")
        np.testing.assert_allclose(found.points + found.origin, [[289814.15, 4320978.61, 170.76]], atol=1e-9)
    (tmp_path / "a.pcd").write_text(head + "1,5 2,5 3,5\n")
    with refused(DatasetError, "a.pcd", 10, "1,5 2,5 3,5"):
        read_cloud(tmp_path / "a.pcd")


def test_the_odd_pcd_and_text_files_are_read_as_what_they_are() -> None:
    folder = odd_input("27_pcd_refusals_and_text_columns")
    rows = np.loadtxt(folder / "id_first.csv", delimiter=",", skiprows=1)[:, 1:4]
    np.testing.assert_array_equal(read_cloud(folder / "id_first.csv").points, rows)
    for name in ("lower_types.pcd", "upper_fields.pcd"):
        rows = np.loadtxt((folder / name).read_text().splitlines()[9:])[:, :3]
        np.testing.assert_array_equal(read_cloud(folder / name).points, rows)
    with refused(DatasetError, "decimal_comma.xyz", 1, "-2,684 -1,019 8,536"):
        read_cloud(folder / "decimal_comma.xyz")


@pytest.mark.parametrize(
    ("damage", "names"),
    [
        (lambda d: d[: len(d) // 2048 * 1024], ("truncated",)),
        (lambda d: d + bytes(1024), ("promises",)),
        (lambda d: d[:24] + struct.pack("<Q", 10**12) + d[32:], (10**12,)),
        (lambda d: d[:40] + struct.pack("<Q", 1000) + d[48:], (1000,)),
        (lambda d: d.replace(b'recordCount="900"', b'recordCount="9e9"'), ("9e9",)),
        (lambda d: d.replace(b'recordCount="900"', b'recordCount="999"'), (999, 96)),
        (lambda d: d.replace(b'fileOffset="48"', b'fileOffset="99"'), (99,)),
    ],
)
def test_an_e57_file_holds_what_it_promises(
    tmp_path: Path, damage: Callable[[bytes], bytes], names: tuple[object, ...]
) -> None:
    path = tmp_path / "a.e57"
    with pye57.E57(str(path), mode="w") as file:
        file.write_scan_raw({f"cartesian{axis}": np.random.default_rng(1).uniform(-9, 9, 900) for axis in "XYZ"})
    assert len(read_cloud(path).points) == 900
    path.write_bytes(damage(path.read_bytes()))
    with refused(DatasetError, "a.e57", None, *names):
        read_cloud(path)


def scan(columns: int, count: int = 960) -> Floats:
    """Points of a turn (N, columns): x, y, z, intensity, beam, seconds."""
    angle = np.linspace(0, 2 * np.pi, count)
    far = 9 + 3 * np.sin(3 * angle)
    beam = np.arange(count) % 16
    table = [far * np.cos(angle), far * np.sin(angle), 0.1 * beam - 1, 0.3 + 0 * angle, beam, angle / 63]
    return np.column_stack(table).astype("<f4")[:, :columns]


DECODERS: dict[str, tuple[Decoder, int]] = {
    "boreas": (boreas.decode, 6),
    "complex-urban": (complex_urban.decode_vlp, 4),
    "kitti-360": (kitti360.decode, 4),
    "mulran": (mulran.ColumnsInOrder("start"), 4),
}


@pytest.mark.parametrize("name", DECODERS)
@pytest.mark.parametrize("columns", [3, 4, 5, 6])
def test_points_of_another_length_are_named_though_the_size_fits(tmp_path: Path, name: str, columns: int) -> None:
    decode, expected = DECODERS[name]
    path = tmp_path / "1.bin"
    if columns == expected:
        assert len(decode(scan(columns).tobytes(), path).points) == 960
        return
    for count in (960, 959):  # the size fits or not
        with refused(DatasetError, "1.bin", None, 4 * expected, 4 * columns, count):
            decode(scan(columns, count).tobytes(), path)


def test_a_point_of_an_ouster_without_reflectivity_is_named(tmp_path: Path) -> None:
    row = helipr.RECORDS["Ouster"]
    for kept in (row.names, [name for name in row.names or () if name != "reflectivity"]):
        older = np.dtype([(name, row[name]) for name in kept or ()])
        table = np.frombuffer(np.random.default_rng(1).bytes(960 * older.itemsize), older).copy()
        for axis, values in zip("xyz", scan(3).T, strict=True):
            table[axis] = values
        if older == row:
            assert len(helipr.HeLiPRPoints("Ouster")(table.tobytes(), tmp_path / "1.bin").points) == 960
        else:
            with refused(DatasetError, "1.bin", None, row.itemsize, older.itemsize, 960):
                helipr.HeLiPRPoints("Ouster")(table.tobytes(), tmp_path / "1.bin")


EMPTY: dict[str, tuple[Decoder, bytes]] = {
    **{name: (decode, np.full((64, n), np.nan, "<f4").tobytes()) for name, (decode, n) in DECODERS.items()},
    "complex-urban, SICK": (complex_urban.decode_sick, np.full((64, 2), np.nan, "<f4").tobytes()),
    "robotcar": (velodyne.decode_binary, np.full((4, 64), np.nan, "<f4").tobytes()),
    "nclt": (nclt.decode, np.zeros(64, nclt.RECORD).tobytes()),
    "helipr": (helipr.HeLiPRPoints("Ouster"), np.full(64 * 26, 0xFF, np.uint8).tobytes()),
}  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", EMPTY)
def test_a_scan_without_returns_has_no_points_and_an_empty_file_is_named(tmp_path: Path, name: str) -> None:
    decode, data = EMPTY[name]
    path = tmp_path / "1691936557946849.bin"
    lidar = ScanFiles("top", (path,), np.array([10**18]), np.eye(4), decode, 80.0, 0.02, min_range_m=1.0)
    path.write_bytes(data)
    assert len(lidar.read(0).points) == 0
    path.write_bytes(b"")
    with refused(DatasetError, path.name, None, "top"):
        lidar.read(0)


def write_as(path: Path, points: Floats) -> None:
    if path.suffix == ".las":
        made = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
        made.header.scales = np.full(3, 1e-4)
        made.x, made.y, made.z = points.T.astype(np.float64)
        made.write(str(path))
    elif path.suffix == ".e57":
        with pye57.E57(str(path), mode="w") as file:
            file.write_scan_raw({f"cartesian{a}": points[:, k].astype(float) for k, a in enumerate("XYZ")})
    else:
        rows = [f"{number},{x},{y},{z},{number * 1e-4}" for number, (x, y, z) in enumerate(points.tolist())]
        path.write_text("\n".join(["id,x,y,z,time", *rows]) + "\n")


@pytest.mark.parametrize("suffix", [".csv", ".xyz", ".las", ".e57"])
def test_a_folder_of_clouds_may_be_of_any_kind_that_a_cloud_alone_may_be(tmp_path: Path, suffix: str) -> None:
    for number in range(3):
        write_as(tmp_path / f"170000000{number}.5{suffix}", scan(3))
    (tmp_path / "poses.txt").write_text("".join(f"170000000{k}.5 {k} 0 0 0 0 0 1\n" for k in range(3)))
    notes = Notes()
    lidar = read_clouds(tmp_path, "drive", notes).lidars[0]
    found = lidar.read(1)
    np.testing.assert_allclose(found.points, scan(3), atol=1e-4)
    assert (np.ptp(found.times_ns) > 0) == (suffix in (".csv", ".xyz"))  # whose header names times of points
    assert noted(notes.notes, suffix[1:])


def test_clouds_in_millimetres_or_coordinates_of_a_map_are_named_as_such(tmp_path: Path) -> None:
    for word, points in {
        "millimetres": 1000 * scan(3),
        "map": scan(3) + np.array([691_234, 5_334_987, 0], np.float32),
    }.items():
        for number in range(3):
            np.save(tmp_path / f"170000000{number}.5.npy", points)
        with refused(DatasetError, "1700000001.5.npy", None, word):
            read_clouds(tmp_path, "drive", Notes()).lidars[0].read(1)


NAMES = {".ply": "binary_little_endian", ".pcd": "binary"}


@pytest.mark.parametrize("suffix", [".las", ".ply", ".pcd", ".npy", ".xyz"])
def test_a_cloud_without_points_is_named_and_a_scan_without_points_is_one(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".las":
        path.write_bytes(las(0))
    elif suffix == ".npy":
        np.save(path, np.empty((0, 4)))
    else:
        path.write_text(HEADS[suffix[1:]].format(n=0, kind=NAMES[suffix]) if suffix in NAMES else "# x y z\n")
    with refused(DatasetError, path.name, None, 0):
        read_cloud(path)
    settings = GenericLidar(pattern="spinning")
    lidar = GenericLidarStream("top", settings, np.eye(4), (path,), np.array([10**18]))
    assert len(lidar.read(0).points) == 0

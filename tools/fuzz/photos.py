"""Importers of photo collections: kapture folders, models of COLMAP."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from fuzz.asking import asks, write
from fuzz.parser import Parser, Place, Read
from relocbench.arrays import Image

_UNIT = "1, 0, 0, 0"


def write_kapture(root: Path) -> None:
    """A map of two images of a rig with a depth map and points, and a query."""
    for part, times in (("mapping", (1, 2)), ("query", (3,))):
        sensors, reconstruction = root / "town" / part / "sensors", root / "town" / part / "reconstruction"
        write(
            sensors / "sensors.txt",
            "# kapture format: 1.1",
            "# sensor_id, name, sensor_type, [sensor_params]+",
            "left, , camera, PINHOLE, 32, 24, 20, 20, 16, 12",
            "left_depth, , depth, PINHOLE, 32, 24, 20, 20, 16, 12",
            "wifi, , wifi",
        )
        write(
            sensors / "rigs.txt",
            f"car, mast, {_UNIT}, 0, 0, 0.5",
            f"mast, left, {_UNIT}, 0.25, 0, 0",
            f"mast, left_depth, {_UNIT}, 0.25, 0, 0",
        )
        write(sensors / "trajectories.txt", *(f"{time}, car, {_UNIT}, 0, 0, {-0.25 * time}" for time in times))
        write(sensors / "records_camera.txt", *(f"{time}, left, {part}/{time}.png" for time in times))
        if part == "mapping":
            write(sensors / "records_depth.txt", "1, left_depth, mapping/1.depth")
            write(reconstruction / "points3d.txt", *(f"{x}, {x / 2}, 4.5, 1, 2, 3" for x in (-1, 0, 1)))
            seen = "mapping/1.png, {0}, mapping/2.png, {0}"
            write(reconstruction / "observations.txt", *(f"{row}, sift, {seen.format(row)}" for row in range(3)))
        pictures = sensors / "records_data" / part
        pictures.mkdir(parents=True)
        for time in times:
            assert cv2.imwrite(str(pictures / f"{time}.png"), _noise(time))
            np.full((24, 32), 4.0, "<f4").tofile(pictures / f"{time}.depth")


def _noise(seed: int) -> Image:
    """An image (24, 32)."""
    return np.random.default_rng(seed).integers(0, 255, (24, 32), dtype=np.uint8)


def write_colmap(root: Path) -> None:
    """A model of two images, as text and binary, their depth images, and a listed query with its pose."""
    names = ("map/1.png", "map/2.png")
    cameras = ((1, "PINHOLE", 1, (20.0, 20.0, 16.0, 12.0)), (2, "SIMPLE_RADIAL", 2, (20.0, 16.0, 12.0, 0.01)))
    points = tuple((number, (number - 2.0, 0.25 * number, 4.5)) for number in (1, 2, 3))
    seen = tuple((16.0 + number, 12.5, number) for number in (1, 2, 3))
    words = {
        "cameras": [f"{number} {model} 32 24 {_joined(lens)}" for number, model, _, lens in cameras],
        "images": [
            line
            for number, name in enumerate(names, start=1)
            for line in (f"{number} 1 0 0 0 {0.25 * number} 0 0 {number} {name}", f"{_joined(*seen)} 3 4 -1")
        ],
        "points3D": [f"{number} {_joined(at)} 1 2 3 0.5 1 {number - 1} 2 {number - 1}" for number, at in points],
    }
    for name, lines in words.items():
        write(root / "text" / f"{name}.txt", "# made up", *lines)
        write(root / "project" / "sparse" / "0" / f"{name}.txt", *(line.replace(" ", ", ") for line in lines))
    track = b"".join(struct.pack("<ii", image, 0) for image in (1, 2))
    records = {
        "cameras": [struct.pack("<iiQQ4d", number, kind, 32, 24, *lens) for number, _, kind, lens in cameras],
        "images": [
            struct.pack("<i7di", number, 1, 0, 0, 0, 0.25 * number, 0, 0, number)
            + name.encode()
            + struct.pack("<BQ", 0, len(seen))
            + b"".join(struct.pack("<ddq", *keypoint) for keypoint in seen)
            for number, name in enumerate(names, start=1)
        ],
        "points3D": [struct.pack("<Q3d3BdQ", number, *at, 1, 2, 3, 0.5, 2) + track for number, at in points],
    }
    (root / "binary").mkdir()
    for name, parts in records.items():
        (root / "binary" / f"{name}.bin").write_bytes(struct.pack("<Q", len(parts)) + b"".join(parts))
    for seed, name in enumerate((*names, "night/3.png")):
        picture, depth = root / "images" / name, root / "depth" / name
        picture.parent.mkdir(parents=True, exist_ok=True)
        depth.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(picture), _noise(seed))
        assert cv2.imwrite(str(depth), np.full((24, 32), 4500, np.uint16))
    write(root / "lists" / "queries.txt", "# made up", "night/3.png PINHOLE 32 24 20 20 16 12")
    write(root / "lists" / "poses.txt", "night/3.png 1 0 0 0 0.5 0 0")
    write(root / "lists" / "pairs.txt", "night/3.png map/1.png", "night/3.png map/2.png")


def _joined(*numbers: tuple[float, ...]) -> str:
    return " ".join(str(number) for several in numbers for number in several)


def _kapture(place: Place) -> None:
    from relocbench.datasets.importers.kapture.folder import read_folder
    from relocbench.datasets.importers.photos.points import Observations, keyframe_points

    folder = read_folder(place.root / "town" / "mapping")
    seen = Observations.of(folder.model)
    pinholes = {number: camera.pinhole() for number, camera in folder.model.cameras.items()}
    for number, record in enumerate(folder.images):
        folder.camera(record.device)
        folder.depth_of(record)
        if number in folder.model.images:
            keyframe_points(folder.model, seen, pinholes, number, 1, 0.5, 1.0)


def _colmap(kind: str) -> Read:
    def run(place: Place) -> None:
        from relocbench.datasets.importers.colmap.model import read_model
        from relocbench.datasets.importers.colmap.project import model_folder
        from relocbench.datasets.importers.photos.points import Observations, keyframe_points

        model = read_model(model_folder(place.root / kind))
        seen = Observations.of(model)
        pinholes = {number: camera.pinhole() for number, camera in model.cameras.items()}
        for number in model.images:
            keyframe_points(model, seen, pinholes, number, 1, 0.5, 1.0)

    return run


def _colmap_list(name: str) -> Read:
    def run(place: Place) -> None:
        from relocbench.datasets.core.named_poses import read_named_poses
        from relocbench.datasets.importers.colmap.dataset import listed_cameras
        from relocbench.datasets.importers.photos.lists import listed_pairs

        readers: dict[str, Callable[[Path], object]] = {
            "queries": listed_cameras,
            "poses": read_named_poses,
            "pairs": lambda path: list(listed_pairs(path)),
        }
        readers[name](place.target)

    return run


def _depth_map(place: Place) -> None:
    from relocbench.datasets.importers.kapture.depth import read_depth_map, seen_by
    from relocbench.geometry import Camera

    camera = Camera("pinhole", 32, 24, 20.0, 20.0, 15.5, 11.5)
    seen_by(read_depth_map(place.target, camera.size), camera, camera.scaled(0.5))


_BUILD = ("--out", "{out}/ds", "-j", 1, "-q", "--correspondences", 5)
_LISTS = ("--query-list", "{root}/lists/queries.txt", "--query-poses", "{root}/lists/poses.txt")
SEEDS = {"kapture": write_kapture, "colmap": write_colmap}
PARSERS = (
    Parser("kapture-tables", "kapture", ("town/mapping/**/*.txt",), _kapture, text=True),
    Parser("kapture-depth", "kapture", ("town/mapping/**/1.depth",), _depth_map),
    Parser(
        "kapture-command",
        "kapture",
        ("town/**/*",),
        asks("build-dataset", "kapture", "{root}/town", *_BUILD),
        names=True,
        brief=False,
    ),
    Parser("colmap-text", "colmap", ("text/*.txt",), _colmap("text"), text=True),
    Parser("colmap-commas", "colmap", ("project/sparse/0/*.txt",), _colmap("project"), text=True),
    Parser("colmap-binary", "colmap", ("binary/*.bin",), _colmap("binary")),
    *(
        Parser(f"colmap-{name}", "colmap", (f"lists/{name}.txt",), _colmap_list(name), text=True)
        for name in ("queries", "poses", "pairs")
    ),
    Parser(
        "colmap-command",
        "colmap",
        ("text/*", "images/*/*"),
        asks("build-dataset", "colmap", "{root}/text", "--pair-step", 1, *_BUILD),
        names=True,
        brief=False,
    ),
    Parser(
        "colmap-binary-command",
        "colmap",
        ("binary/*",),
        asks("build-dataset", "colmap", "{root}/binary", "--queries", "map/2*", "--min-track", 1, *_BUILD),
        names=True,
        brief=False,
    ),
    Parser(
        "colmap-lists",
        "colmap",
        ("lists/*", "depth/*/*", "images/night/*"),
        asks(
            *("build-dataset", "colmap", "{root}/text", "--depth", "{root}/depth", *_LISTS),
            *("--pairs", "{root}/lists/pairs.txt", *_BUILD),
        ),
        names=True,
        brief=False,
    ),
)

"""Importers of photo collections: kapture folders."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fuzz.asking import asks, write
from fuzz.parser import Parser, Place

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
            noise = np.random.default_rng(time).integers(0, 255, (24, 32), dtype=np.uint8)
            assert cv2.imwrite(str(pictures / f"{time}.png"), noise)
            np.full((24, 32), 4.0, "<f4").tofile(pictures / f"{time}.depth")


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


def _depth_map(place: Place) -> None:
    from relocbench.datasets.importers.kapture.depth import read_depth_map, seen_by
    from relocbench.geometry import Camera

    camera = Camera("pinhole", 32, 24, 20.0, 20.0, 15.5, 11.5)
    seen_by(read_depth_map(place.target, camera.size), camera, camera.scaled(0.5))


SEEDS = {"kapture": write_kapture}
PARSERS = (
    Parser("kapture-tables", "kapture", ("town/mapping/**/*.txt",), _kapture, text=True),
    Parser("kapture-depth", "kapture", ("town/mapping/**/1.depth",), _depth_map),
    Parser(
        "kapture-command",
        "kapture",
        ("town/**/*",),
        asks("build-dataset", "kapture", "{root}/town", "--out", "{out}/ds", "-j", 1, "-q", "--correspondences", 5),
        names=True,
        brief=False,
    ),
)

"""The photographs and rendered frames that ``realism.py`` compares: square colour pictures of streets, in groups.

A group is what must not be split between training and test: the photographs of one camera or source, the frames of one
town.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from relocbench.arrays import Array, Image
from relocbench.datasets.core.images import as_grey, as_rgb, is_whole, read_image, write_image
from relocbench.datasets.synthetic.camera.shot import Shot, camera_twists
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.conditions.imaging import draw_imaging
from relocbench.datasets.synthetic.conditions.presets import SPLITS
from relocbench.datasets.synthetic.drives.drive import MARGIN_M, RATE_HZ, Drive, DriveStyle
from relocbench.datasets.synthetic.drives.passers import all_that_moves
from relocbench.datasets.synthetic.drives.rig import Mount
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.errors import DatasetError
from relocbench.geometry import Camera

Groups = dict[str, list[Image]]
"""name -> pictures (SIZE, SIZE, 3)"""

SIZE = 256
"""pixels along each side of a picture"""
MOST = 40
"""pictures of a photographic set; of larger ones, evenly spaced files are taken"""
IMAGINGS = ("ideal", "varied")

_PANORAMAS = "photographs_train/polyhaven_cubemaps"
_STREETS = (
    *("blaubeuren_church_square", "cambridge", "canary_wharf", "hansaplatz", "neuer_zollhof", "outdoor_umbrellas"),
    *("palermo_sidewalk", "palermo_square", "portland_landing_pad", "potsdamer_platz", "quattro_canti", "rathaus"),
    *("schadowplatz", "stone_alley", "tears_of_steel_bridge", "ulmer_muenster", "urban_alley_01"),
    *("venetian_crossroads", "vignaioli_night", "zwinger_night"),
)
"""panoramas of streets and squares; others show woods, water, fields and rooms"""
_COLOUR: dict[str, tuple[str, ...]] = {
    "city streets": ("street_photographs/*.jpg",),
    "motorways": ("photographs_train/udacity_driving/*.jpg",),
    "panoramas": (
        "photographs_train/polyhaven_street_views/wide_street_01_*.jpg",
        *(f"{_PANORAMAS}/{place}_{face}.jpg" for place in _STREETS for face in ("posx", "negz")),
    ),
    "campus, seasons": ("grief_michigan/images/*02.jpg", "grief_michigan/images/*05.jpg"),
    "motorway in fog": ("radiate_fog/zed_left/*",),
}
_GREY: dict[str, tuple[str, ...]] = {"suburb, grey": ("kitti_odometry/sequences/*/image_0/*.png",)}
"""patterns of files in the folder of recordings. Left out are gardens_point (footpaths, rooms), tilde_webcam (seen from
towers) and fourseasons_sample (no images)"""

_DAY = ("Sunny", "Neutral", "Overcast")
_OTHER = ("Rain", "Snow", "Night", "Fog", "WetNoon")
_FRAMES = {"day": 6, "other": 2}
"""of each of a town's two conditions of a kind: three quarters by day, as among the photographs"""
_EXTENT_M = 250.0
_ROUTE_M = 300.0
_DRIVEN_M = _ROUTE_M - 2 * MARGIN_M
_RENDERED = 512
"""pixels along each side of a rendered frame before it is scaled down"""
_VIEW_DEG = (30.0, 75.0)
"""field of view of a square, drawn for each frame: that of a square cut from KITTI's images to that of a rig"""
_TURNED = 4
"""every fourth frame looks into a drawn direction, as panoramas do, and the others along the street"""


def photographs(data: Path, *, grey: bool) -> Groups:
    """The photographs below a folder of recordings, by set; grey ones are added with ``grey``.

    Raises:
        DatasetError: the folder, or the images of a set, are missing.
    """
    if not data.is_dir():
        raise DatasetError("no such folder; expected the folder of recordings (see --data)", data)
    found = {}
    for name, patterns in (_COLOUR | (_GREY if grey else {})).items():
        files = sorted(path for pattern in patterns for path in data.glob(pattern))
        if not files:
            raise DatasetError(f"no images of the set '{name}', expected {patterns[0]}", data)
        chosen = np.unique(np.linspace(0, len(files) - 1, min(MOST, len(files))).round().astype(int))
        found[name] = [square(as_rgb(read_image(files[k]))) for k in chosen]
    return found


def square(image: Image) -> Image:
    """The central square of an image (H, W, 3), scaled to (SIZE, SIZE, 3) by averaging over areas."""
    height, width = image.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    inner = np.ascontiguousarray(image[top : top + side, left : left + side])
    return np.asarray(cv2.resize(inner, (SIZE, SIZE), interpolation=cv2.INTER_AREA))


def without_colour(groups: Groups) -> Groups:
    """The same pictures in grey."""
    return {name: [as_rgb(as_grey(picture)) for picture in pictures] for name, pictures in groups.items()}


@dataclass(frozen=True)
class Town:
    """A district of the training or validation split, and the conditions in which it is seen."""

    seed: int
    split: str
    number: int
    """in the order of towns, by which conditions take turns"""

    @property
    def name(self) -> str:
        return f"{self.split} {self.seed}"

    @property
    def conditions(self) -> dict[str, int]:
        """Number of frames by condition."""
        k = self.number
        day = {_DAY[(k + i) % len(_DAY)]: _FRAMES["day"] for i in (0, 1)}
        return day | {_OTHER[(k + i) % len(_OTHER)]: _FRAMES["other"] for i in (0, 2)}

    def frames(self, folder: Path, *, render: bool = True) -> dict[str, list[Image]]:
        """The pictures by the imaging of their camera; frames that the folder lacks are rendered into it.

        Raises:
            DatasetError: frames are missing and shall not be rendered.
        """
        found: dict[str, list[Image]] = {imaging: [] for imaging in IMAGINGS}
        for c, (name, count) in enumerate(self.conditions.items()):
            own = folder / self.name.replace(" ", "-")
            files = {i: [own / f"{name}-{k}-{i}.png" for k in range(count)] for i in IMAGINGS}
            missing = [path for paths in files.values() for path in paths if not is_whole(path)]
            if missing and not render:
                raise DatasetError("no such frame; expected those of an earlier run with the same --seeds", missing[0])
            if missing:
                self._render(name, c, files)
            for imaging, paths in files.items():
                found[imaging] += [square(read_image(path)) for path in paths]
        return found

    def _render(self, name: str, c: int, files: dict[str, list[Path]]) -> None:
        """Render all frames of a condition, by the ideal camera and by one that is drawn for this drive."""
        place, factors = DistrictSpec(self.seed, self.split, _EXTENT_M), condition_named(name).factors
        rng = np.random.default_rng([self.seed, SPLITS.index(self.split), c])
        imaging = draw_imaging(rng, dark=factors.dark)
        route = scenes.district(place).network.drive(_ROUTE_M, self.seed)
        step_m = DriveStyle().speed_mps / RATE_HZ
        count = len(files["ideal"])
        for k in range(count):
            along = MARGIN_M + _DRIVEN_M * (k + (c + 1) / 5) / count
            camera, T_rig_cam = _view(rng, turned=k % _TURNED == _TURNED - 1)
            T_world_rig: Array = np.array([route.pose(along + n * step_m) for n in (-1, 0, 1)])
            T_world_cam: Array = T_world_rig @ T_rig_cam
            passing = np.random.default_rng([self.seed, SPLITS.index(self.split), c, k])
            moment = Drive(np.array([along]), T_world_rig[1:2])
            moving = all_that_moves(scenes.district(place).footpaths, route, moment, factors, passing)[0]
            renderer = scenes.renderer(place, factors, moving)
            shot = Shot(
                imaging, (along - MARGIN_M) / DriveStyle().speed_mps, camera_twists(T_world_cam, 1 / RATE_HZ)[1]
            )
            seed = scenes.frame_seed(self.seed, c, k, 0)
            for kind, by in (("ideal", None), ("varied", shot)):
                write_image(files[kind][k], renderer.render(camera, T_world_cam[1], seed, shot=by).rgb)


def _view(rng: np.random.Generator, *, turned: bool) -> tuple[Camera, Array]:
    """A square camera with a drawn field of view, and ``T_rig_cam`` (4, 4) of its mount on the car."""
    half = np.radians(rng.uniform(*_VIEW_DEG)) / 2
    yaw = rng.uniform(-180, 180)
    focal, centre = _RENDERED / 2 / np.tan(half), (_RENDERED - 1) / 2
    camera = Camera("pinhole", _RENDERED, _RENDERED, focal, focal, centre, centre)
    return camera, Mount(0.9, 0.0, 1.5, yaw_deg=yaw if turned else 0.0).T_rig_cam


def towns(seeds: list[int]) -> list[Town]:
    """The districts of some seeds in the splits for training and validation."""
    asked = [(seed, split) for seed in seeds for split in SPLITS if split != "test"]
    return [Town(seed, split, number) for number, (seed, split) in enumerate(asked)]

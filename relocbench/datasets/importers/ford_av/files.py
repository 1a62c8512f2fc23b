"""Where the parts of a log lie: its bag, its folders of images, and the calibration of its vehicle.

Logs are published as ``DATE-VEHICLE-LOG.bag`` and ``DATE-VEHICLE-LOG-CAMERA`` folders, users keep them in
``DATE/VEHICLE/LOG``, and the calibration of a vehicle is in ``Calibration-VEHICLE``, or in a folder within it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from relocbench.datasets.importers.rosbag.bag import SUFFIXES
from relocbench.datasets.sensors.trajectories import traversal_names
from relocbench.errors import ConfigError, DatasetError

CAMERAS = {
    "front_left": ("FL", "cameraFrontLeft"),
    "front_right": ("FR", "cameraFrontRight"),
    "side_left": ("SL", "cameraSideLeft"),
    "side_right": ("SR", "cameraSideRight"),
    "rear_left": ("RL", "cameraRearLeft"),
    "rear_right": ("RR", "cameraRearRight"),
    "center": ("CENTER", "cameraCenter"),
}
"""camera -> the end of the name of its folder of images, and the beginning of the names of its calibration files"""
_NAME = re.compile(r"[0-9]{4}-([0-9]{2})-[0-9]{2}-(V[0-9]+)-Log[0-9]+")
_MARK = "lidar*_body.yaml"
_ABOVE = 4
"""folders above a log in which its calibration is searched for"""


@dataclass(frozen=True)
class Log:
    """The files of a log."""

    bag: Path
    name: str
    month: int | None
    """by the date in its name"""
    vehicle: str
    """``V1``, ``V2`` or ``V3``; empty: nothing tells it"""
    images: dict[str, Path]
    """camera -> folder"""
    calibration: Path
    """the folder with the calibration of the vehicle"""


def find_logs(sources: Sequence[Path], calibration: Path | None) -> list[Log]:
    """The files of all logs.

    Args:
        sources: bags, or folders of one each.
        calibration: folder with the calibration, or the one that holds those of all vehicles; None: searched for.

    Raises:
        DatasetError: a bag or the calibration is missing or cannot be told, or two logs have the same name.
        ConfigError: one calibration was given for several vehicles.
    """
    bags = [_bag_of(source) for source in sources]
    logs = [_log_of(bag, name, calibration) for bag, name in zip(bags, traversal_names(bags, SUFFIXES), strict=True)]
    vehicles = sorted({log.vehicle for log in logs} - {""})
    if calibration is not None and len(vehicles) > 1 and all(log.calibration == calibration for log in logs):
        raise ConfigError(
            f"--calibration-folder: {calibration} is of one vehicle, the logs are of {' and '.join(vehicles)}; name "
            f"the folder that holds {' and '.join(f'Calibration-{v}' for v in vehicles)}"
        )
    return logs


def _log_of(bag: Path, name: str, calibration: Path | None) -> Log:
    place = bag.resolve()
    found = _NAME.search(place.stem) or _NAME.search("-".join(place.parent.parts[-3:]))
    vehicle = found[2] if found else ""
    month = int(found[1]) if found else None
    return Log(bag, name, month, vehicle, _images_of(bag), _calibration_of(place, vehicle, calibration))


def _bag_of(source: Path) -> Path:
    if not source.is_dir():
        if not source.exists():
            raise DatasetError("missing; expected a bag, or the folder of one", source)
        if source.suffix not in SUFFIXES:
            raise DatasetError(f"does not have the name of a bag; expected {', '.join(SUFFIXES)}", source)
        return source
    bags = sorted(p for p in source.iterdir() if p.suffix in SUFFIXES and not p.name.startswith("."))
    if len(bags) == 1:
        return bags[0]
    if bags:
        names = ", ".join(p.name for p in bags[:4])
        raise DatasetError(f"holds {len(bags)} bags ({names}); name one of them for each drive", source)
    raise DatasetError("holds no bag; expected one, such as 2017-08-04-V2-Log1.bag", source)


def _images_of(bag: Path) -> dict[str, Path]:
    """Folders with PNG beside a bag, by its name; if it is the only bag there, by their endings alone."""
    folders = sorted(p for p in bag.parent.iterdir() if p.is_dir() and any(q.suffix == ".png" for q in p.iterdir()))
    alone = sum(p.suffix in SUFFIXES for p in bag.parent.iterdir()) == 1
    out = {}
    for camera, (ending, _) in CAMERAS.items():
        named = [p for p in folders if p.name.lower() == f"{bag.stem}-{ending}".lower()]
        ended = [p for p in folders if p.name.lower().endswith(f"-{ending}".lower())] if alone else []
        if len(ended) > 1 and not named:
            names = ", ".join(p.name for p in ended)
            raise DatasetError(f"several folders may be the images of {bag.name} ({names})", bag.parent)
        for folder in [*named, *ended][:1]:
            out[camera] = folder
    return out


def _calibration_of(bag: Path, vehicle: str, given: Path | None) -> Path:
    if given is not None and not given.is_dir():
        raise DatasetError("no such folder; expected the calibration (--calibration-folder)", given)
    bases = [given] if given is not None else list(bag.parents)[: _ABOVE + 1]
    for base in bases:
        found = list(dict.fromkeys(p for p in _candidates(base, vehicle) if any(p.glob(_MARK))))
        if len(found) > 1 and not vehicle:
            names = ", ".join(p.name for p in found)
            raise DatasetError(
                f"the vehicle of {bag.name} is not known, and there are calibrations of several ({names}); name one "
                "by --calibration-folder",
                base,
            )
        if found:
            return found[0]
    of = f"of {vehicle} " if vehicle else ""
    folder = f"Calibration-{vehicle or 'V2'}"
    message = f"the calibration {of}is missing: no {_MARK} in it, in {folder} or in {folder}/{vehicle or 'V2'}"
    raise DatasetError(
        f"{message}{'' if given else f', nor in the {_ABOVE} folders above; --calibration-folder names it'}", bases[0]
    )


def _candidates(base: Path, vehicle: str) -> Iterator[Path]:
    names = vehicle or "V*"
    yield base
    for pattern in (f"Calibration-{names}", f"Calibration-{names}/{names}", f"Calibration/{names}", names):
        yield from sorted(p for p in base.glob(pattern) if p.is_dir())

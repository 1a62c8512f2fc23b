"""The plan of a rendered set: towns, places, and each image's camera and condition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.cross_view.rendered import flight
from relocbench.datasets.cross_view.rendered.flight import Optics
from relocbench.datasets.cross_view.rendered.places import Building, PlaceOfTown, buildings, spread
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.town.network import StreetNetwork
from relocbench.errors import ConfigError
from relocbench.progress import Reporter

MOST_PLACES = 5000
"""places in one split; labels have four digits, and those of test begin at this number"""
PLACES_PER_TOWN = 50
"""default; fewer if a town has no more room"""
_SEEDS_PER_SET = 1000
"""towns of sets with different seeds are different"""


@dataclass(frozen=True)
class Views:
    """The images to take of each place."""

    optics: Optics
    drone: int
    street: int
    far_m: float
    """distance at which the drone's flight begins"""
    random_heading: bool
    """whether satellite images are turned at random; otherwise north is up"""
    satellite_condition: str
    other_conditions: tuple[str, ...]
    """conditions that drone and street images take in turn"""


@dataclass(frozen=True, eq=False)
class Photo:
    """One image to render."""

    keys: tuple[str, ...]
    """paths in the set; the second and later ones are other names of the same file"""
    label: str
    view: str
    condition: str
    town: DistrictSpec
    T_world_cam: Array
    seed: int
    """seed of noise and of falling rain and snow"""


def choose_places(
    split: str,
    count: int,
    distractors: int,
    towns: int | None,
    spacing_m: float,
    extent_m: float,
    seed: int,
    reporter: Reporter,
) -> list[tuple[PlaceOfTown, StreetNetwork]]:
    """Places of a split with the streets of their towns, spread evenly over the towns as far as these have room.

    Raises:
        ConfigError: there are more places than labels, or than the towns have room for.
    """  # fmt: skip
    wanted = count + distractors
    if wanted > MOST_PLACES:
        raise ConfigError(f"--places and --distractors ask for {wanted} places; a split has at most {MOST_PLACES}")
    planned = towns if towns is not None else -(-wanted // PLACES_PER_TOWN)
    chosen: list[tuple[DistrictSpec, Building, StreetNetwork]] = []
    with reporter.stage(f"laying out towns of {split}", planned) as advance:
        k = 0
        while len(chosen) < wanted:
            if k >= _SEEDS_PER_SET or (towns is not None and k >= towns):
                raise ConfigError(
                    f"--places: {k} towns of {extent_m:g} m have room for {len(chosen)} places {spacing_m:g} m apart, "
                    f"not for {wanted}; increase --towns or --extent, or decrease --spacing"
                )
            town = DistrictSpec(seed * _SEEDS_PER_SET + k, split, extent_m)
            district = scenes.district(town)
            rng = np.random.default_rng([seed, 31, k, _number(split)])
            share = -(-(wanted - len(chosen)) // max(planned - k, 1))
            found = spread(buildings(district), spacing_m, rng)[:share]
            chosen += [(town, building, district.network) for building in found]
            k += 1
            advance(1 if k <= planned else 0)
    first = MOST_PLACES * _number(split)
    return [
        (PlaceOfTown(f"{first + i:04d}", town, building, i >= count), network)
        for i, (town, building, network) in enumerate(chosen)
    ]


def photos_of(place: PlaceOfTown, network: StreetNetwork, views: Views, split: str, seed: int) -> list[Photo]:
    """All images of a place, in the order of their keys."""
    rng = np.random.default_rng([seed, 32, int(place.label)])
    start, turn = rng.uniform(0, 2 * np.pi, 2)
    poses = {
        "drone": flight.drone(place.building, views.drone, views.far_m, float(start)),
        "satellite": [flight.satellite(place.building, float(turn) if views.random_heading else 0.0)],
        "street": flight.street(place.building, views.street, network) if views.street else [],
    }
    found = []
    for v, (view, taken) in enumerate(poses.items()):
        for k, T_world_cam in enumerate(taken):
            others = views.other_conditions
            condition = views.satellite_condition if view == "satellite" else others[k % len(others)]
            number = int(np.random.SeedSequence([seed, 33, int(place.label), v, k]).generate_state(1)[0])
            keys = tuple(f"{f}/{place.label}/{_file(view, k, place.label)}" for f in _folders(view, split, place))
            found.append(Photo(keys, place.label, view, condition, place.town, T_world_cam, number))
    return found


def _folders(view: str, split: str, place: PlaceOfTown) -> Sequence[str]:
    if split == "train":
        return (f"train/{view}",)
    return (f"test/gallery_{view}",) if place.distractor else (f"test/gallery_{view}", f"test/query_{view}")


def _file(view: str, k: int, label: str) -> str:
    """File name of an image, as in University-1652."""
    return {"drone": f"image-{k + 1:02d}.png", "satellite": f"{label}.png"}.get(view, f"{k + 1}.png")


def _number(split: str) -> int:
    return {"train": 0, "test": 1}[split]

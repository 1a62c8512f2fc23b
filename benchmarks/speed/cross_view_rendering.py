"""The time to render a cross-view set, and whether its places can be distinguished.

One town is laid out and prepared in two conditions; then places are rendered from all views. Times are processor
seconds on one core, so that other programs do not count. Compiled code is loaded before.

To see whether places can be distinguished, the satellite images of all places in one condition are searched for among
those in the other by the zero-mean normalised cross-correlation of their grey levels at 32 x 32 pixels. It prints the
share that finds its own place, and the pairs of places that are most alike.

    python benchmarks/speed/cross_view_rendering.py [--size 256] [--extent 250] [--places 24] [--seed 0]
        [--sheet FILE.png]

``--sheet`` writes the picture of docs/cross-view.md: some places seen by satellite, by drone and from the street.
The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from relocbench.datasets.core import images
from relocbench.datasets.cross_view.rendered import work
from relocbench.datasets.cross_view.rendered.flight import Optics
from relocbench.datasets.cross_view.rendered.plan import Photo, Views, choose_places, photos_of
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.progress import Silent

CONDITIONS = ("Sunny", "Overcast")
_SHEET_CONDITIONS = ("Sunny", "Overcast", "WetNoon", "Snow")
_SHEET_PLACES = 4
_LEVELS = 32
Value = TypeVar("Value")
Picture = np.ndarray


def timed(call: Callable[..., Value], *arguments: Any) -> tuple[Value, float]:
    """A result, and the processor seconds that it took."""
    start = time.process_time()
    return call(*arguments), time.process_time() - start


def photograph(photo: Photo, views: Views) -> Picture:
    """An image (H, W, 3) as the build renders it."""
    condition = condition_named(photo.condition).factors
    renderer = work.renderer_of(photo.town, condition, work.seen_by(photo.view, condition, views))
    return renderer.render(views.optics.camera(photo.view), photo.T_world_cam, photo.seed).rgb


def vector(picture: Picture) -> np.ndarray:
    """The grey levels (1024,) of an image at 32 x 32 pixels, with zero mean and norm 1."""
    grey = cv2.resize(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), (_LEVELS, _LEVELS), interpolation=cv2.INTER_AREA)
    values = grey.astype(np.float64).ravel() - grey.mean()
    return values / np.linalg.norm(values)


def apart(first: list[Picture], second: list[Picture], labels: list[str]) -> dict[str, Any]:
    """How well satellite images in one condition find their places in another."""
    scores = np.stack([vector(p) for p in first]) @ np.stack([vector(p) for p in second]).T
    own = np.diag(scores).copy()
    np.fill_diagonal(scores, -np.inf)
    nearest = int(scores.max(axis=1).argmax())
    return {
        "places": len(labels),
        "own_place_first": float(np.mean(own > scores.max(axis=1))),
        "own_median": float(np.median(own)),
        "nearest_other_median": float(np.median(scores.max(axis=1))),
        "most_alike": [labels[nearest], labels[int(scores[nearest].argmax())], float(scores.max())],
    }


def views_of(size: int, drone: int, conditions: tuple[str, ...]) -> Views:
    return Views(Optics(size, 80.0), drone, 1, 110.0, False, conditions[0], conditions[1:])


def sheet(path: Path, places: list[Any], split: str, seed: int) -> None:
    """A sheet with a row for each place: satellite, drone from three heights in other conditions, street."""
    views = views_of(192, 7, _SHEET_CONDITIONS)
    wanted = [p for place, network in places[:_SHEET_PLACES] for p in photos_of(place, network, views, split, seed)]
    chosen = [p for p in wanted if p.view != "drone" or p.keys[0].endswith(("-01.png", "-05.png", "-06.png"))]
    done = {p.keys[0]: photograph(p, views) for p in sorted(chosen, key=lambda p: (p.condition, p.view))}
    rows = []
    for place, _ in places[:_SHEET_PLACES]:
        own = [p for p in chosen if p.label == place.label]
        own.sort(key=lambda p: ("satellite", "drone", "street").index(p.view))
        rows.append(np.hstack([done[p.keys[0]] for p in own]))
    images.write_image(path, np.vstack(rows))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--extent", type=float, default=250.0)
    parser.add_argument("--places", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sheet", type=Path)
    options = parser.parse_args()
    split = "test"
    views = views_of(options.size, 3, CONDITIONS)
    town = scenes.DistrictSpec(options.seed * 1000, split, options.extent)
    warm_up = scenes.DistrictSpec(options.seed * 1000, "train", 190.0)
    factors = condition_named(CONDITIONS[0]).factors
    work.renderer_of(warm_up, factors, work.seen_by("drone", factors, views))
    _, layout_s = timed(scenes.district, town)
    places = choose_places(split, options.places, 0, 1, 25.0, options.extent, options.seed, Silent())
    photos = [p for place, network in places for p in photos_of(place, network, views, split, options.seed)]
    above = [p for p in photos if p.view == "satellite"]
    first = photograph(above[0], views)  # compiles for this kind of view

    ready = {}
    seconds: dict[str, list[float]] = {"satellite": [], "drone": [], "street": []}
    pictures: dict[str, list[Picture]] = {}
    for condition in CONDITIONS:
        chosen = condition_named(condition).factors
        seen = work.seen_by("satellite", chosen, views)
        _, ready[condition] = timed(work.renderer_of, town, chosen, seen)
        again = [Photo(p.keys, p.label, p.view, condition, p.town, p.T_world_cam, p.seed) for p in above]
        taken = [timed(photograph, p, views) for p in again]
        pictures[condition] = [picture for picture, _ in taken]
        seconds["satellite"] += [s for _, s in taken]
    others = [p for p in photos if p.view != "satellite"]
    for view in ("drone", "street"):
        some = [p for p in others if p.view == view][:24]
        photograph(some[0], views)
        seconds[view] += [timed(photograph, p, views)[1] for p in some]
    assert first.shape == (options.size, options.size, 3)
    labels = [place.label for place, _ in places]
    result = {
        "size": options.size,
        "extent_m": options.extent,
        "layout_s": layout_s,
        "ready_s": ready[CONDITIONS[1]],
        "image_s": {view: float(np.median(of_view)) for view, of_view in seconds.items()},
        "apart": apart(pictures[CONDITIONS[0]], pictures[CONDITIONS[1]], labels),
    }
    if options.sheet:
        sheet(options.sheet, places, split, options.seed)
    found = result["apart"]
    print(f"processor seconds at {options.size} px: laying out a town of {options.extent:g} m {layout_s:.1f},")
    print(f"making it ready in another condition {result['ready_s']:.1f}; an image:")
    for view, value in result["image_s"].items():
        print(f"  {view:<10} {value:.3f}  ({1 / value:.1f} images/s)")
    print(
        f"{found['places']} places, satellite in {CONDITIONS[0]} among those in {CONDITIONS[1]}: "
        f"{100 * found['own_place_first']:.1f} % find their own; correlation {found['own_median']:.2f} with their own, "
        f"{found['nearest_other_median']:.2f} with the nearest other (medians)"
    )
    print(
        f"most alike: {found['most_alike'][0]} and {found['most_alike'][1]}, correlation {found['most_alike'][2]:.2f}"
    )
    print(json.dumps(result))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

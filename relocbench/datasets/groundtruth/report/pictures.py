"""``relocbench inspect --ground-truth``: the pictures of a dataset's ground truth and the page that shows them.

``OUT/index.html``, ``OUT/residuals.png``, and for each pair set ``OUT/PAIRSET/map.png``, ``overlay_NN.png`` and
``keyframe_NN.png``, where an overlay and a keyframe with the same number are of the same pair; without images, there is
no keyframe.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.groundtruth.calibration.files import read_calibration
from relocbench.datasets.groundtruth.report.inspected import FOLDER, InspectedSet, Spot, chosen_spots, inspected_sets
from relocbench.datasets.groundtruth.report.overlay_picture import write_overlay
from relocbench.datasets.groundtruth.report.page import DrawnSet, DrawnSpot, write_page
from relocbench.datasets.groundtruth.report.residual_picture import measure_residuals, write_residuals
from relocbench.datasets.groundtruth.report.road_picture import write_map
from relocbench.datasets.inspect.overlay import write_pair
from relocbench.progress import Reporter


def write_ground_truth(
    dataset: Dataset, pair_sets: Sequence[PairSet], folder: Path, count: int, seed: int, reporter: Reporter
) -> Path:
    """Write the pictures and the page of a dataset's ground truth from lidar. Returns the path of the page.

    Args:
        count: number of pairs to draw for each pair set, evenly along the drive; the least certain pair and one of each
            kind of rejection are drawn in addition.
        seed: of the choice of keyframe points that are drawn.

    Raises:
        DatasetError: no pair set has ground truth from lidar, or one of its files is missing or damaged.
    """
    inspected = inspected_sets(dataset, pair_sets)
    spots = [chosen_spots(one.pair_set.all_pairs, count) for one in inspected]
    drawn = []
    with reporter.stage("drawing ground truth", sum(2 + len(some) for some in spots)) as advance:
        for one, some in zip(inspected, spots, strict=True):
            residuals = measure_residuals(one)
            advance(1)
            write_map(folder / one.name / "map.png", one, some)
            advance(1)
            pictures = []
            for number, spot in enumerate(some, start=1):
                pictures.append(_write_spot(dataset, one, spot, number, folder, seed))
                advance(1)
            drawn.append(DrawnSet(one, residuals, f"{one.name}/map.png", tuple(pictures)))
    write_residuals(folder / "residuals.png", [(d.found, d.residuals) for d in drawn])
    write_page(folder / "index.html", dataset, drawn, "residuals.png", read_calibration(dataset.root / FOLDER))
    return folder / "index.html"


def _write_spot(
    dataset: Dataset, inspected: InspectedSet, spot: Spot, number: int, folder: Path, seed: int
) -> DrawnSpot:
    overlay = f"{inspected.name}/overlay_{number:02d}.png"
    write_overlay(folder / overlay, inspected, spot, number)
    if spot.pair.T_query_ref is None or not dataset.has_images(inspected.pair_set):
        return DrawnSpot(spot, number, overlay, None, None)
    keyframe = f"{inspected.name}/keyframe_{number:02d}.png"
    name = f"{number}   {inspected.name}"
    agreement = write_pair(folder / keyframe, dataset, inspected.pair_set, spot.pair, name, seed)
    return DrawnSpot(spot, number, overlay, keyframe, agreement.words)

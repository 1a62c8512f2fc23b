"""Retrievers on images of one street, walked several times: images of one number show one place.

Each folder in WALKS holds the images of one walk; files of one number, in the order of their names, were taken within
``--tolerance`` images of the same spot, as in Gardens Point (A. Glover, QUT), whose three walks are two by day and one
by night. Every walk is searched in every other one. R@1 is the share of queries whose first image is right.

    python benchmarks/truth/walks.py WALKS [--method NAME] ... [--set NAME.key=value] ... [--tolerance N]

It prints a table; the last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from university_sample import METRICS, Asked

from relocbench.arrays import Image
from relocbench.datasets.core.images import as_rgb, read_image
from relocbench.errors import DatasetError, RelocbenchError
from relocbench.methods import RETRIEVERS, parse_methods
from relocbench.metrics import chance_level, relevance_from_lists
from relocbench.retrieval import ImageView, RetrievalTask

FLOORS = ("random", "colour-histogram", "orb-bow")
SUFFIXES = (".jpg", ".jpeg", ".png")


def walks(folder: Path) -> dict[str, list[Path]]:
    """The images of each walk by its name, in order.

    Raises:
        DatasetError: there are no two walks, or not all have as many images.
    """
    found = {
        path.name: sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
        for path in sorted(folder.glob("*"))
        if path.is_dir()
    }
    counts = {len(files) for files in found.values()}
    if len(found) < 2 or len(counts) != 1 or 0 in counts:
        told = ", ".join(f"{name} {len(files)}" for name, files in found.items()) or "none"
        raise DatasetError(f"expected two walks or more with as many images each; there are {told}", folder)
    return found


def task(name: str, query: list[Path], gallery: list[Path], tolerance: int) -> RetrievalTask:
    """Images of one walk, to be searched in another; those whose number differs by up to ``tolerance`` are right."""
    near = [
        np.arange(max(0, number - tolerance), min(len(gallery), number + tolerance + 1)) for number in range(len(query))
    ]
    return RetrievalTask(name, _views(query), _views(gallery), relevance_from_lists(near, len(gallery)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("walks", type=Path, help="folder of folders of images")
    parser.add_argument(
        "--method", "-m", action="append", default=[], help="a retriever beside the floors; repeat for more"
    )
    parser.add_argument("--set", action="append", default=[], help="NAME.key=value")
    parser.add_argument("--tolerance", type=int, default=3, help="images to either side that are right, too")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    try:
        specs = parse_methods([*FLOORS, *options.method], options.set, options.seed, RETRIEVERS)
        methods = {spec.label: Asked(spec, options.seed) for spec in specs}
        rows: dict[str, Any] = {}
        for (query, asked_files), (gallery, files) in permutations(walks(options.walks).items(), 2):
            of = task(f"{query}-{gallery}", asked_files, files, options.tolerance)
            rows[of.name] = {"chance": chance_level(of.relevance, METRICS)}
            rows[of.name] |= {label: method.metrics(of) for label, method in methods.items()}
    except RelocbenchError as bad:
        print(bad, file=sys.stderr)
        return 2
    labels = list(next(iter(rows.values())))
    print("\t".join(["R@1, %", *labels]))
    for name, of_task in rows.items():
        print("\t".join([name, *(f"{100 * of_task[label]['R@1']:.1f}" for label in labels)]))
    print(json.dumps({"benchmark": "walks", "tolerance": options.tolerance, "tasks": rows}))
    return 0


def _views(files: list[Path]) -> tuple[ImageView, ...]:
    return tuple(ImageView(path.as_posix(), "street", partial(_read, path)) for path in files)


def _read(path: Path) -> Image:
    return as_rgb(read_image(path, None))


if __name__ == "__main__":
    raise SystemExit(main())

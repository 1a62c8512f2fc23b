"""Answers a blind export of images by the mean colours of its images, as a method of your own would.

    python3 rank_blind.py BLIND OUT --top 20

A method of your own takes its place: it compares the images of tasks/TASK.queries.txt with those of
tasks/TASK.gallery.txt (images/KEY.png) and writes a line 'query db' for each retrieved image, best first.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np


def describe(path: Path) -> np.ndarray:
    return cv2.imread(str(path)).reshape(-1, 3).mean(axis=0)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("blind", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--top", type=int, default=20)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for path in sorted((given.blind / "tasks").glob("*.queries.txt")):
        task = path.name.removesuffix(".queries.txt")
        queries, gallery = (
            (given.blind / "tasks" / f"{task}.{side}.txt").read_text().split() for side in ("queries", "gallery")
        )
        known = np.array([describe(given.blind / "images" / f"{key}.png") for key in gallery])
        lines = []
        for query in queries:
            apart = np.linalg.norm(known - describe(given.blind / "images" / f"{query}.png"), axis=1)
            lines += [f"{query} {gallery[k]}\n" for k in np.argsort(apart, kind="stable")[: given.top]]
        (given.out / f"{task}.txt").write_text("".join(lines))


if __name__ == "__main__":
    main()

"""How far the query's camera is from its keyframe in the published pairs: a table of how many pairs are how far apart.

It is taken from the published errors, which hold the distance of each pair. Pairs that show different places are
left out.

    python benchmarks/publish/distances.py [--leaderboard leaderboard]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import tarfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from relocbench.datasets.core.pairfile import ELSEWHERE

EDGES_M = (0.0, 0.25, 0.5, 1.0, 2.0, 4.5, np.inf)
"""within a condition, keyframes of the districts stand 4 m ahead or behind, to 0.3 m"""
METHOD = "identity"
"""any method's errors hold the distances"""
_HEADS = [f"{low:g} to {high:g} m" for low, high in pairwise(EDGES_M[:-1])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--leaderboard", type=Path, default=Path("leaderboard"))
    folder = parser.parse_args().leaderboard
    distances = {**of_districts(folder / "weather" / "errors"), **of_small_sets(folder / "errors.csv")}
    counts = {name: np.histogram(metres, EDGES_M)[0].tolist() for name, metres in distances.items()}
    print(f"| pairs of | all | {' | '.join(_HEADS)} | farther | median |")
    print(f"|---|{'---:|' * (len(EDGES_M) + 1)}")
    for name, metres in distances.items():
        print(f"| {name} | {len(metres)} | {' | '.join(map(str, counts[name]))} | {np.median(metres):.2f} m |")
    print(json.dumps({"benchmark": "distances", "edges_m": EDGES_M[:-1], "pairs": counts}))


def of_districts(errors: Path) -> dict[str, list[float]]:
    """Metres of every pair of the districts, across conditions and within one."""
    found: dict[str, list[float]] = {"districts, across conditions": [], "districts, within a condition": []}
    across, within = found.values()
    for name, table in _archived(errors):
        reference, query = name.split("__")[:2]
        (within if reference == query else across).extend(table.loc[table["group"] != ELSEWHERE, "distance_m"])
    return found


def _archived(errors: Path) -> Iterator[tuple[str, pd.DataFrame]]:
    for path in sorted(errors.glob(f"*/{METHOD}.tar.xz")):
        with tarfile.open(path) as archive:
            for member in archive:
                content = archive.extractfile(member)
                if member.name.endswith(".errors.csv") and content is not None:
                    yield Path(member.name).name, pd.read_csv(content)


def of_small_sets(errors: Path) -> dict[str, list[float]]:
    """Metres of every pair of the small sets."""
    table = pd.read_csv(errors)
    rows = table[table["method"] == METHOD].groupby("dataset")["distance_m"]
    return {f"`{name}`": metres.tolist() for name, metres in rows}


if __name__ == "__main__":
    main()

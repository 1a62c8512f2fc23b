"""How far the query's camera is from its keyframe in the published pairs: a table of how many pairs are how far apart.

It is taken from the published errors, which hold the distance of each pair. Of an edition, pairs count by their tier.

    python benchmarks/publish/distances.py [--leaderboard leaderboard]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import tiers
from archives import unpack

EDGES_M = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, np.inf)
METHOD = "identity"
"""any method's errors hold the distances"""
_HEADS = [f"{low:g} to {high:g} m" for low, high in pairwise(EDGES_M[:-1])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--leaderboard", type=Path, default=Path("leaderboard"))
    text, counts = table(parser.parse_args().leaderboard)
    print(text)
    print(json.dumps({"benchmark": "distances", "edges_m": EDGES_M[:-1], "pairs": counts}))


def table(leaderboard: Path) -> tuple[str, dict[str, list[int]]]:
    """The table in Markdown, and how many pairs are how far apart."""
    distances: dict[str, list[float]] = {}
    for edition in sorted((leaderboard / "edition" / "predictions").iterdir()):
        distances |= of_edition(edition)
    distances |= of_small_sets(leaderboard / "errors.csv")
    counts = {name: np.histogram(metres, EDGES_M)[0].tolist() for name, metres in distances.items()}
    lines = [f"| pairs of | all | {' | '.join(_HEADS)} | farther | median |", f"|---|{'---:|' * (len(EDGES_M) + 1)}"]
    for name, metres in distances.items():
        numbers = (len(metres), *counts[name], f"{np.median(metres):.2f} m")
        lines.append(f"| {name} | {' | '.join(map(str, numbers))} |")
    return "\n".join(lines), counts


def of_edition(archives: Path) -> dict[str, list[float]]:
    """Metres of every pair of a split of an edition, by tier."""
    with tempfile.TemporaryDirectory() as temporary:
        rows = tiers.answers(unpack(archives, Path(temporary), METHOD))
    return {f"{archives.name}, {group.name}": group.rows["distance_m"].tolist() for group in tiers.groups(rows)}


def of_small_sets(errors: Path) -> dict[str, list[float]]:
    """Metres of every pair of the small sets."""
    table = pd.read_csv(errors)
    rows = table[table["method"] == METHOD].groupby("dataset")["distance_m"]
    return {f"`{name}`": metres.tolist() for name, metres in rows}


if __name__ == "__main__":
    main()

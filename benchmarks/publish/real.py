"""Print one page of all trackers on all real recordings, from the numbers of the published leaderboard.

For each set: how many answers are right (within 0.25 m and 2 degrees), with the interval of the leaderboard, median
errors over all pairs, pairs that were refused, answers that are wrong, how many answers state a confidence of 0.5 or
more, and how many of these are right.

    python benchmarks/publish/real.py [--board leaderboard] [--out leaderboard/real]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

RENDERED = ("town_demo",)
"""sets of the leaderboard that are not recordings"""
RIGHT = "recall@(0.25m,2deg)"
WRONG = "wrong_of_answered@(0.25m,2deg)"
SURE, SURE_RIGHT = "coverage_at_confidence_50", "precision_at_confidence_50@(0.25m,2deg)"
PRECISE = "r_auc@0.5deg"
FLOORS = ("clock", "identity")
TOTAL = "total"
"""the pair set of a dataset's line over all its pairs"""
_HEAD = """# Real recordings

Printed by `python benchmarks/publish/real.py --out leaderboard/real` from [leaderboard.csv](../leaderboard.csv). The
networks of gn-net and gn-net-contrastive have seen rendered towns, the photographs that their cards name and, in their
encoder, ImageNet; that of lm-net rendered towns only, ALIKED's its authors' photographs. Two things were chosen with
recordings of this page in view: dso's cutoff, on KITTI 06, and where gn-net begins to align from its matches and when
it declines, among others on oxford and frankfurt ([ledger](../LEDGER.md)). gn-net, gn-net-from-prior and
gn-net-contrastive also try starts up to 10 m ahead and behind along the road, which suits cameras that drive; the
others do not. Right is an answer within 0.25 m and 2 degrees, as a share of all pairs; an interval stands where the
leaderboard has one, which needs ten independent pairs. A refusal is a pair
without an answer, and its error is infinite in the medians. Sure are answers with a confidence of 0.5 or more, for
trackers that state one. Seconds are medians a pair while other work ran; `benchmarks/speed/trackers.py` compares them.
The floors see no image: identity stays at the keyframe's pose, clock fits the motion to the times. A steady drive gives
itself away to clock, as KITTI's do, and where a camera hardly moves, as in fr1_xyz and fr1_desk, both are mostly right.
"""
SETS = {
    "kitti_06": (
        "KITTI odometry 06, frames 20 to 44, 1, 2, 4 and 8 frames (1.2 to 9.6 m) apart, depth by stereo",
        "GNSS/INS",
    ),
    "kitti_00": (
        "KITTI odometry 00, frames 0 to 5, 1 to 5 (0.7 to 3.6 m) apart, depth by lidar alone",
        "its scans, to 1 cm",
    ),
    "kitti_00_stereo": ("those of its pairs that begin at frame 0, depth by stereo", "the same"),
    "fr1_xyz, fr1_desk": ("TUM RGB-D, one desk, 1, 2 and 4 of the images at hand apart", "motion capture"),
    "fr1_xyz_to_desk": (
        "the second recording in the map of the first, six minutes later, 55 to 65 degrees aside",
        "the same",
    ),
    "webcams": (
        "three cameras on 16 pairs of days each, in daylight from low to high sun; geometry and motion are made up: a "
        "slanted plane 6 to 20 m away, up to 1 m and 6 degrees (`python tools/real_sets still-camera`)",
        "exact for the motion, to about 0.1 degrees for the cameras",
    ),
    "frankfurt": (
        "a fourth camera, over a city: 13 queries of the lit night on keyframes of the day, and 13 the other way "
        "round; geometry and motion made up as for webcams",
        "the same",
    ),
    "middlebury": (
        "the two cameras of five stereo scenes, 0.16 to 0.19 m apart, dense depth; one scene (ArtL) in other light "
        "(`python tools/real_sets stereo-pairs`)",
        "calibrated, to a millimetre; depth to 4 mm",
    ),
    "oxford": (
        "eight scenes with homographies (Mikolajczyk et al.): light, blur, compression, viewpoint, zoom with rotation; "
        "motion and plane are such as give the homography (`python tools/real_sets homographies`)",
        "exact for the homography, which is right to 0.3 to 2 pixels",
    ),
}
"""what the sets are, and where their truth is from; several with one line by their names and commas"""
NOTES = {
    "webcams": """\
What `webcams` cannot tell: nothing hides anything else and nothing is seen from another side. The cameras themselves
shift from day to day by 0.3 to 1.1 pixels in the median, by the notes on the data; a pixel is 0.12 degrees, so that
smaller rotation errors and their order tell of the truth. Marks of the camera move with the scene, among them the
blocks of 8 pixels of two cameras' JPEG files. The set tells what light and weather do to a tracker, not what a drive
does, and none of its images is of night or snow.
""",
    "frankfurt": """\
`frankfurt` is as made up as `webcams`, and an image of the night is in a pair of each direction.
""",
    "middlebury": """\
On `middlebury` the keyframe's own pose is right within 0.25 m and has no error of rotation: only the median of metres
tells it from trackers.
""",
    "oxford": """\
The focal length of `oxford`'s cameras is not known. Metres and degrees there are those of a camera of 900 pixels that
looks at a plane 5 m away, and a zoom counts as a motion ahead. A pixel of a homography is up to 0.1 m and 0.8 degrees
there, so that r_auc@0.5deg tells of the truth, too. Under light, blur and compression the camera moves little, and
identity is right on most pairs.
""",
}
"""what a set cannot tell"""


@dataclass(frozen=True)
class Row:
    """A tracker on a set."""

    method: str
    right: float
    low: float
    high: float
    precise: float
    metres: float
    degrees: float
    pairs: int
    refused: int
    wrong: int
    sure: int | None
    sure_right: float
    seconds: float

    @classmethod
    def of(cls, scores: Any) -> Row:
        """The row of a line of the leaderboard."""
        pairs, answered = int(scores["pairs"]), int(scores["answered"])
        wrong = 0.0 if answered == 0 else float(scores[WRONG])
        sure = float(scores[SURE])
        return cls(
            method=str(scores["method"]),
            right=float(scores[RIGHT]),
            low=float(scores[f"{RIGHT}_low"]),
            high=float(scores[f"{RIGHT}_high"]),
            precise=float(scores[PRECISE]),
            metres=float(scores["median_translation_error_m"]),
            degrees=float(scores["median_rotation_error_deg"]),
            pairs=pairs,
            refused=pairs - answered,
            wrong=round(wrong * answered),
            sure=None if pd.isna(sure) or not states_confidence(scores) else round(sure * pairs),
            sure_right=float(scores[SURE_RIGHT]),
            seconds=float(scores["median_seconds"]),
        )


def states_confidence(scores: Any) -> bool:
    """Whether the tracker states how sure it is."""
    return not pd.isna(scores["confidence_auc_pr@(0.25m,2deg)"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", type=Path, default=Path("leaderboard"), help="folder with leaderboard.csv")
    parser.add_argument("--out", type=Path, help="folder for real.md")
    options = parser.parse_args()
    found = sets(pd.read_csv(options.board / "leaderboard.csv"))
    text = "\n".join(
        [*overview(found), *together(found), *(line for name, rows in found.items() for line in table(name, rows))]
    )
    print(text)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "real.md").write_text(f"{head({name.split(':')[0] for name in found})}{text}\n")
    shares = {name: {row.method: row.right for row in rows} for name, rows in found.items()}
    print(json.dumps({"benchmark": "real", "right": shares}))


def head(datasets: Collection[str]) -> str:
    """What the page says of itself and of the sets that it has."""
    lines = ["", "| set | what it is | truth |", "|---|---|---|"]
    lines += [f"| {names} | {' | '.join(of)} |" for names, of in SETS.items() if set(names.split(", ")) & set(datasets)]
    notes = [note for name, note in NOTES.items() if name in datasets]
    return _HEAD + "\n".join([*lines, "", *notes])


def sets(board: pd.DataFrame) -> dict[str, list[Row]]:
    """The rows of every real set, best first, floors last.

    A dataset is a set for each of its pair sets, but one alone if they differ in their cameras.
    """
    of_all = board[(board["group"] == "all") & ~board["dataset"].isin(RENDERED)]
    out = {}
    for dataset, scores in of_all.groupby("dataset", sort=True):
        parts = scores[scores["pair_set"].str.contains("__")]
        several = parts["pair_set"].nunique() > 1
        if parts["pair_set"].str.split("__").str[2].nunique() > 1:
            named = {str(dataset): scores[scores["pair_set"] == TOTAL]}
        else:
            named = {
                f"{dataset}: {pair_set.split('__')[1]}" if several else str(dataset): rows
                for pair_set, rows in parts.groupby("pair_set", sort=True)
            }
        for name, of in named.items():
            rows = [Row.of(line) for _, line in of.iterrows()]
            out[name] = sorted(rows, key=lambda row: (row.method in FLOORS, -row.right, -row.precise, row.method))
    return out


def overview(found: dict[str, list[Row]]) -> list[str]:
    """Shares that are right: a row for each tracker by its name, the floors last, and a column for each set."""
    right = {name: {row.method: row.right for row in rows} for name, rows in found.items()}
    methods = {row.method for rows in found.values() for row in rows}
    heads = [f"{name} ({rows[0].pairs})" for name, rows in found.items()]
    lines = ["\n## Right answers, %\n", "The sets are too different for a mean, and most too small to rank by.\n"]
    lines += [f"| tracker | {' | '.join(heads)} |", f"|---|{'---:|' * len(heads)}"]
    for method in sorted(methods, key=lambda method: (method in FLOORS, method)):
        cells = [percent(of.get(method, float("nan"))) for of in right.values()]
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return lines


def together(found: dict[str, list[Row]]) -> list[str]:
    """Numbers of all pairs together: right ones, and how many answers are sure and right."""
    lines = ["\n## All pairs together\n", "| tracker | pairs | right | webcams | right | sure | sure and right |"]
    lines.append(f"|---|{'---:|' * 6}")
    everything = [(name, row) for name, rows in found.items() for row in rows]
    for method in sorted({row.method for _, row in everything if row.method not in FLOORS}):
        rows = [row for _, row in everything if row.method == method]
        webcams = [row for name, row in everything if row.method == method and name.startswith("webcams")]
        counts = (sum(row.pairs for row in of) for of in (rows, webcams))
        right = (sum(round(row.right * row.pairs) for row in of) for of in (rows, webcams))
        sure = [row for row in rows if row.sure]
        cells = [number for pair in zip(counts, right, strict=True) for number in pair]
        cells += [sum(row.sure or 0 for row in sure), sum(round(row.sure_right * (row.sure or 0)) for row in sure)]
        lines.append(f"| {method} | {' | '.join(map(str, cells))} |")
    return lines


def table(name: str, rows: list[Row]) -> list[str]:
    """All numbers of one set."""
    lines = [f"\n## {name}, {rows[0].pairs} pairs\n"]
    intervals = any(not pd.isna(row.low) for row in rows)
    heads = (
        "tracker",
        "right, %",
        *(["95 %"] if intervals else []),
        PRECISE,
        "median m",
        "median degrees",
        "refused",
        "wrong",
        "sure",
    )
    lines.append(f"| {' | '.join([*heads, 'sure and right, %', 'seconds'])} |")
    lines.append(f"|---|{'---:|' * (len(heads) + 1)}")
    for row in rows:
        between = "" if pd.isna(row.low) else f"{percent(row.low)} to {percent(row.high)}"
        sure = ("", "") if row.sure is None else (str(row.sure), percent(row.sure_right))
        errors = f"{row.metres:.3f}", f"{row.degrees:.2f}"
        seconds = "" if pd.isna(row.seconds) else f"{row.seconds:.2f}"
        shares = percent(row.right), *([between] if intervals else []), percent(row.precise)
        cells = *shares, *errors, str(row.refused), str(row.wrong), *sure
        lines.append(f"| {' | '.join([row.method, *cells])} | {seconds} |")
    return lines


def percent(share: float) -> str:
    """A share in percent, empty where there is none."""
    return "" if pd.isna(share) else f"{100 * share:.1f}"


if __name__ == "__main__":
    main()

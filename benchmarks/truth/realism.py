"""How well frames of the rendered town can be told from photographs of streets, and by what.

Rendered are the districts of some seeds in the splits for training and validation, three quarters of the frames by day
and the others in rain, snow, fog, at night and on wet roads: each by the ideal camera, and by one that is drawn for the
drive (``--imaging varied``). Photographs are those of --data, by default $RELOCBENCH_REAL_DATA or ../shared/data, in
sets of one camera or source each. All pictures are central squares, scaled to 256 pixels.

The first tables are the errors of a linear classifier on mean activations of EfficientNet-Lite0 with ImageNet's
weights, for each set and each town after training on all others: 50 % would mean that nobody can tell. Then come the
Fréchet distance in the same features, beside that between halves of the photographs and of the towns, and plain
statistics, ranked by how far the town is from the photographs.

    python benchmarks/truth/realism.py [--data DIR] [--work DIR] [--out SHEET.jpg] [--seeds 0,1,2,3] [--before DIR]

Rendered frames are kept in --work, in a folder for each revision of the renderer. With --before, such a folder of an
earlier run, errors and distances are printed as differences, whose intervals are much narrower than those of the values
because both runs have the same towns and photographs. --out shows photographs (left) and rendered frames (right).
Tables go to standard error; the last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import realism_images as pictures
import realism_measures as measures
from realism_images import IMAGINGS, Groups
from realism_measures import WHOLE, Measure

from relocbench.arrays import Array, Image
from relocbench.datasets.core.images import jpeg_bytes
from relocbench.datasets.synthetic.renderer.revision import RENDERER_REVISION
from relocbench.errors import USER_ERROR, RelocbenchError
from relocbench.files import write_bytes

DATA = Path(os.environ.get("RELOCBENCH_REAL_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
KINDS = ("error", "photographs", "frames", "bits")
"""methods of ``Told``"""
_SIDE = 8
"""pictures along each side of both halves of the contact sheet"""


def say(text: str = "") -> None:
    print(text, file=sys.stderr, flush=True)


def described(groups: Groups) -> dict[str, dict[str, Array]]:
    """Rows (N, D) of each part of the features, by group."""
    parts: dict[str, dict[str, Array]] = {}
    for name, images in groups.items():
        for part, rows in measures.described(images).items():
            parts.setdefault(part, {})[name] = rows
    return parts


def measured(real: Groups, towns: Groups) -> tuple[dict[str, Measure], dict[str, Any]]:
    """Functions of the groups by name ("error, stage 7 ..."), and the figures that have no interval of their own."""
    sets, frames = described(real), described(towns)
    found: dict[str, Measure] = {}
    for part in sets:
        told = measures.told_apart(sets[part], frames[part])
        kinds = KINDS if part == WHOLE else ("error", "bits")
        found |= {f"{kind}, {part}": getattr(told, kind) for kind in kinds}
        if part == WHOLE:
            by_group = told.wrong
    distances = measures.Distances(sets[WHOLE], frames[WHOLE])
    found["Fréchet distance"] = distances.all
    return found, {"by_group": by_group, "variance_kept": distances.variance_kept, **distances.halves()}


def compared(real: Groups, rendered: dict[str, Groups], before: dict[str, Groups] | None) -> dict[str, Any]:
    """Values with 95 % intervals and the other figures, by imaging; with ``before`` also differences to it."""
    result: dict[str, Any] = {}
    for imaging, towns in rendered.items():
        groups = [*real], [*towns]
        now, others = measured(real, towns)
        values = {name: [of(*groups), *measures.resampled(of, *groups)] for name, of in now.items()}
        result[imaging] = {"values": values, **others}
        if before is not None:
            then = measured(real, before[imaging])[0]
            result[imaging]["changes"] = {name: _change(of, then[name], groups) for name, of in now.items()}
    return result


def _change(now: Measure, then: Measure, groups: tuple[list[str], list[str]]) -> list[float]:
    def change(sets: Any, towns: Any) -> float:
        return now(sets, towns) - then(sets, towns)

    return [change(*groups), *measures.resampled(change, *groups)]


def ranked(real: Groups, rendered: dict[str, Groups]) -> dict[str, dict[str, Any]]:
    """The effect sizes of all statistics by imaging, the largest of the drawn cameras first."""

    def of(groups: Groups) -> dict[str, dict[str, Array]]:
        rows: dict[str, dict[str, Array]] = {}
        for name, images in groups.items():
            each = [measures.statistics(image) for image in images]
            for key in each[0]:
                rows.setdefault(key, {})[name] = np.array([[values[key]] for values in each])
        return rows

    sets, towns = of(real), {imaging: of(groups) for imaging, groups in rendered.items()}
    table = {k: {i: asdict(measures.effect(sets[k], towns[i][k])) for i in IMAGINGS} for k in sets}
    return dict(sorted(table.items(), key=lambda row: -abs(row[1]["varied"]["size"])))


def print_table(title: str, columns: list[str], rows: dict[str, list[str]]) -> None:
    say(f"\n{title}\n\n| | {' | '.join(columns)} |\n|{'---|' * (len(columns) + 1)}")
    for name, cells in rows.items():
        say(f"| {name} | {' | '.join(cells)} |")


def print_compared(result: dict[str, Any], title: str) -> None:
    """Errors and distances as Markdown tables."""
    first = result[IMAGINGS[0]]
    for key in ("values", "changes"):
        if key in first:
            rows = {n: [_cell(n, each[key][n]) for each in result.values()] for n in first[key]}
            print_table(f"{key}, {title} (percent, bits, squared distance; in brackets 95 %)", [*result], rows)
    rows = {g: [f"{100 * each['by_group'][g]:.1f}" for each in result.values()] for g in first["by_group"]}
    print_table(f"wrong answers for each set and town in percent, {title}, {WHOLE}", [*result], rows)
    rows = {n: [_cell(n, each[n]) for each in result.values()] for n in first if n.endswith("halves")}
    kept = f"{measures.DIMENSIONS} dimensions, {100 * first['variance_kept']:.0f} % of the photographs' variance"
    print_table(f"Fréchet distance of halves, {title}, {kept} (in brackets all ways to part)", [*result], rows)


def print_ranked(table: dict[str, dict[str, Any]]) -> None:
    """The effect sizes as a Markdown table."""
    rows = {}
    for name, row in table.items():
        sizes = [_cell("effect", [row[i]["size"], *row[i]["interval"]]) for i in IMAGINGS]
        rows[name] = [*sizes, *(f"{v:.3f}" for v in (row["ideal"]["real"], *(row[i]["rendered"] for i in IMAGINGS)))]
    title = "rendered minus real in standard deviations of the photographs (in brackets 95 %), and mean values"
    print_table(title, [*IMAGINGS, "photographs", *IMAGINGS], rows)


def _cell(name: str, values: list[float]) -> str:
    percent = name.split(",")[0] in KINDS[:3]
    value, low, high = (f"{100 * v:.1f}" if percent else f"{v:.2f}" for v in values)
    return f"{value} [{low}, {high}]"


def sheet(real: Groups, rendered: Groups) -> Image:
    """Photographs (left) and rendered pictures (right), evenly chosen from all groups."""

    def block(groups: Groups) -> Image:
        every = [image for images in groups.values() for image in images]
        chosen = np.linspace(0, len(every) - 1, _SIDE**2).round().astype(int).reshape(_SIDE, _SIDE)
        return np.vstack([np.hstack([every[k] for k in row]) for row in chosen])

    left, right = block(real), block(rendered)
    return np.hstack([left, np.full((len(left), 16, 3), 255, dtype=np.uint8), right])


def rounded(value: Any) -> Any:
    """The same structure with floats of four digits after the point."""
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each) for each in value]
    return round(value, 4) if isinstance(value, float) else value


def by_imaging(towns: list[pictures.Town], folder: Path, *, render: bool) -> dict[str, Groups]:
    """The pictures of all towns."""
    found: dict[str, Groups] = {imaging: {} for imaging in IMAGINGS}
    for town in towns:
        for imaging, frames in town.frames(folder, render=render).items():
            found[imaging][town.name] = frames
        say(f"{town.name}: {', '.join(town.conditions)}")
    return found


def run(given: argparse.Namespace, work: Path) -> dict[str, Any]:
    """Everything that is measured. Raises DatasetError if pictures are missing, MethodError without the weights."""
    start = time.perf_counter()
    colour = pictures.photographs(given.data, grey=False)
    real = pictures.photographs(given.data, grey=True)
    towns = pictures.towns([int(seed) for seed in given.seeds.split(",")])
    before = by_imaging(towns, given.before, render=False) if given.before is not None else None
    rendered = by_imaging(towns, work / f"revision-{RENDERER_REVISION}", render=True)
    if given.out is not None:
        write_bytes(given.out, jpeg_bytes(sheet(real, rendered["varied"]), 92))
    say(f"comparing after {time.perf_counter() - start:.0f} s")
    grey, grey_before = (
        None if each is None else {i: pictures.without_colour(groups) for i, groups in each.items()}
        for each in (rendered, before)
    )
    assert grey is not None
    result = {
        "colour": compared(colour, rendered, before),
        "grey": compared(pictures.without_colour(real), grey, grey_before),
        "statistics": ranked(colour, rendered),
        "pictures": {name: len(images) for groups in (real, rendered["ideal"]) for name, images in groups.items()},
    }
    say(f"done after {time.perf_counter() - start:.0f} s")
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of recordings")
    parser.add_argument("--work", type=Path, help="folder that keeps the rendered frames (default: a temporary one)")
    parser.add_argument("--out", type=Path, help="JPEG of photographs beside rendered frames")
    parser.add_argument("--seeds", default="0,1,2,3", help="of the towns, each for training and for validation")
    parser.add_argument("--before", type=Path, help="folder WORK/revision-N of an earlier run with the same seeds")
    given = parser.parse_args()
    try:
        with tempfile.TemporaryDirectory(prefix="relocbench-realism-") as scratch:
            result = run(given, given.work or Path(scratch))
    except RelocbenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return USER_ERROR
    print_compared(result["colour"], "in colour")
    print_compared(result["grey"], "in grey, with the grey set")
    print_ranked(result["statistics"])
    print(json.dumps({"benchmark": "realism", **rounded(result)}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

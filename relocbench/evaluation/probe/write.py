"""The files that a probe writes: tables for programs, a page for people, and plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from relocbench.datasets.core.dataset import Dataset
from relocbench.evaluation.common.tables import write_rows
from relocbench.evaluation.probe.table import ACROSS, SAME, Line
from relocbench.evaluation.probe.tally import UNITS, What
from relocbench.files import dump_yaml, write_bytes, write_text
from relocbench.metrics import Interval, Radius, Ratio

SHARE_COLUMNS = (
    *("method", "what", "level", "conditions", "criterion", "unit", "offset"),
    *("pairs", "starts", "share", "share_of_starts"),
)
RADIUS_COLUMNS = (
    *("method", "what", "level", "conditions", "criterion", "unit", "pairs", "radius", "beyond", "low", "high"),
    *("ratio", "ratio_low", "ratio_high"),
    *("from_truth", "half_left", "half_left_beyond", "half_left_low", "half_left_high"),
    *("half_ratio", "half_ratio_low", "half_ratio_high"),
)
_TOO_LOW = 0.1
"""share found from the truth below which the width of a basin is not informative"""
_TITLES: dict[What, str] = {
    "pixels": "Single pixels",
    "translation": "Whole poses, started beside the truth",
    "rotation": "Whole poses, started turned away from the truth",
}


def write_probe(out: Path, dataset: Dataset, lines: Sequence[Line], about: dict[str, Any]) -> list[Path]:
    """Write all files of a probe, each whole or not at all; returns their paths."""
    from relocbench.evaluation.probe.plot import curves_picture, levels_picture  # matplotlib: not for every worker

    out.mkdir(parents=True, exist_ok=True)
    files = {"probe.csv": _shares, "radii.csv": _radii}
    for name, rows in files.items():
        write_rows(out / name, rows(lines))
    pictures = {"curves.png": curves_picture(lines, dataset.name)}
    if any(line.level is not None for line in lines):
        pictures["levels.png"] = levels_picture(lines, dataset.name)
    for name, data in pictures.items():
        write_bytes(out / name, data)
    write_text(out / "probe.yaml", dump_yaml(about))
    write_text(out / "probe.md", probe_page(dataset, lines, list(pictures), about))
    return [out / name for name in ("probe.md", *files, *pictures, "probe.yaml")]


def probe_page(dataset: Dataset, lines: Sequence[Line], pictures: Sequence[str], about: dict[str, Any]) -> str:
    """The Markdown page of a probe."""
    options = about["options"]
    parts = [
        f"# How far off may a method start? {dataset.name}",
        f"Dataset fingerprint {dataset.fingerprint[:12]}; at most {options['pairs']} pairs of each pair set, "
        f"{options['per_pair']} pixels of a pair{_which(options['structured'])}, {options['directions']} priors "
        f"at each offset, seed {options['seed']}. Shares are means over pair sets of means over their pairs; what a "
        "method does not answer counts as not found.",
        "The **radius** is the offset at which the share falls below 50 %, interpolated linearly between the offsets "
        "that were tried; its 95 % interval over pairs is in brackets. It is 0 where fewer "
        "than half are found even from the truth. **Half left** is the offset at which half of what is found from the "
        "truth is left: the width of the basin, to be read together with its height (*from the truth*). A ratio counts "
        "a radius beyond the last offset as that offset; it is blank where both radii are 0, and ratios of widths are "
        f"blank where a method finds less than {100 * _TOO_LOW:g} % from the truth.",
    ]
    for what in _TITLES:
        parts += _section(what, [line for line in lines if line.what == what])
    parts += [f"![{name.removesuffix('.png')}]({name})" for name in pictures]
    return "\n\n".join(parts) + "\n"


def _which(structured: float) -> str:
    return "" if structured == 1 else f" (of the {100 * structured:g} % with most structure)"


def _section(what: What, lines: Sequence[Line]) -> list[str]:
    whole = [line for line in lines if line.level is None]
    if not whole:
        return []
    main = [line for line in whole if line.radius is not None]
    methods = list(dict.fromkeys(line.method for line in main))
    parts = [f"## {_TITLES[what]}", _criterion_text(what, main[0].criterion), _radius_table(what, main, methods)]
    parts += ["### The basin's width, whatever its height", _half_table(what, main, methods)]
    for title in (ACROSS, SAME):
        chosen = [line for line in main if line.conditions == title]
        if chosen:
            parts += [f"### Share by offset, {title}", _share_table(what, chosen)]
    alone = [line for line in lines if line.level is not None and line.radius is not None]
    if alone:
        parts += [
            "### Each level alone",
            "Using a single level of the pyramid (0 is the finest), for ends within 1 px of that level (2^l px of the "
            "image): what is found from the truth, and the offset in pixels of the image at which half of that is "
            "left. Radii are in `radii.csv`.",
            _level_table(alone),
        ]
    return parts


def _criterion_text(what: What, criterion: str) -> str:
    if what == "pixels":
        return (
            f"Found is an end within 1 px of the true pixel (`{criterion}`), by the method's own per-pixel "
            "Gauss-Newton, coarse to fine, from a start in a random direction."
        )
    how = "the camera moved" if what == "translation" else "the camera turned about its centre"
    return f"Found is an answer within 0.25 m and 2° (`{criterion}`), from the true pose with {how} at random."


def _radius_table(what: What, lines: Sequence[Line], methods: Sequence[str]) -> str:
    by = {(line.conditions, line.method): line for line in lines}
    header = ["conditions", "pairs", *(f"{m} ({UNITS[what]})" for m in methods)]
    header += [f"{m} / {methods[0]}" for m in methods[1:]]
    rows = []
    for conditions in dict.fromkeys(line.conditions for line in lines):
        here = [by.get((conditions, m)) for m in methods]
        pairs = next(str(line.pairs) for line in here if line)
        cells = [radius_text(line.radius) if line else "" for line in here]
        rows.append([conditions, pairs, *cells, *(_ratio_text(line.ratio) if line else "" for line in here[1:])])
    return _table(header, rows)


def _half_table(what: What, lines: Sequence[Line], methods: Sequence[str]) -> str:
    by = {(line.conditions, line.method): line for line in lines}

    def ratio(line: Line, first: Line | None) -> str:
        low = first is None or min(line.shares[0], first.shares[0]) < _TOO_LOW
        return "" if low else _ratio_text(line.half_ratio)

    header = ["conditions", *(h for m in methods for h in (f"{m} from the truth", f"half left ({UNITS[what]})"))]
    header += [f"{m} / {methods[0]}" for m in methods[1:]]
    rows = []
    for conditions in dict.fromkeys(line.conditions for line in lines):
        here = [by.get((conditions, m)) for m in methods]
        cells = [c for line in here for c in ((_percent(line), radius_text(line.half_left)) if line else ("", ""))]
        rows.append([conditions, *cells, *(ratio(line, here[0]) if line else "" for line in here[1:])])
    return _table(header, rows)


def _percent(line: Line) -> str:
    return f"{100 * line.shares[0]:.1f} %"


def _share_table(what: What, lines: Sequence[Line]) -> str:
    header = ["method", *(f"{offset:g} {UNITS[what]}" for offset in lines[0].offsets)]
    rows = [[line.method, *(f"{100 * s:.1f}" for s in line.shares)] for line in lines]
    rows.append(["*the starts themselves*", *(f"{100 * s:.1f}" for s in lines[0].start_shares)])
    return _table(header, rows)


def _level_table(lines: Sequence[Line]) -> str:
    levels = sorted({line.level for line in lines if line.level is not None})
    by = {
        (line.conditions, line.method, line.level): f"{_percent(line)}, {radius_text(line.half_left)}" for line in lines
    }
    named = [(c, m) for c, m in dict.fromkeys((line.conditions, line.method) for line in lines) if c in (ACROSS, SAME)]
    rows = [[c, m, *(by.get((c, m, level), "") for level in levels)] for c, m in named]
    return _table(["conditions", "method", *(f"level {level}" for level in levels)], rows, words=2)


def radius_text(radius: Radius | None) -> str:
    """A radius as people read it: ``6.31 [5.90, 6.84]``, or ``> 16`` beyond the largest offset."""
    if radius is None:
        return ""
    value = f"> {radius.value:g}" if radius.beyond else f"{radius.value:.2f}"
    return value if radius.interval is None else f"{value} {_brackets(radius.interval)}"


def _ratio_text(ratio: Ratio | None) -> str:
    if ratio is None or math.isnan(ratio.value):
        return ""
    return f"{ratio.value:.2f}" if ratio.interval is None else f"{ratio.value:.2f} {_brackets(ratio.interval)}"


def _brackets(interval: Interval) -> str:
    return f"[{interval.low:.2f}, {interval.high:.2f}]"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]], words: int = 1) -> str:
    marks = ["---" if index < words else "---:" for index in range(len(header))]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (header, marks, *rows))


def _shares(lines: Sequence[Line]) -> list[Sequence[Any]]:
    rows: list[Sequence[Any]] = [SHARE_COLUMNS]
    for line in lines:
        for k, offset in enumerate(line.offsets):
            shares = (f"{float(s[k]):.6f}" for s in (line.shares, line.start_shares))
            rows.append([*_head(line), f"{offset:g}", line.pairs, line.counts[k], *shares])
    return rows


def _radii(lines: Sequence[Line]) -> list[Sequence[Any]]:
    rows: list[Sequence[Any]] = [RADIUS_COLUMNS]
    for line in lines:
        if line.radius is not None:
            absolute = [*_radius_cells(line.radius), *_ratio_cells(line.ratio)]
            relative = [f"{line.shares[0]:.6f}", *_radius_cells(line.half_left), *_ratio_cells(line.half_ratio)]
            rows.append([*_head(line), line.pairs, *absolute, *relative])
    return rows


def _radius_cells(radius: Radius | None) -> list[str]:
    if radius is None:
        return ["", "", "", ""]
    return [f"{radius.value:.6f}", str(int(radius.beyond)), *_bounds(radius.interval)]


def _ratio_cells(ratio: Ratio | None) -> list[str]:
    return ["", "", ""] if ratio is None else [f"{ratio.value:.6f}", *_bounds(ratio.interval)]


def _head(line: Line) -> list[str]:
    level = "" if line.level is None else str(line.level)
    return [line.method, line.what, level, line.conditions, line.criterion, UNITS[line.what]]


def _bounds(interval: Interval | None) -> list[str]:
    return ["", ""] if interval is None else [f"{interval.low:.6f}", f"{interval.high:.6f}"]

"""The files that a probe writes: tables for programs, a page for people, and plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from relocbench.datasets.core.dataset import Dataset
from relocbench.evaluation.probe.records import RADII, SHARES, STARTS, Radii, SharePoint, StartShares
from relocbench.evaluation.probe.starts import KINDS, StartLine
from relocbench.evaluation.probe.table import ACROSS, SAME, Line
from relocbench.evaluation.probe.tally import UNITS, What
from relocbench.files import dump_yaml, write_bytes, write_text
from relocbench.metrics import Interval, Radius, Ratio, controlled, in_points
from relocbench.pages import render

Numbers = tuple[list[str], list[list[str]]]
"""the header and the rows of a table"""
_TOO_LOW = 0.1
"""share found from the truth below which the width of a basin is not informative"""


def write_probe(
    out: Path, dataset: Dataset, lines: Sequence[Line], starts: Sequence[StartLine], about: dict[str, Any]
) -> list[Path]:
    """Write all files of a probe, each whole or not at all; returns their paths."""
    from relocbench.evaluation.probe.plot import curves_picture, levels_picture  # matplotlib: not for every worker

    out.mkdir(parents=True, exist_ok=True)
    SHARES.write(out / "probe.csv", _shares(lines))
    RADII.write(out / "radii.csv", _radii(lines))
    if starts:
        STARTS.write(out / "starts.csv", _starts(starts))
    pictures = {"curves.png": curves_picture(lines, dataset.name)} if lines else {}
    if any(line.level is not None for line in lines):
        pictures["levels.png"] = levels_picture(lines, dataset.name)
    for name, data in pictures.items():
        write_bytes(out / name, data)
    write_text(out / "probe.yaml", dump_yaml(about))
    write_text(out / "probe.md", probe_page(dataset, lines, starts, list(pictures), about))
    tables = ["probe.csv", "radii.csv", *(["starts.csv"] if starts else [])]
    return [out / name for name in ("probe.md", *tables, *pictures, "probe.yaml")]


def probe_page(
    dataset: Dataset,
    lines: Sequence[Line],
    starts: Sequence[StartLine],
    pictures: Sequence[str],
    about: dict[str, Any],
) -> str:
    """The Markdown page of a probe."""
    by_what = ((what, [line for line in lines if line.what == what]) for what in UNITS)
    return render(
        __name__,
        "page.md.j2",
        dataset=dataset,
        options=about["options"],
        too_low=f"{100 * _TOO_LOW:g}",
        sections=[_section(what, some) for what, some in by_what if any(line.level is None for line in some)],
        starts=_start_table(starts) if starts else None,
        pictures=pictures,
    )


def _section(what: What, lines: Sequence[Line]) -> dict[str, object]:
    main = [line for line in lines if line.level is None and line.radius is not None]
    methods = list(dict.fromkeys(line.method for line in main))
    alone = [line for line in lines if line.level is not None and line.radius is not None]
    by_conditions = ((title, [line for line in main if line.conditions == title]) for title in (ACROSS, SAME))
    return {
        "what": what,
        "criterion": main[0].criterion,
        "radii": _radius_table(what, main, methods),
        "widths": _half_table(what, main, methods),
        "shares": [(title, *_share_table(what, chosen)) for title, chosen in by_conditions if chosen],
        "levels": _level_table(alone) if alone else None,
    }


def _start_table(starts: Sequence[StartLine]) -> Numbers:
    header = ["conditions", "method", "pairs", "keyframe's pose", "mirrored", "random", "keyframe's pose less random"]
    ahead = controlled([s.ahead for s in starts])
    rows = [
        [s.conditions, s.method, str(s.pairs), *(f"{100 * s.shares[kind]:.1f}" for kind in KINDS), in_points(of)]
        for s, of in zip(starts, ahead, strict=True)
    ]
    return header, rows


def _radius_table(what: What, lines: Sequence[Line], methods: Sequence[str]) -> Numbers:
    by = {(line.conditions, line.method): line for line in lines}
    header = ["conditions", "pairs", *(f"{m} ({UNITS[what]})" for m in methods)]
    header += [f"{m} / {methods[0]}" for m in methods[1:]]
    rows = []
    for conditions in dict.fromkeys(line.conditions for line in lines):
        here = [by.get((conditions, m)) for m in methods]
        pairs = next(str(line.pairs) for line in here if line)
        cells = [radius_text(line.radius) if line else "" for line in here]
        rows.append([conditions, pairs, *cells, *(_ratio_text(line.ratio) if line else "" for line in here[1:])])
    return header, rows


def _half_table(what: What, lines: Sequence[Line], methods: Sequence[str]) -> Numbers:
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
    return header, rows


def _percent(line: Line) -> str:
    return f"{100 * line.shares[0]:.1f} %"


def _share_table(what: What, lines: Sequence[Line]) -> Numbers:
    header = ["method", *(f"{offset:g} {UNITS[what]}" for offset in lines[0].offsets)]
    rows = [[line.method, *(f"{100 * s:.1f}" for s in line.shares)] for line in lines]
    rows.append(["*the starts themselves*", *(f"{100 * s:.1f}" for s in lines[0].start_shares)])
    return header, rows


def _level_table(lines: Sequence[Line]) -> Numbers:
    levels = sorted({line.level for line in lines if line.level is not None})
    by = {
        (line.conditions, line.method, line.level): f"{_percent(line)}, {radius_text(line.half_left)}" for line in lines
    }
    named = [(c, m) for c, m in dict.fromkeys((line.conditions, line.method) for line in lines) if c in (ACROSS, SAME)]
    rows = [[c, m, *(by.get((c, m, level), "") for level in levels)] for c, m in named]
    return ["conditions", "method", *(f"level {level}" for level in levels)], rows


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


def _starts(starts: Sequence[StartLine]) -> list[StartShares]:
    out = []
    for s in starts:
        keyframe, mirrored, random = (s.shares[kind] for kind in KINDS)
        low, high = _bounds(s.ahead.interval)
        out.append(
            StartShares(
                s.method, s.conditions, s.criterion, s.pairs, keyframe, mirrored, random, s.ahead.mean, low, high
            )
        )
    return out


def _shares(lines: Sequence[Line]) -> list[SharePoint]:
    return [
        SharePoint(
            *_curve(line), offset, line.pairs, line.counts[k], float(line.shares[k]), float(line.start_shares[k])
        )
        for line in lines
        for k, offset in enumerate(line.offsets)
    ]


def _radii(lines: Sequence[Line]) -> list[Radii]:
    out = []
    for line in lines:
        if line.radius is not None and line.half_left is not None:
            radius, half = line.radius, line.half_left
            values = (
                *(radius.value, radius.beyond, *_bounds(radius.interval), *_ratio(line.ratio)),
                float(line.shares[0]),
                *(half.value, half.beyond, *_bounds(half.interval), *_ratio(line.half_ratio)),
            )
            out.append(RADII.of((*_curve(line), line.pairs, *values)))
    return out


def _ratio(ratio: Ratio | None) -> tuple[float | None, float | None, float | None]:
    return (None, None, None) if ratio is None else (ratio.value, *_bounds(ratio.interval))


def _curve(line: Line) -> tuple[str, str, str, str, str, str]:
    level = "" if line.level is None else str(line.level)
    return line.method, line.what, level, line.conditions, line.criterion, UNITS[line.what]


def _bounds(interval: Interval | None) -> tuple[float | None, float | None]:
    return (None, None) if interval is None else (interval.low, interval.high)

"""``index.html``: the pictures of the ground truth with their numbers, on one page without scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from urllib.parse import quote

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.groundtruth.pairs.reasons import by_kind, common
from relocbench.datasets.groundtruth.report.inspected import InspectedSet, Spot, reason_of
from relocbench.datasets.groundtruth.report.residual_picture import Residuals
from relocbench.files import write_text

_STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; padding: 1rem; max-width: 75rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; overflow-wrap: anywhere; }
figure { margin: 1.5rem 0; } figcaption { font-size: .9rem; margin-bottom: .4rem; overflow-wrap: anywhere; }
img { max-width: 100%; height: auto; display: block; background: #fff; border: 1px solid #8888; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .9rem; }
th, td { border-bottom: 1px solid #8888; padding: .3rem .5rem; text-align: right; vertical-align: top; }
td:not(:first-child) { white-space: nowrap; }
th:first-child, td:first-child { text-align: left; min-width: 8rem; overflow-wrap: anywhere; }
.rejected { font-weight: bold; }
details { margin: 1rem 0; } summary { cursor: pointer; }
""".strip()

_HOW_TO_READ = (
    "<b>Map</b>: each dot is a pair, coloured by the sigma of its position. Each cross is a rejected pair, at the pose "
    "of the query by the graph, or at the keyframe if the graph does not connect the query. The strips below show the "
    "same along the drive.",
    "<b>Overlay</b>: structure of both drives from above; what both have is dark. In the details the small orange dots "
    "must lie within the blue ones; a bar of ten centimetres shows the size of an error. Cars and leaves differ "
    "between drives, walls and poles do not.",
    "<b>Keyframe</b>: numbered corners must be on the same things in both images, edges must continue from square to "
    "square, and the last panel must have no coloured fringes.",
    "<b>Residuals</b>: they should be narrow and centred on zero; a second peak is a surface that moved, or a wrong "
    "pose.",
)


@dataclass(frozen=True, eq=False)
class DrawnSpot:
    """One pair and the paths of its pictures, relative to the page."""

    spot: Spot
    number: int
    overlay: str
    keyframe: str | None
    agrees: bool | None
    """whether grey levels agree best at the ground truth"""


@dataclass(frozen=True, eq=False)
class DrawnSet:
    """One pair set and the paths of its pictures, relative to the page."""

    found: InspectedSet
    residuals: Residuals
    map: str
    spots: tuple[DrawnSpot, ...]


def write_page(path: Path, dataset: Dataset, drawn: Sequence[DrawnSet], residuals: str) -> None:
    """Write the page of all pair sets."""
    title = f"Ground truth of {escape(dataset.name)}"
    parts = [
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{title}</title>\n<style>\n{_STYLE}\n</style>\n</head>\n<body>\n<h1>{title}</h1>",
        f"<p>Fingerprint {escape(dataset.fingerprint[:12])}, licence {escape(dataset.file.licence)}.</p>",
        _summary(drawn),
        "<details><summary>How to read the pictures</summary>\n<ul>",
        *(f"<li>{line}</li>" for line in _HOW_TO_READ),
        "</ul></details>",
        _figure(residuals, "Residuals of the registrations that the graph kept"),
        *(_pair_set(one) for one in drawn),
        "</body>\n</html>\n",
    ]
    write_text(path, "\n".join(parts))


def _summary(drawn: Sequence[DrawnSet]) -> str:
    head = (
        "pair set", "pairs accepted", "rejected", "sigma along / across / height, cm", "sigma of rotation, deg",
        "residual to reference / query, cm", "registrations kept",
    )  # fmt: skip
    rows = []
    for one in drawn:
        pairs = one.found.pair_set.all_pairs
        accepted = [p for p in pairs if p.accepted]
        axes = [_median([p.axis_sigmas[k] for p in accepted], 100.0, 2) for k in range(3)]
        verdicts = one.found.query.verdicts.values()
        values = (
            f'<a href="#{quote(one.found.name)}">{escape(one.found.name)}</a><br>{escape(one.found.conditions)}',
            str(len(accepted)),
            str(len(pairs) - len(accepted)),
            " / ".join(axes),
            _median([p.sigma_rotation_deg for p in accepted], 1.0, 3),
            " / ".join(_number(100 * sigma, 2) for sigma in one.residuals.sigmas_m),
            f"{sum(not v for v in verdicts)} of {len(verdicts)}",
        )
        rows.append(_row("td", values))
    note = "<p>Sigmas are medians over accepted pairs; residuals are robust standard deviations.</p>"
    return f'<div class="wide"><table>\n{_row("th", head)}\n{chr(10).join(rows)}\n</table></div>\n{note}'


def _pair_set(one: DrawnSet) -> str:
    pairs = one.found.pair_set.all_pairs
    accepted = sum(p.accepted for p in pairs)
    parts = [
        f'<h2 id="{escape(one.found.name)}">{escape(one.found.name)}</h2>',
        f"<p>{escape(one.found.conditions)}: {accepted} pairs accepted, {len(pairs) - accepted} rejected.</p>",
        _reasons("Why pairs were rejected", [reason_of(p) for p in pairs if not p.accepted]),
        _reasons("Why the graph refused registrations", [v for v in one.found.query.verdicts.values() if v]),
        _figure(one.map, "Pairs on the road and along the drive"),
    ]
    for drawn in one.spots:
        pair = drawn.spot.pair
        state = "accepted" if pair.accepted else f'<span class="rejected">rejected: {escape(pair.reason)}</span>'
        caption = f"<b>{drawn.number}</b> {escape(drawn.spot.why)}: {state}"
        parts.append(_figure(drawn.overlay, caption))
        if drawn.keyframe is not None:
            where = (
                "at the ground truth"
                if drawn.agrees
                else "at a slightly different rotation, which is usual across light and season: look closely"
            )
            caption = f"<b>{drawn.number}</b> in the images; grey levels agree best {where}"
            parts.append(_figure(drawn.keyframe, caption))
    return "\n".join(part for part in parts if part)


def _reasons(title: str, reasons: list[str]) -> str:
    if not reasons:
        return ""
    rows = [_row("td", (escape(common(same)), str(len(same)))) for same in by_kind(reasons).values()]
    return f'<div class="wide"><table>\n{_row("th", (title, "how many"))}\n{chr(10).join(rows)}\n</table></div>'


def _figure(file: str, caption: str) -> str:
    """HTML of a picture that links to its full size, with a caption in HTML."""
    address = quote(file)
    image = f'<a href="{address}"><img src="{address}" alt="{escape(Path(file).stem)}" loading="lazy"></a>'
    return f"<figure><figcaption>{caption}</figcaption>{image}</figure>"


def _row(cell: str, values: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{cell}>{value}</{cell}>" for value in values) + "</tr>"


def _median(values: Sequence[float | None], factor: float, digits: int) -> str:
    known = [factor * v for v in values if v is not None]
    return _number(float(np.median(known)) if known else float("nan"), digits)


def _number(value: float, digits: int) -> str:
    return "–" if np.isnan(value) else f"{value:.{digits}f}"

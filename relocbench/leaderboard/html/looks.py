"""The look of each method in every chart of the site: colour, dashes and marker, by the sorted labels of all methods.

The six colours were found by a search for the largest difference (CIELAB) between any two of them as seen with normal
vision and with each of three kinds of colour blindness (Machado, Oliveira and Fernandes, "A physiologically-based model
for simulation of color vision deficiency", 2009), among colours with a contrast of 3:1 at least against the background.
"""

from __future__ import annotations

from collections.abc import Collection

LIGHT = ("#2446d8", "#e05206", "#0a9178", "#b25fcf", "#7a2413", "#111827")
"""on white"""
DARK = ("#4d8dff", "#e2653c", "#1fe0a0", "#bb6f9f", "#f2d64b", "#dbeafe")
"""the same places on dark grey"""
DASHES = ("solid", "7px,3px", "2px,2px", "9px,3px,2px,3px", "14px,4px", "9px,3px,2px,3px,2px,3px", "4px,5px", "1px,4px")
MARKERS = (
    "circle",
    "square",
    "diamond",
    "triangle-up",
    "x",
    "triangle-down",
    "pentagon",
    "cross",
    "star",
    "hexagon",
    "triangle-left",
    "triangle-right",
    "bowtie",
)
BASELINE_LIGHT, BASELINE_DARK = "#6b7280", "#9aa3b2"
_BASELINE_DASHES = ("5px,3px", "1px,3px")


def looks(labels: Collection[str], baselines: Collection[str] = ()) -> dict[str, dict[str, str]]:
    """The look of every method by label, as the pages take it.

    No colour occurs twice with the same dashes up to 48 methods; markers differ between neighbours of one colour.

    Args:
        labels: of all methods, in any order.
        baselines: the trivial baselines among them, which are grey.
    """
    methods = sorted(set(labels) - set(baselines))
    out = {label: _look(place) for place, label in enumerate(methods)}
    for place, label in enumerate(sorted(set(baselines))):
        dashes, marker = _BASELINE_DASHES[place % 2], ("circle-open", "square-open")[place % 2]
        out[label] = {"light": BASELINE_LIGHT, "dark": BASELINE_DARK, "dash": dashes, "marker": marker}
    return {label: out[label] for label in sorted(out)}


def further_looks(labels: Collection[str], known: Collection[str]) -> dict[str, dict[str, str]]:
    """The looks of labels that are not among those of the site, which none of the site's methods has.

    Args:
        labels: of methods that have no results, such as those that were only probed.
        known: the labels that :func:`looks` was given.
    """
    further = sorted(set(labels) - set(known))
    return {label: _look(len(set(known)) + place) for place, label in enumerate(further)}


def _look(place: int) -> dict[str, str]:
    colour, dash = place % len(LIGHT), place // len(LIGHT) % len(DASHES)
    return {"light": LIGHT[colour], "dark": DARK[colour], "dash": DASHES[dash], "marker": MARKERS[place % len(MARKERS)]}

"""How a recording is laid out in rerun: a tab for each pair set with the world, both images, errors and words."""

from __future__ import annotations

from collections.abc import Container, Mapping

import rerun.blueprint as rrb

from relocbench.datasets.core.pair_set import PairSet
from relocbench.viewer import paths


def blueprint(
    sets: Mapping[str, PairSet], worlds: Mapping[str, str], *, errors: bool, pictured: Container[str]
) -> rrb.Blueprint:
    """The layout.

    Args:
        sets: name -> pair set, each of which becomes a tab.
        worlds: traversal -> world, as :func:`relocbench.datasets.core.worlds.world_of_traversals` gives them.
        errors: whether methods are shown, and with them their errors.
        pictured: the pair sets with images.
    """
    tabs = [
        _tab(name, pair_set, worlds[pair_set.reference], errors, name in pictured) for name, pair_set in sets.items()
    ]
    return rrb.Blueprint(
        rrb.Tabs(*tabs, name="pair sets") if len(tabs) > 1 else tabs[0],
        rrb.TimePanel(timeline=paths.PAIR_TIMELINE, fps=4.0),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _tab(name: str, pair_set: PairSet, world: str, errors: bool, pictured: bool) -> rrb.Horizontal:
    traversals = dict.fromkeys([pair_set.reference, pair_set.query])
    shown = [f"+ {paths.pair_set(world, name)}/**"]
    shown += [f"+ {paths.traversal(world, traversal)}/**" for traversal in traversals]
    space = rrb.Spatial3DView(origin=paths.world(world), contents=shown, name="poses")
    pictures = rrb.Vertical(
        rrb.Spatial2DView(origin=paths.images(name, paths.KEYFRAME), name="keyframe"),
        rrb.Spatial2DView(origin=paths.images(name, paths.QUERY), name="query"),
    )
    words = rrb.TextDocumentView(origin=paths.words(name), name="this pair")
    if not errors and not pictured:
        return rrb.Horizontal(space, words, column_shares=[2, 1], name=name)
    if not errors:
        return rrb.Horizontal(rrb.Vertical(space, words, row_shares=[3, 1]), pictures, column_shares=[2, 1], name=name)
    curves = [
        rrb.TimeSeriesView(origin=paths.error(what, name), name=title, plot_legend=rrb.PlotLegend(visible=True))
        for what, title in ((paths.METRES, "translation error, m"), (paths.DEGREES, "rotation error, °"))
    ]
    left = rrb.Vertical(space, rrb.Horizontal(*curves), row_shares=[3, 2])
    right = rrb.Vertical(pictures, words, row_shares=[3, 2]) if pictured else rrb.Vertical(words)
    return rrb.Horizontal(left, right, column_shares=[2, 1], name=name)

"""Cross-view sets: the same buildings from a drone, a satellite and the street, in University-1652's layout."""

from relocbench.datasets.cross_view.cross_view_set import CrossViewSet
from relocbench.datasets.cross_view.opening import is_cross_view, open_cross_view

__all__ = ["CrossViewSet", "is_cross_view", "open_cross_view"]

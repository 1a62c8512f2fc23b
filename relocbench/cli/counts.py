"""What ``--json`` counts. Every command prints one JSON object, whose key ``counts`` has whole numbers by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.recording_folder import RecordingFolder
    from relocbench.datasets.cross_view import CrossViewSet

Counts = dict[str, int]


def of_dataset(dataset: Dataset) -> Counts:
    """Traversals, pair sets, and pairs by what became of them."""
    sets = dataset.pair_sets()
    return {
        "traversals": len(dataset.traversal_names),
        "pair_sets": len(sets),
        "pairs": sum(len(s.pairs) for s in sets),
        "pairs_of_different_places": sum(len(s.negative_pairs) for s in sets),
        "rejected": sum(len(s.rejected) for s in sets),
    }


def of_places(places: CrossViewSet) -> Counts:
    """Folders and images of a cross-view set."""
    folders = places.inventory()
    return {"folders": len(folders), "images": sum(folder.images for folder in folders)}


def of_recording(recorded: RecordingFolder) -> Counts:
    """Drives, images and scans."""
    return {
        "drives": len(recorded.drives),
        "images": sum(drive.images for drive in recorded.drives),
        "scans": sum(drive.scans for drive in recorded.drives),
    }


def leaves(values: Mapping[str, Any]) -> int:
    """How many values nested mappings hold."""
    return sum(leaves(value) if isinstance(value, Mapping) else 1 for value in values.values())

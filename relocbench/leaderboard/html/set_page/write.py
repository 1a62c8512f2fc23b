"""Writing what the page of a set draws besides its tables.

``data/charts/SET.js`` holds what all pair sets share; ``data/maps/SET/PAIRSET.js`` where the queries of a pair set
stand, in the order of its errors. A page loads them after its table, maps when they come into sight.
"""

from __future__ import annotations

from pathlib import Path

from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.data import write_data
from relocbench.leaderboard.html.looks import further_looks
from relocbench.leaderboard.html.set_page.maps import Maps
from relocbench.leaderboard.html.set_page.measured import matching_payload, months_apart, probe_payload, probes_of
from relocbench.leaderboard.html.set_page.sweeps import sweep_of
from relocbench.leaderboard.tracking.model import Board, DatasetBoard


def write_charts(board: Board, dataset: DatasetBoard, site: Path) -> set[Path]:
    """Write the payloads of the charts of a set; returns their paths.

    Raises:
        DatasetError: a file of the available dataset is bad.
        PredictionError: a table of a probe is bad.
    """
    entry = dataset.entry
    known = {name: table.keys for name in entry.pair_sets if (table := entry.errors_of(name)) is not None}
    maps = Maps(entry.dataset, list(known)) if entry.dataset is not None and known else None
    written = set()
    if maps is not None:
        for name, keys in known.items():
            places = maps.places(name, [(int(ref), int(query)) for ref, query in keys.tolist()])
            written.add(write_data(site, links.unit_key("maps", entry.record, name), places))
    probes = probes_of(dataset)
    labels = {method.label for method in board.methods}
    payload = {
        "drives": {name: [entry.pair_sets[name].reference, entry.pair_sets[name].query] for name in known},
        "worlds": None if maps is None else maps.worlds(),
        "months": {name: months_apart(entry.pair_sets[name], keys, entry.dataset) for name, keys in known.items()},
        "matching": matching_payload(dataset),
        "probes": [probe_payload(probe) for probe in probes],
        "looks": further_looks({line.points[0].method for probe in probes for line in probe.lines}, labels),
        "sweep": sweep_of(entry.pair_sets, entry.dataset),
    }
    return written | {write_data(site, f"charts/{links.set_id(entry.record)}", payload)}

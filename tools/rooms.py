"""Print how the parts of a package depend on each other: ``python tools/rooms.py relocbench.datasets.groundtruth``.

A room is a folder or module directly in the package. An arrow is an import from one room into another. The level of a
room is one above the highest level of the rooms that it imports from. There is a line for each room, with its level and
the rooms that it imports from, and a last line with the numbers of rooms, levels and arrows.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter

import grimp


def arrows(package: str) -> dict[str, set[str]]:
    """The rooms that each room imports from."""
    graph = grimp.build_graph("relocbench", "baselines", cache_dir=None)
    found: dict[str, set[str]] = defaultdict(set)
    for module in graph.modules:
        if not module.startswith(f"{package}."):
            continue
        room = module.removeprefix(f"{package}.").split(".")[0]
        found[room] |= {
            other.removeprefix(f"{package}.").split(".")[0]
            for other in graph.find_modules_directly_imported_by(module)
            if other.startswith(f"{package}.")
        } - {room}
    return dict(found)


def levels(found: dict[str, set[str]]) -> dict[str, int]:
    """The level of each room.

    Raises:
        graphlib.CycleError: rooms import from each other.
    """
    out: dict[str, int] = {}
    for room in TopologicalSorter(found).static_order():
        out[room] = 1 + max((out[other] for other in found.get(room, ())), default=0)
    return out


def main() -> int:
    package = sys.argv[1] if len(sys.argv) > 1 else "relocbench"
    found = arrows(package)
    try:
        level = levels(found)
    except CycleError as bad:
        print(f"{package}: a cycle: {' -> '.join(bad.args[1])}")
        return 1
    for room in sorted(found, key=lambda room: (-level[room], room)):
        print(f"{level[room]:3} {room:24} {' '.join(sorted(found[room]))}".rstrip())
    print(f"{package}: {len(found)} rooms, {max(level.values())} levels, {sum(map(len, found.values()))} arrows")
    return 0


if __name__ == "__main__":
    sys.exit(main())

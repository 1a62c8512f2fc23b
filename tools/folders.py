"""Print how the folders of a package depend on each other: ``python tools/folders.py relocbench.datasets.groundtruth``.

A folder here is a folder or module directly in the package. The level of a folder is one above the highest level of the
folders that it imports from. There is a line for each folder, with its level and the folders that it imports from, and
a last line with the numbers of folders, of levels and of imports between folders (each pair of folders counts once).
"""

from __future__ import annotations

import sys
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter

import grimp


def imports(package: str) -> dict[str, set[str]]:
    """The folders that each folder imports from."""
    graph = grimp.build_graph("relocbench", "baselines", cache_dir=None)
    found: dict[str, set[str]] = defaultdict(set)
    for module in graph.modules:
        if not module.startswith(f"{package}."):
            continue
        folder = module.removeprefix(f"{package}.").split(".")[0]
        found[folder] |= {
            other.removeprefix(f"{package}.").split(".")[0]
            for other in graph.find_modules_directly_imported_by(module)
            if other.startswith(f"{package}.")
        } - {folder}
    return dict(found)


def levels(found: dict[str, set[str]]) -> dict[str, int]:
    """The level of each folder.

    Raises:
        graphlib.CycleError: folders import from each other.
    """
    out: dict[str, int] = {}
    for folder in TopologicalSorter(found).static_order():
        out[folder] = 1 + max((out[other] for other in found.get(folder, ())), default=0)
    return out


def main() -> int:
    package = sys.argv[1] if len(sys.argv) > 1 else "relocbench"
    found = imports(package)
    if not found:
        print(f"no package '{package}' with folders or modules in it; such as relocbench.datasets", file=sys.stderr)
        return 2
    try:
        level = levels(found)
    except CycleError as bad:
        print(f"{package}: a cycle: {' -> '.join(bad.args[1])}")
        return 1
    for folder in sorted(found, key=lambda folder: (-level[folder], folder)):
        print(f"{level[folder]:3} {folder:24} {' '.join(sorted(found[folder]))}".rstrip())
    count = sum(map(len, found.values()))
    print(f"{package}: {len(found)} folders, {max(level.values())} levels, {count} imports between folders")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""All parsers, and what writes the valid files that they start from."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from fuzz.parser import Parser

AREAS = tuple(
    f"fuzz.{name}"
    for name in (
        "datasets",
        "sensors",
        "bags",
        "recordings",
        "poses",
        "lidar_drives",
        "photos",
        "places",
        "results",
        "records",
        "submissions",
        "methods",
    )
)
"""modules with ``SEEDS`` and ``PARSERS``"""


@dataclass(frozen=True)
class Catalogue:
    """Parsers by name."""

    parsers: Mapping[str, Parser]
    seeds: Mapping[str, Callable[[Path], None]]
    """name -> writes valid files into a folder"""
    areas: str
    """the modules they come from, as a worker is told of them"""


def catalogue_of(areas: str = ",".join(AREAS)) -> Catalogue:
    """The parsers of some modules, whose names are parted by commas.

    Raises:
        ValueError: two modules have valid files of one name.
    """
    modules = [importlib.import_module(name) for name in areas.split(",")]
    parsers = {parser.name: parser for module in modules for parser in module.PARSERS}
    seeds = {name: make for module in modules for name, make in module.SEEDS.items()}
    if len(seeds) < sum(len(module.SEEDS) for module in modules):
        raise ValueError("two modules have valid files of one name")
    return Catalogue(parsers, seeds, areas)

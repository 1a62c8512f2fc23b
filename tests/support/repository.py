"""Where things lie in this repository, for tests of them."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
LIDAR = ROOT / "benchmarks" / "lidar"
DOCS = ROOT / "docs"

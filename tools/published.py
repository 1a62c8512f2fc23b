"""Say of each published page which commit wrote it, by which command, and what has changed since that decides it.

A number that was printed by code that no longer exists need not be wrong, but it cannot be checked. The commit is the
last one that wrote the page; what decides it is the code of the datasets, methods, metrics and pages that it is made
by. The site of the documentation has this table as it was when the site was built (``leaderboard/README.md``).

    python tools/published.py
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PLACE = "<!-- standing of the published pages -->"
"""of the table in ``leaderboard/README.md``"""

_EVALUATION = (
    "relocbench/evaluation/common",
    "relocbench/evaluation/isolation",
    "relocbench/evaluation/tables",
    "relocbench/metrics",
    "relocbench/geometry",
    "relocbench/tracking.py",
)
_TRACKERS = (
    "baselines/alignment",
    "baselines/dso",
    "baselines/feature_pnp",
    "baselines/gn_net",
    "baselines/identity",
    "baselines/learned_pnp",
    "baselines/published_weights.py",
)
_TRACKING = (*_EVALUATION, "relocbench/evaluation/tracking", "relocbench/methods")
_TOWN = ("relocbench/datasets/synthetic", "relocbench/datasets/importers/rendered", "relocbench/datasets/pairs")
_RETRIEVERS = ("baselines/lpn", "baselines/floors", "relocbench/evaluation/retrieval", "relocbench/retrieval.py")
_SMALL_SETS = (
    "tools/build_small_sets.sh",
    "tools/publish_leaderboard.sh",
    "relocbench/datasets/importers/kitti",
    "relocbench/datasets/importers/tum_rgbd",
    "relocbench/datasets/importers/generic",
    "relocbench/datasets/groundtruth/odometry",
    "relocbench/leaderboard/tracking",
    "tools/kitti_lidar_poses.py",
    "tools/real_sets",
    *_TOWN,
    *_TRACKING,
    *_TRACKERS,
)


@dataclass(frozen=True)
class Page:
    """A published page."""

    path: str
    command: str
    """that makes it again"""
    decided_by: tuple[str, ...]
    """files and folders whose code decides the numbers"""


def page_of_edition(path: Path) -> Page:
    """The page ``EDITION-SPLIT.md``."""
    edition, _, split = path.stem.rpartition("-")
    return Page(
        path.relative_to(ROOT).as_posix(),
        f"make leaderboard-edition EDITION={edition} SPLIT={split}",
        (
            "benchmarks/publish/edition_page.py",
            "benchmarks/publish/tiers.py",
            "benchmarks/publish/groups.py",
            "relocbench/datasets/importers/edition",
            *_TOWN,
            *_TRACKING,
            *_TRACKERS,
        ),
    )


PAGES = (
    Page("leaderboard/leaderboard.md", "make leaderboard RECORDINGS=FOLDER", _SMALL_SETS),
    Page(
        "leaderboard/real/real.md",
        "make leaderboard RECORDINGS=FOLDER",
        ("benchmarks/publish/real.py", *_SMALL_SETS),
    ),
    Page(
        "leaderboard/real/michigan.md",
        "make leaderboard RECORDINGS=FOLDER",
        ("benchmarks/publish/shifts.py", *_SMALL_SETS),
    ),
    Page(
        "leaderboard/real/webcams_probe/probe.md",
        "make leaderboard RECORDINGS=FOLDER",
        ("relocbench/evaluation/probe", *_SMALL_SETS),
    ),
    Page(
        "leaderboard/relocalization/relocalization.md",
        "make leaderboard-relocalization",
        (
            "benchmarks/publish/relocalization.py",
            "relocbench/evaluation/relocalization",
            "relocbench/leaderboard/relocalization",
            *_TOWN,
            *_TRACKING,
            *_TRACKERS,
            *_RETRIEVERS,
        ),
    ),
    *(
        Page(
            f"leaderboard/retrieval/{run}lpn_configurations.md",
            "make leaderboard-retrieval",
            (
                "tools/publish_retrieval.sh",
                "benchmarks/publish/lpn_configurations.py",
                "benchmarks/publish/lpn_order.py",
                "relocbench/datasets/cross_view",
                "baselines/training",
                *_EVALUATION,
                *_RETRIEVERS,
            ),
        )
        for run in ("", "frozen/")
    ),
    Page(
        "leaderboard/retrieval/real/retrieval.md",
        "make leaderboard-retrieval SAMPLE=FOLDER",
        ("tools/publish_retrieval.sh", "relocbench/datasets/cross_view", *_EVALUATION, *_RETRIEVERS),
    ),
    *map(page_of_edition, sorted((ROOT / "leaderboard" / "edition").glob("*.md"))),
)


@dataclass(frozen=True)
class Standing:
    """How a page stands to the code of today."""

    page: Page
    commit: str
    """the last one that wrote the page, and its date; ``none yet`` where it is made and not committed"""
    changed: int
    """files that decide the page and differ from that commit"""


def standings() -> Iterator[Standing]:
    """Yield the standing of every page. Raises CalledProcessError where this is no repository with its history."""
    for page in PAGES:
        commit = _git("log", "-1", "--format=%h of %ad", "--date=short", "--", page.path)
        since = commit.split()[0] if commit else "HEAD"
        changed = _git("diff", "--name-only", since, "--", *page.decided_by).splitlines()
        yield Standing(page, commit or "none yet", len([name for name in changed if name.endswith((".py", ".sh"))]))


def table() -> str:
    """The standings as a Markdown table."""
    lines = ["| page | last written by commit | files that decide it, changed since | command |", "|---|---|---:|---|"]
    for one in standings():
        lines.append(f"| `{one.page.path}` | {one.commit} | {one.changed or 'none'} | `{one.page.command}` |")
    return "\n".join(lines)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Fill the table in when the documentation is built (a hook of mkdocs)."""
    if PLACE not in markdown:
        return markdown
    try:
        return markdown.replace(PLACE, table())
    except (OSError, subprocess.CalledProcessError):
        return markdown.replace(PLACE, "*The pages were built without the history of the repository.*")


def _git(*words: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *words], check=True, capture_output=True, text=True)
    return done.stdout.strip()


if __name__ == "__main__":
    print(table())

"""Recompute the published pages, and say of each whether the same bytes come out.

Without recordings, pages are printed again from the errors that are published beside them. With recordings, the
small datasets are built again from their recipes, every error is computed anew from the published predictions, and the
pages are printed from these. With ``--render`` the same is done for retrieval, for the full pipeline, and for editions,
whose districts take hours to render.

    python tools/recompute.py [--recordings FOLDER] [--render] [--scratch FOLDER] [--leaderboard leaderboard]

Ends with 1 where a page differs. What cannot be recomputed is said, with the reason, and is no difference.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import published

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks" / "publish"))
import archives  # noqa: E402  from the folder above

_COMMIT = re.compile(r"Printed by commit\s+[0-9a-f]+\+?")
"""which is another one each time"""
_PREDICTIONS = "from predictions"
_TABLES = ("leaderboard.csv", "datasets.csv", "errors.csv", "matching.csv", "truth.csv")


class Finding(NamedTuple):
    """What became of a page."""

    page: str
    """below the folder of the leaderboard"""
    source: str
    outcome: str
    differs: bool = False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, help="folder, as tools/publish_leaderboard.sh says")
    parser.add_argument("--render", action="store_true", help="render districts, those of editions for hours")
    parser.add_argument("--scratch", type=Path, help="folder for datasets and pages; by default a temporary one")
    parser.add_argument("--leaderboard", type=Path, default=ROOT / "leaderboard")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        scratch = (options.scratch or Path(temporary)).resolve()
        found = []
        for finding in findings(options.leaderboard.resolve(), scratch, options.recordings, options.render):
            print(f"{finding.page}: {finding.source}: {finding.outcome}", flush=True)
            found.append(finding)
    sys.exit(1 if any(finding.differs for finding in found) else 0)


def findings(leaderboard: Path, scratch: Path, recordings: Path | None, render: bool) -> Iterator[Finding]:
    """What becomes of each published page, from errors and from predictions."""
    for path in sorted((leaderboard / "edition").glob("*.md")):
        yield from edition(path, scratch, render)
    handled: dict[str, Callable[[], Iterator[Finding]]] = {
        "leaderboard.md": lambda: small_sets(leaderboard, scratch, recordings),
        "real/real.md": lambda: real(leaderboard, scratch),
        "real/michigan.md": lambda: shifts(leaderboard, scratch, recordings),
        "relocalization/relocalization.md": lambda: relocalization(leaderboard, scratch, render),
        "retrieval/lpn_configurations.md": lambda: retrieval(leaderboard, scratch, recordings, render),
    }
    for page in published.PAGES:
        name = page.path.removeprefix("leaderboard/")
        if name in handled:
            yield from handled[name]()
        elif not name.startswith(("edition/", "retrieval/")):
            reason = (
                f"cannot be recomputed: neither predictions nor errors are published; `{page.command}` evaluates anew"
            )
            yield Finding(name, "from what is published", reason)


def relocalization(leaderboard: Path, scratch: Path, render: bool, *options: object) -> Iterator[Finding]:
    """The pages of the full pipeline, from predictions and the districts, rendered with ``options``."""
    folder = leaderboard / "relocalization"
    archive, page = folder / "predictions.tar.xz", "relocalization/relocalization.md"
    if not archive.is_file():
        again = "`make leaderboard-relocalization` evaluates anew"
        yield Finding(page, _PREDICTIONS, f"cannot be recomputed: no predictions published; {again}")
        return
    if not render:
        yield Finding(page, _PREDICTIONS, "not recomputed: no --render to render its district")
        return
    words = ("--published", archive, "--scratch", scratch / "pipelines", "--out", scratch / "relocalization", *options)
    _run("benchmarks/publish/relocalization.py", *words)
    for path in sorted({*folder.glob("*.md"), *folder.glob("*.csv")}):
        page = f"relocalization/{path.name}"
        yield compared(page, _PREDICTIONS, path, scratch / page)


def retrieval(leaderboard: Path, scratch: Path, recordings: Path | None, render: bool) -> Iterator[Finding]:
    """The pages of retrieval across views, from ranks and rendered places, and of real pairs where they are at hand."""
    folder, again = leaderboard / "retrieval", scratch / "retrieval_pages"
    sample = None if recordings is None else recordings / "university1652_sample"
    pages = [path.relative_to(folder) for path in sorted({*folder.rglob("*.md"), *folder.rglob("*.csv")})]
    missing = any(not any((folder / page).parent.glob("*.tar.xz")) for page in pages)
    run = render and not missing
    if run:
        script = ROOT / "tools" / "publish_retrieval.sh"
        subprocess.run([script, scratch / "retrieval", sample or "", folder, again], check=True, stdout=sys.stderr)
    for page in pages:
        name = f"retrieval/{page}"
        if missing:
            told = "cannot be recomputed: no ranks published; `make leaderboard-retrieval` trains and evaluates anew"
            yield Finding(name, _PREDICTIONS, told)
        elif not run or (sample is None and "real" in page.parts):
            told = "not recomputed: no --render to render places" if not run else "not recomputed: no --recordings"
            yield Finding(name, _PREDICTIONS, told)
        else:
            yield compared(name, _PREDICTIONS, folder / page, again / page)


def edition(page: Path, scratch: Path, render: bool) -> Iterator[Finding]:
    """The page of an edition, from errors and, where districts are rendered again, from predictions."""
    yield edition_again(page, scratch)
    if not render:
        yield Finding(f"edition/{page.name}", _PREDICTIONS, "not recomputed: no --render to render districts (hours)")
        return
    name, _, split = page.stem.rpartition("-")
    words = ("build-dataset", "edition", name, "--split", split, "--out", scratch / page.stem, "-q")
    _run("-m", "relocbench", *words)
    yield edition_again(page, scratch, scratch / page.stem)


def edition_again(page: Path, scratch: Path, datasets: Path | None = None) -> Finding:
    """The page of an edition from the errors of its archives, or from their predictions and the truth of datasets."""
    name, _, split = page.stem.rpartition("-")
    words = ("--edition", name, "--split", split, "--predictions", page.parent / "predictions" / page.stem)
    out = scratch / "edition" / ("from_errors" if datasets is None else "from_predictions")
    truth = () if datasets is None else ("--datasets", datasets)
    of, source = f"edition/{page.name}", "from published errors" if datasets is None else _PREDICTIONS
    asked = ["benchmarks/publish/edition_page.py", "--only-print", *words, *truth, "--out", out]
    fault = _fault(*asked)
    return (
        Finding(of, source, f"differs: {fault}", differs=True) if fault else compared(of, source, page, out / page.name)
    )


def small_sets(leaderboard: Path, scratch: Path, recordings: Path | None) -> Iterator[Finding]:
    """The tables of the small sets, from published errors, and from predictions and recipes."""
    if not any((leaderboard / "predictions").glob("*/*.tar.xz")):
        yield Finding("leaderboard.md", _PREDICTIONS, "cannot be recomputed: no predictions published")
        return
    again = scratch / "from_errors"
    shutil.copytree(leaderboard, again, dirs_exist_ok=True)
    _run("tools/rewrite_board.py", again)
    yield from _of_board(leaderboard, again, "from published errors")
    if recordings is None:
        yield Finding("leaderboard.md", _PREDICTIONS, "not recomputed: no --recordings to build datasets from")
    else:
        subprocess.run([ROOT / "tools" / "build_small_sets.sh", recordings, scratch], check=True, stdout=sys.stderr)
        yield from from_predictions(leaderboard, scratch, scratch)


def from_predictions(leaderboard: Path, datasets: Path, scratch: Path) -> Iterator[Finding]:
    """The tables of the small sets, every error computed anew from published predictions and the truth of datasets."""
    results = archives.unpack(leaderboard / "predictions", scratch / "results")
    board = scratch / "from_predictions"
    fault = _fault("-m", "relocbench", "leaderboard", results, "--dataset", datasets, "--out", board, "-q")
    if fault:
        yield Finding("leaderboard.md", _PREDICTIONS, f"differs: {fault}", differs=True)
        return
    yield from _of_board(leaderboard, board, _PREDICTIONS)


def _of_board(leaderboard: Path, again: Path, source: str) -> Iterator[Finding]:
    sets = {f"sets/{path.name}" for folder in (leaderboard, again) for path in (folder / "sets").glob("*.md")}
    there = [name for name in _TABLES if (leaderboard / name).exists() or (again / name).exists()]
    for name in ("leaderboard.md", "reading.md", *there, *sorted(sets)):
        yield compared(name, source, leaderboard / name, again / name)


def real(leaderboard: Path, scratch: Path) -> Iterator[Finding]:
    """The page of the real recordings, from the table of the small sets."""
    page = "real/real.md"
    _run("benchmarks/publish/real.py", "--board", leaderboard, "--out", scratch / "real")
    yield compared(page, "from leaderboard.csv", leaderboard / page, scratch / "real" / "real.md")


def shifts(leaderboard: Path, scratch: Path, recordings: Path | None) -> Iterator[Finding]:
    """The page of known shifts, from predictions and the dataset that is built with the small sets."""
    page = "real/michigan.md"
    if recordings is None:
        yield Finding(page, _PREDICTIONS, "not recomputed: no --recordings to build the dataset from")
        return
    results = archives.unpack(leaderboard / "real" / "predictions", scratch / "shifts")
    _run("benchmarks/publish/shifts.py", scratch / "michigan", results, "--out", scratch / "real")
    yield compared(page, _PREDICTIONS, leaderboard / page, scratch / page)


def compared(page: str, source: str, old: Path, new: Path) -> Finding:
    """Whether a page has the published bytes, but for the commit that printed it, and else from which line on not."""
    for path, fault in ((old, "not published"), (new, "not printed again")):
        if not path.is_file():
            return Finding(page, source, f"differs: {fault}", differs=True)
    was, now = (_COMMIT.sub("", path.read_text(encoding="utf-8")).splitlines() for path in (old, new))
    if was == now:
        return Finding(page, source, "byte-equal")
    lines = (n for n, pair in enumerate(zip(was, now, strict=False), start=1) if pair[0] != pair[1])
    first = next(lines, min(len(was), len(now)) + 1)
    return Finding(page, source, f"differs from line {first} on", differs=True)


def _fault(*words: object) -> str:
    """Run Python in the repository: what it says where it ends with an error, and else nothing."""
    done = subprocess.run([sys.executable, *map(str, words)], cwd=ROOT, check=False, capture_output=True, text=True)
    return (done.stderr.strip() or f"ended with {done.returncode}") if done.returncode else ""


def _run(*words: object) -> None:
    """Run Python in the repository; what it prints goes to standard error."""
    subprocess.run([sys.executable, *map(str, words)], cwd=ROOT, check=True, stdout=sys.stderr)


if __name__ == "__main__":
    main()

"""``python -m fuzz``: many inputs for all parsers, or one kept input again."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from fuzz.catalogue import Catalogue, catalogue_of
from fuzz.folders import copy_tree
from fuzz.parser import Place
from fuzz.run import Outcome, fuzz


def main() -> int:
    given = _arguments()
    known = catalogue_of()
    if given.again is not None:
        return _again(known, given.again)
    chosen = _chosen(known, given.only)
    each = -(-given.inputs // len(chosen)) if given.seconds is None else 10**6
    with tempfile.TemporaryDirectory(prefix="relocbench-fuzz-") as scratch:
        seeds = Path(scratch) / "seeds"
        outcome = fuzz(
            known,
            seeds,
            Path(scratch) / "work",
            chosen,
            inputs=each,
            first=given.first,
            seed=given.seed,
            jobs=given.jobs,
            seconds=given.seconds,
            keep=given.keep,
            say=lambda text: print(text, file=sys.stderr, flush=True),
        )
    _print(outcome, given.keep)
    print(json.dumps({"seed": given.seed, **outcome.summary()}))
    return 1 if outcome.failed else 0


def _arguments() -> argparse.Namespace:
    reader = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    reader.add_argument("--inputs", type=int, default=20_000, help="of all parsers together [default: 20000]")
    reader.add_argument("--seconds", type=float, help="go on for so long, whatever --inputs says")
    reader.add_argument("--seed", type=int, default=0, help="another seed gives other inputs [default: 0]")
    reader.add_argument("--first", type=int, default=0, help="number of each parser's first input [default: 0]")
    reader.add_argument("--jobs", type=int, default=2, help="worker processes [default: 2]")
    reader.add_argument("--only", default="", help="parsers, by parts of their names: ply,pcd")
    reader.add_argument("--keep", type=Path, default=Path("fuzz-failures"), help="folder for inputs that fail")
    reader.add_argument("--again", type=Path, help="a folder of --keep: read its input once more, in this process")
    return reader.parse_args()


def _chosen(known: Catalogue, only: str) -> list[str]:
    parts = [part.strip() for part in only.split(",") if part.strip()]
    chosen = [name for name in known.parsers if not parts or any(part in name for part in parts)]
    if not chosen:
        sys.exit(f"no parser is called so; available: {', '.join(known.parsers)}")
    return chosen


def _again(known: Catalogue, kept: Path) -> int:
    """Read a kept input without any guard, so that a debugger sees what happens."""
    about = json.loads((kept / "case.json").read_text())
    parser = known.parsers[about["parser"]]
    with tempfile.TemporaryDirectory(prefix="relocbench-fuzz-") as scratch:
        root, out = Path(scratch) / "in", Path(scratch) / "out"
        copy_tree(kept / "input", root)
        out.mkdir()
        for line in parser.read(Place(root, root / about["target"], out)) or ():
            print(line)
    print("was read to the end")
    return 0


def _print(outcome: Outcome, keep: Path) -> None:
    print(outcome.table())
    for fault in sorted(outcome.faults.values(), key=lambda f: -f.parsers.total()):
        first = fault.cases[0]
        of = ", ".join(f"{name} {count}" for name, count in fault.parsers.most_common(4))
        print(f"\n{fault.kind}: {fault.where} ({of})")
        print(f"  {keep / f'{first.parser}-{first.seed}-{first.number}'}")
        last = [line for line in fault.detail.splitlines() if line.strip()]
        print(f"  {ascii(last[-1])[:300] if last else ''}")


if __name__ == "__main__":
    sys.exit(main())

"""The process that reads inputs, and may die of them: ``python -m fuzz.worker CATALOGUE SEEDS SCRATCH REPORT``.

Each line of standard input asks for a stretch of inputs of one parser. The file descriptor ``REPORT`` gets a line when
an input is begun and one when it is judged, so that whoever watches knows which input a process died of.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import re
import resource
import shutil
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from fuzz.case import Case, damage, targets
from fuzz.catalogue import Catalogue, catalogue_of
from fuzz.folders import Look, copy_tree, empty, look, restore
from fuzz.judge import ACCEPTED, MOST_MIB, Verdict, judge
from fuzz.parser import Parser, Place

STRANGERS = ("images", "clouds", "kitti", "four-seasons", "robotcar", "program")
"""valid files that are quick to write; always the same, so that inputs do not depend on which parsers are chosen"""
_STRANGER_BYTES = 20_000


@dataclass
class Desk:
    """A worker's folders: the input, what a reader writes, and two in which nothing may ever change."""

    scratch: Path
    laid: tuple[Path, Look] | None = None
    """the valid files that lie in ``root``, and what they looked like there"""

    @property
    def root(self) -> Path:
        return self.scratch / "in"

    @property
    def out(self) -> Path:
        return self.scratch / "work" / "out"

    @property
    def canary(self) -> Path:
        return self.scratch / "canary"

    @property
    def current(self) -> Path:
        """Where the process stands."""
        return self.scratch / "current"

    def lay(self) -> None:
        """Make the folders anew."""
        if self.scratch.exists():
            shutil.rmtree(self.scratch)
        self.laid = None
        for folder in (self.out, self.canary, self.current):
            folder.mkdir(parents=True)
        (self.canary / "here").write_text("sings\n")
        (self.scratch / "work" / "beside").write_text("stays\n")

    def fresh(self, valid: Path) -> None:
        """The valid files once more, and nothing else; what has not changed stays."""
        if not self.out.is_dir() or self.out.is_symlink():
            self.lay()
        empty(self.out)
        if self.laid is None or self.laid[0] != valid or not self.root.is_dir():
            if self.root.exists():
                shutil.rmtree(self.root)
            copy_tree(valid, self.root)
        elif not restore(self.root, valid, self.laid[1]):
            return
        self.laid = valid, look(self.root)

    @property
    def fences(self) -> tuple[Path, ...]:
        return self.canary, self.current

    def strays(self) -> str:
        """What stands where nothing may, beside the folders."""
        wanted = {self.scratch: {"in", "work", "canary", "current"}, self.scratch / "work": {"out", "beside"}}
        for folder, names in wanted.items():
            more = {path.name for path in folder.iterdir()} ^ names
            if more:
                return f"{folder}: {', '.join(map(repr, sorted(more)))}"
        return ""


def laid_out(parser: Parser, case: Case, desk: Desk, valid: Path, others: list[bytes]) -> Place:
    """Put an input on the desk."""
    desk.fresh(valid)
    return Place(desk.root, damage(parser, case, desk.root, valid, others, desk.canary), desk.out)


def verdict_on(parser: Parser, place: Place, desk: Desk) -> Verdict:
    """Let the parser read what lies on the desk."""
    verdict = judge(parser, place, desk.fences)
    stray = desk.strays()
    if stray:
        verdict = Verdict("wrote", "beside", stray, verdict.seconds, verdict.mib)
        desk.lay()
    return verdict


def verdict_on_valid(parser: Parser, desk: Desk, valid: Path) -> Verdict:
    """The first verdict on the valid files that does not take them, or one that does."""
    found = Verdict(ACCEPTED)
    for path in _samples(parser, valid):
        desk.fresh(valid)
        found = verdict_on(parser, Place(desk.root, desk.root / path, desk.out), desk)
        if found.kind != ACCEPTED:
            return replace(found, kind="seed", where=f"{found.kind} {found.where}")
    return found


def _samples(parser: Parser, valid: Path) -> list[Path]:
    """Files to read undamaged first: all that are read in a way of their own, as far as their names tell."""
    found = targets(parser, valid)
    return list({re.sub(r"[0-9]+", "0", path.name): path for path in found}.values())[: 1 if parser.names else 12]


def main() -> None:
    known = catalogue_of(sys.argv[1])
    seeds, scratch, report = Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4])
    desk = Desk(scratch)
    desk.lay()
    os.chdir(desk.current)
    faulthandler.enable()
    faulthandler.register(signal.SIGUSR1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    others: list[bytes] = []
    with os.fdopen(report, "w", buffering=1) as stream:
        for line in sys.stdin:
            asked = json.loads(line)
            if "write" in asked:
                _tell(stream, {"begin": -1})
                write_seeds(known, seeds, asked["write"])
                _tell(stream, {"done": True})
                continue
            others = others or strangers(seeds)
            parser = known.parsers[asked["parser"]]
            valid = seeds / parser.seed
            _limit_memory(None)
            _tell(stream, {"begin": -1})
            # The first reading loads libraries: what it takes is not the input's.
            valid_read = verdict_on_valid(parser, desk, valid)
            if valid_read.kind != ACCEPTED:
                _tell(stream, {"end": -1, **asdict(valid_read)})
            for number in range(asked["first"], asked["first"] + asked["count"]):
                _limit_memory(None)
                place = laid_out(parser, Case(parser.name, asked["seed"], number), desk, valid, others)
                _limit_memory(MOST_MIB)
                _tell(stream, {"begin": number})
                _tell(stream, {"end": number, **asdict(verdict_on(parser, place, desk))})
            _tell(stream, {"done": True})


def write_seeds(known: Catalogue, folder: Path, parsers: Sequence[str]) -> None:
    """The valid files of some parsers, and of :data:`STRANGERS`, as ``FOLDER/SEED``; one that is there is kept."""
    wanted = [known.parsers[parser].seed for parser in parsers]
    for name in dict.fromkeys([*wanted, *(name for name in STRANGERS if name in known.seeds)]):
        if not (folder / name).exists():
            part = folder / f".{name}"
            shutil.rmtree(part, ignore_errors=True)
            part.mkdir(parents=True)
            known.seeds[name](part)
            part.rename(folder / name)


def strangers(seeds: Path) -> list[bytes]:
    """Files of several formats, each of which may stand in the place of any other file."""
    found = [path for name in STRANGERS for path in sorted((seeds / name).rglob("*")) if path.is_file()]
    return [path.read_bytes() for path in found if path.stat().st_size < _STRANGER_BYTES]


def _tell(stream: object, values: dict[str, object]) -> None:
    print(json.dumps(values), file=stream, flush=True)  # type: ignore[call-overload]


def _limit_memory(mib: int | None) -> None:
    """Let the process take so much more than it has; None: as much as it likes."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    soft = hard if mib is None else _private_bytes() + (mib << 20)
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _private_bytes() -> int:
    found = re.search(r"VmData:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return int(found[1]) * 1024 if found else 0


def stretches(count: int, size: int) -> Iterator[tuple[int, int]]:
    """(first, count) of the parts of ``count`` inputs."""
    for first in range(0, count, size):
        yield first, min(size, count - first)


if __name__ == "__main__":
    main()

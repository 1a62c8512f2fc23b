"""Run a tutorial as its reader would: what it types, what it writes into files, and whether it prints what is shown.

The blocks of a page mean:

- ``bash``: typed into one shell, from the top of the page to its end
- ``python title="NAME"`` and so on: the content of the file NAME
- ``python`` without a title: typed into Python
- ``text`` after one of these: what it prints, the errors among it. Three dots stand for lines that are left out.

Numbers may differ as they do between processors, and seconds and fingerprints altogether.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from repository import ROOT

sys.path.insert(0, str(ROOT / "tools"))
import check_docs

_MARK = "@@ block "
_END = f"{_MARK}end"
_STOPPED = f"{_MARK}stopped"
"""printed when the shell ends: what a page left in the background may hold its output open"""
_SHOWN_ONLY = {"toml", ""}
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?![\w])")
_HASH = re.compile(r"\b[0-9a-f]{12,64}\b")
_SECONDS = re.compile(r"\b\d+(?:\.\d+)? (?:s|ms)\b")
_NEAR, _NEAR_ERROR = 0.22, 0.5


@dataclass(frozen=True)
class Step:
    """A block that does something, and what the page says that it prints."""

    block: check_docs.CodeBlock
    shown: tuple[str, ...]


def steps(page: Path) -> list[Step]:
    """The steps of a tutorial. Raises ValueError for a block that is neither done nor shown by a step."""
    found: list[Step] = []
    for block in check_docs.code_blocks(page):
        if block.language == "text":
            if not found or found[-1].shown or found[-1].block.title:
                raise ValueError(f"{page.name}:{block.line}: output of no command")
            found[-1] = Step(found[-1].block, block.lines)
        elif block.language in ("bash", "python") or block.title:
            found.append(Step(block, ()))
        elif block.language not in _SHOWN_ONLY:
            raise ValueError(f"{page.name}:{block.line}: a block '{block.language}' without a title")
    return found


def run(page: Path, folder: Path) -> list[list[str]]:
    """What each step of a page printed, run in a folder. Raises AssertionError where the shell ends early."""
    work = steps(page)
    script = "\n".join(f"echo '{_MARK}{index}'\n{_typed(step.block)}" for index, step in enumerate(work))
    script = f"trap \"echo '{_STOPPED}'\" EXIT\n{script}\necho '{_END}'"
    shell = subprocess.Popen(
        # On one core commands without --workers start one, since other tests use the other cores.
        ["taskset", "--cpu-list", str(min(os.sched_getaffinity(0))), "bash", "-e", "-c", script],
        cwd=folder,
        env=environment(folder),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        assert shell.stdout is not None
        lines = []
        for line in shell.stdout:
            if line.startswith(_STOPPED):
                break
            lines.append(line.rstrip("\n"))
            if line.startswith(_END):
                break
        printed = _by_step(lines)
        assert lines[-1:] == [_END], f"{page.name}:{work[len(printed) - 1].block.line} failed:\n" + "\n".join(
            printed[-1][-30:] if printed else lines
        )
        return printed
    finally:
        os.killpg(shell.pid, signal.SIGTERM)  # what the page left in the background goes, too
        shell.wait()


def missing_lines(shown: tuple[str, ...], printed: list[str]) -> list[str]:
    """The shown lines that were not printed, or not in this order.

    Rows of one table may be in another order, by which another processor's numbers rank methods that are about level.
    """
    missing = []
    after = 0  # the line behind the last one that was found
    seconds_last = in_table = False
    for line in shown:
        if line.strip() in ("", "...", "…"):
            continue
        seconds_last = re.search(r"seconds\s*┃?\s*$", line) is not None or (seconds_last and _is_row(line))
        wanted = _plain(line, seconds_last=seconds_last)
        first = after
        while in_table and _is_row(line) and first > 0 and _is_row(printed[first - 1]):
            first -= 1
        in_table = _is_row(line)
        same = (i for i in range(first, len(printed)) if _same(wanted, _plain(printed[i], seconds_last=seconds_last)))
        found = next(same, None)
        if found is None:
            missing.append(line)
        after = len(printed) if found is None else max(after, found + 1)
    return missing


def _same(wanted: str, got: str) -> bool:
    if _is_row(wanted) and _is_row(got) and wanted.split()[1:2] == got.split()[1:2] == ["random"]:
        # The draws follow from the dataset's fingerprint, and so from images whose last bits another processor renders.
        return True
    if _NUMBER.sub("#", wanted).split() != _NUMBER.sub("#", got).split():
        return False
    pairs = zip(_NUMBER.findall(wanted), _NUMBER.findall(got), strict=True)
    return all(abs(float(a) - float(b)) <= _tolerance(a) for a, b in pairs)


def _tolerance(number: str) -> float:
    """How far another processor's number may be off; whole numbers are counts.

    A share some fifth, and a half what has three decimals, errors in metres and degrees: the median of the few pairs of
    a page moves from one of them to the next. At least two of the last digit.
    """
    decimals = number.partition(".")[2]
    near = _NEAR_ERROR if len(decimals) == 3 else _NEAR
    return max(near * abs(float(number)), 2 * 10.0 ** -len(decimals)) if decimals else 0.0


def _is_row(line: str) -> bool:
    return line.lstrip()[:1] in ("│", "┃", "┡", "┏", "└", "|")


def _plain(line: str, *, seconds_last: bool) -> str:
    """A line without what differs from run to run: seconds, fingerprints, the lines of a table's frame."""
    line = _HASH.sub("HASH", _SECONDS.sub("SECONDS", line))
    line = re.sub(r"[━─┏┓┳┡┩╇└┘┴]+", "-", line)
    if seconds_last and line.count("│") > 2:
        cells = line.rstrip().rstrip("│").split("│")
        line = "│".join([*cells[:-1], " TIME "])
    return line.strip()


def _typed(block: check_docs.CodeBlock) -> str:
    """A block as the shell gets it."""
    text = "\n".join(block.lines)
    if block.title:
        name = shlex.quote(block.title)
        return f"mkdir -p \"$(dirname {name})\"\ncat > {name} <<'END OF BLOCK'\n{text}\nEND OF BLOCK"
    if block.language == "python":
        return f"python - <<'END OF BLOCK'\n{text}\nEND OF BLOCK"
    return text


def _by_step(lines: list[str]) -> list[list[str]]:
    parts: list[list[str]] = []
    for line in lines:
        if line == _END:
            break
        if line.startswith(_MARK):
            parts.append([])
        elif parts:
            parts[-1].append(line)
    return parts


def environment(folder: Path) -> dict[str, str]:
    """This environment with ``relocbench`` and ``python`` of this checkout first on the path."""
    tools = folder / ".bin"
    tools.mkdir(exist_ok=True)
    python = shlex.quote(sys.executable)
    for name, words in (("relocbench", f"{python} -m relocbench"), ("python", python), ("python3", python)):
        (tools / name).write_text(f'#!/bin/sh\nexec {words} "$@"\n')
        (tools / name).chmod(0o755)
    path = os.pathsep.join([str(tools), str(Path(sys.executable).parent), os.environ["PATH"]])
    return {
        **os.environ,
        "PATH": path,
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(folder)]),
        "COLUMNS": "100",
    }

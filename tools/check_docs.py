"""Check that links in README.md and docs/ have targets, and that the commands and tests named there exist."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from relocbench.cli.app import app

ROOT = Path(__file__).parents[1]
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_TEST = re.compile(r"`([\w/]+\.py)::(test_\w+)`")
_FENCE = re.compile(r"^```(\w*)\s*$")


def pages() -> list[Path]:
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def dead_links(page: Path) -> Iterator[str]:
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        for target in _LINK.findall(line):
            if "://" in target or target.startswith(("#", "mailto:")):
                continue
            if not (page.parent / target.split("#")[0]).exists():
                yield f"{page.relative_to(ROOT)}:{number}: link to '{target}', which does not exist"


def commands(page: Path) -> Iterator[tuple[int, str]]:
    """The line number and text of relocbench commands in shell blocks, with continued lines joined."""
    language, start, pending = None, 0, ""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        fence = _FENCE.match(line)
        if fence:
            language = fence.group(1) if language is None else None
            pending = ""
        elif language in ("bash", "sh", "console"):
            start = start if pending else number
            pending += " " + line.strip().removesuffix("\\") if pending else line.strip().removesuffix("\\")
            if not line.rstrip().endswith("\\"):
                if pending.startswith("relocbench "):
                    yield start, pending
                pending = ""


def unknown_words(command: str) -> Iterator[str]:
    """Faults of a shown command: subcommands and options that do not exist."""
    words = shlex.split(command, comments=True)[1:]
    context: Any = typer.main.get_command(app)
    while words and hasattr(context, "get_command"):
        name = words.pop(0)
        if name.startswith("-"):
            return
        found = context.get_command(None, name)
        if found is None:
            yield f"no command '{name}'"
            return
        context = found
    known = {option for parameter in context.params for option in (*parameter.opts, *parameter.secondary_opts)}
    for word in words:
        is_option = word.startswith("-") and not word[1:2].isdigit()
        if is_option and word.split("=")[0] not in known | {"--help"}:
            yield f"'{context.name}' has no option {word}"


def unknown_tests(page: Path) -> Iterator[str]:
    """Faults of a page: tests named as ``file.py::test_name`` that do not exist."""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        for file, name in _TEST.findall(line):
            found = (ROOT / "tests").rglob(Path(file).name)
            if not any(f"def {name}(" in path.read_text(encoding="utf-8") for path in found):
                yield f"{page.relative_to(ROOT)}:{number}: test '{file}::{name}', which does not exist"


def main() -> int:
    faults = [fault for page in pages() for fault in (*dead_links(page), *unknown_tests(page))]
    shown = 0
    for page in pages():
        for number, command in commands(page):
            shown += 1
            faults += [f"{page.relative_to(ROOT)}:{number}: {fault}" for fault in unknown_words(command)]
    print("\n".join(faults) or f"{len(pages())} pages, {shown} commands: all links, commands and named tests exist")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())

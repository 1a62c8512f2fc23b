"""Check the pages: links have targets, anchors included, commands and tests exist, and no page is too long."""

from __future__ import annotations

import re
import shlex
import sys
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import typer

from relocbench.cli.app import app

ROOT = Path(__file__).parents[1]
MOST_WORDS = 2500
MOST_WORDS_OF_README, MOST_LINES_OF_README = 1000, 120
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_HEADING = re.compile(r"^#{1,6} +(.+?) *#*$", re.MULTILINE)
_ID = re.compile(r"<[a-z0-9]+ [^>]*\b(?:id|name)=[\"']([^\"']+)[\"']")
_BLOCK = re.compile(r"^(```+|~~~+).*?^\1[`~]* *$", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"(`+)(?!`).+?(?<!`)\1(?!`)", re.DOTALL)
_TEST = re.compile(r"`((?:\w+/)*test_\w+\.py)(?:::(test_\w+))?`")
_FENCE = re.compile(r"^```(\w*)(?: +title=\"([^\"]+)\")?\s*$")


def pages() -> list[Path]:
    """The pages for readers, in the README, ``docs/`` and ``leaderboard/``, and the other pages beside the README."""
    below = [path for folder in ("docs", "leaderboard") for path in sorted((ROOT / folder).rglob("*.md"))]
    return [*sorted(ROOT.glob("*.md")), *below]


def dead_links(page: Path) -> Iterator[str]:
    """Faults of a page: links to files that do not exist, and to headings that their page does not have."""
    text = _without_code(page.read_text(encoding="utf-8"))
    for found in _LINK.finditer(text):
        target = found.group(1)
        if "://" in target or target.startswith("mailto:"):
            continue
        where = f"{shown(page)}:{text.count(chr(10), 0, found.start(1)) + 1}"
        name, _, anchor = map(unquote, target.partition("#"))
        path = page.parent / name if name else page
        if not path.exists():
            yield f"{where}: link to '{target}', which does not exist"
        elif anchor and path.suffix == ".md" and anchor not in anchors(path, on_site=on_site(page)):
            yield f"{where}: link to '{target}': '{shown(path)}' has no such heading"


def shown(page: Path) -> Path:
    """The path of a page in the repository."""
    return page.resolve().relative_to(ROOT) if page.resolve().is_relative_to(ROOT) else page


def on_site(page: Path) -> bool:
    """Whether a page is part of the site that mkdocs makes; GitHub shows all pages."""
    return any(page.resolve().is_relative_to(ROOT / folder) for folder in ("docs", "leaderboard"))


def anchors(page: Path, *, on_site: bool) -> set[str]:
    """The names by which a link reaches a heading of a page: on GitHub, and with ``on_site`` on the site too."""
    text = _without_code(page.read_text(encoding="utf-8"), blocks_only=True)
    headings = [_plain(found) for found in _HEADING.findall(text)]
    named = set(_ID.findall(text))
    on_github = _distinct(map(github_slug, headings), "-")
    return named | (on_github & _distinct(map(site_slug, headings), "_") if on_site else on_github)


def github_slug(heading: str) -> str:
    """The anchor that GitHub makes of a heading: spaces become hyphens, each, and punctuation goes."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def site_slug(heading: str) -> str:
    """The anchor that mkdocs makes of a heading: characters outside of ASCII go, and hyphens in a row become one."""
    ascii_only = unicodedata.normalize("NFKD", heading).encode("ascii", "ignore").decode()
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", ascii_only).strip().lower())


def _distinct(slugs: Iterable[str], separator: str) -> set[str]:
    """The anchors of a page: a repeated one gets a number."""
    counts: dict[str, int] = {}
    found = set()
    for slug in slugs:
        number = counts.get(slug, 0)
        found.add(f"{slug}{separator}{number}" if number else slug)
        counts[slug] = number + 1
    return found


def _plain(heading: str) -> str:
    """The text of a heading without the marks of Markdown."""
    return re.sub(r"[`*]", "", re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)).strip()


def _without_code(text: str, *, blocks_only: bool = False) -> str:
    """The text with code blocks, and by default also code in lines, made blank; all lines keep their numbers."""
    blank = _BLOCK.sub(lambda found: "\n" * found.group().count("\n"), text)
    return blank if blocks_only else _CODE.sub(lambda found: "\n" * found.group().count("\n"), blank)


@dataclass(frozen=True)
class CodeBlock:
    """A fenced block of a page."""

    language: str
    title: str
    """the name of the file that it shows, or nothing"""
    line: int
    """of its first line of text, from 1"""
    lines: tuple[str, ...]


def code_blocks(page: Path) -> Iterator[CodeBlock]:
    """The fenced blocks of a page that begin at the margin, in their order."""
    opened: re.Match[str] | None = None
    start = 0
    lines: list[str] = []
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        fence = _FENCE.match(line)
        if opened is None and fence:
            opened, start, lines = fence, number + 1, []
        elif opened is not None and line.rstrip() == "```":
            yield CodeBlock(opened[1], opened[2] or "", start, tuple(lines))
            opened = None
        else:
            lines.append(line)


def commands(page: Path) -> Iterator[tuple[int, str]]:
    """The line number and text of relocbench commands in shell blocks, with continued lines joined."""
    for block in code_blocks(page):
        if block.language not in ("bash", "sh", "console"):
            continue
        start, pending = 0, ""
        for number, line in enumerate(block.lines, start=block.line):
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
        if words and context.get_command(None, f"{name} {words[0]}") is not None:
            name += f" {words.pop(0)}"
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
    """Faults of a page: tests named as ``test_file.py`` or ``test_file.py::test_name`` that do not exist."""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        for file, name in _TEST.findall(line):
            found = (ROOT / "tests").rglob(Path(file).name)
            if not any(not name or f"def {name}(" in path.read_text(encoding="utf-8") for path in found):
                yield f"{shown(page)}:{number}: test '{file}{'::' if name else ''}{name}', which does not exist"


def too_long(page: Path) -> Iterator[str]:
    """Faults of a page: more words or lines than a reader has patience for."""
    text = page.read_text(encoding="utf-8")
    words, lines = len(text.split()), text.count("\n")
    limit = MOST_WORDS_OF_README if page == ROOT / "README.md" else MOST_WORDS
    if words > limit:
        yield f"{shown(page)}: {words} words, more than {limit}; split it, or shorten it"
    if page == ROOT / "README.md" and lines > MOST_LINES_OF_README:
        yield f"{shown(page)}: {lines} lines, more than {MOST_LINES_OF_README}"


def main() -> int:
    faults = [fault for page in pages() for fault in (*dead_links(page), *unknown_tests(page))]
    faults += [fault for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")) for fault in too_long(page)]
    count = 0
    for page in pages():
        for number, command in commands(page):
            count += 1
            faults += [f"{shown(page)}:{number}: {fault}" for fault in unknown_words(command)]
    print(
        "\n".join(faults)
        or f"{len(pages())} pages, {count} commands: all links, anchors, commands and named tests exist"
    )
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())

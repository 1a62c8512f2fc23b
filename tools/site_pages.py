"""Hooks of mkdocs: the published results and the notebook become pages too, and the search knows what comes first.

Pages link to each other as they lie in the repository, where ``leaderboard/`` is beside ``docs/`` and a notebook is its
own page. On the site ``leaderboard/`` is inside, and the notebook is a page in Markdown; links are changed to match.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
BOARD = "leaderboard"
_SHOWN = {".md", ".csv", ".png"}
"""of the published results; the archives of errors are left to the repository"""
_SEARCH: dict[str, dict[str, Any]] = {
    "metrics.md": {"boost": 4},
    "tutorials/your-method.md": {"boost": 4},
    "add-a-method.md": {"boost": 3},
    "interoperability.md": {"boost": 3},
    "ground-truth.md": {"boost": 2},
    "results.md": {"boost": 2},
    "decisions.md": {"exclude": True},
}
"""how the search ranks a page; those of the published results, which have every word in their tables, come last"""
_TO_DOCS = re.compile(r"(\]\((?:\.\./)+)docs/")
_TO_BOARD = re.compile(r"(\]\((?:\.\./)*)\.\./leaderboard/")
_TO_NOTEBOOK = re.compile(r"(\]\([^)\s]+)\.ipynb\)")


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the published results, and a page for each notebook."""
    for path in sorted((ROOT / BOARD).rglob("*")):
        if path.suffix in _SHOWN:
            files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    for path in sorted(Path(config.docs_dir).rglob("*.ipynb")):
        name = path.relative_to(config.docs_dir).with_suffix(".md")
        text, pictures = notebook_page(path)
        files.append(File.generated(config, name.as_posix(), content=text))
        for picture, content in pictures.items():
            files.append(File.generated(config, (name.parent / picture).as_posix(), content=content))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Turn links of the repository into those of the site, and say how the search ranks the page."""
    published = page.file.src_uri.startswith(f"{BOARD}/")
    page.meta.setdefault("search", _SEARCH.get(page.file.src_uri, {"boost": 0.3 if published else 1}))
    if published:
        return _TO_DOCS.sub(r"\1", markdown)
    if (ROOT / "docs" / page.file.src_uri).with_suffix(".ipynb").exists():
        return markdown  # it links to itself, to be downloaded
    return _TO_NOTEBOOK.sub(r"\1.md)", _TO_BOARD.sub(rf"\1{BOARD}/", markdown))


def notebook_page(path: Path) -> tuple[str, dict[str, bytes]]:
    """A notebook as Markdown, and the pictures of its outputs by their names beside the page."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in cells:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
        else:
            parts.append(f"```python\n{source}\n```")
            for kind, content in _outputs(cell):
                if kind == "text":
                    parts.append(f"```text\n{content}\n```")
                else:
                    name = f"{path.stem}-{len(pictures) + 1}.png"
                    pictures[name] = base64.b64decode(content)
                    parts.append(f"![{_caption(source)}]({name})")
    title, _, rest = "\n\n".join(parts).partition("\n")
    download = f"[Download the notebook]({path.name}){{ .md-button download }}"
    return f"{title}\n\n{download}\n{rest}\n", pictures


def _outputs(cell: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """What a cell printed and drew: ``("text", ...)`` and ``("png", base64)``."""
    for output in cell["outputs"]:
        data = output.get("data", {})
        if "text" in output:
            yield "text", "".join(output["text"]).rstrip("\n")
        elif "image/png" in data:
            yield "png", "".join(data["image/png"])
        elif "text/plain" in data:
            yield "text", "".join(data["text/plain"])


def _caption(source: str) -> str:
    """The comment that a cell which draws begins with, for those who do not see the picture."""
    first = source.splitlines()[0]
    return first.removeprefix("#").strip() if first.startswith("#") else "What the cell draws"

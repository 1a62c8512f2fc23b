"""The site of the documentation works as files, asks nothing of the network, and can be read by everybody."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from repository import DOCS, ROOT

PAGES = (
    "index.html",
    "tutorials/your-method.html",
    "tutorials/notebook.html",
    "leaderboard/leaderboard.html",
    "api/geometry.html",
)
CHROMIUM = os.environ.get("RELOCBENCH_BROWSER") or shutil.which("chromium") or shutil.which("chromium-browser")

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no Chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


def visit(browser: Any, address: str, **options: Any) -> tuple[Any, list[str]]:
    """A page, and what it asked of others than files or complained of until now."""
    page = browser.new_context(**options).new_page()
    page.set_default_timeout(120_000)  # beside other work
    faults: list[str] = []
    page.on("request", lambda it: None if it.url.startswith(("file:", "data:", "blob:")) else faults.append(it.url))
    page.on("requestfailed", lambda it: faults.append(f"not found: {it.url}"))
    page.on("console", lambda it: faults.append(it.text) if it.type in ("error", "warning") else None)
    page.on("pageerror", lambda it: faults.append(str(it)))
    page.goto(address)
    page.wait_for_load_state("networkidle")
    return page, faults


def test_no_page_names_a_script_a_style_or_a_picture_of_elsewhere(site: Path) -> None:
    loaded = re.compile(
        r"<(?:script|img|iframe|source)\b[^>]*\bsrc=[\"']?(?:https?:)?//|<link\b[^>]*href=[\"']?https?://"
    )
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 60
    assert [page.name for page in pages if loaded.search(page.read_text(encoding="utf-8"))] == []


def test_the_published_results_and_the_notebook_are_pages(site: Path) -> None:
    for path in (ROOT / "leaderboard").rglob("*.md"):
        name = path.relative_to(ROOT).with_suffix(".html")
        assert (site / (name.parent / "index.html" if path.name == "README.md" else name)).exists(), path
    notebook = (site / "tutorials" / "notebook.html").read_text(encoding="utf-8")
    assert "iterate_pairs" in notebook
    assert 'src="notebook-1.png"' in notebook
    assert (site / "tutorials" / "notebook.ipynb").read_bytes() == (DOCS / "tutorials" / "notebook.ipynb").read_bytes()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_opened_as_a_file_asks_nothing_of_the_network(site: Path, browser: Any, name: str) -> None:
    for width in (1400, 390):
        page, faults = visit(browser, f"file://{site}/{name}", viewport={"width": width, "height": 900})
        assert faults == []
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.context.close()


def test_the_search_works_in_a_page_that_is_a_file_and_finds_the_right_page_first(site: Path, browser: Any) -> None:
    page, faults = visit(browser, f"file://{site}/index.html", viewport={"width": 1400, "height": 900})
    box = page.locator("input.md-search__input")
    first = {"AUC": "metrics", "evo": "interoperability", "own method": "tutorials/your-method", "install": "install"}
    for words, name in first.items():
        box.fill("")
        box.press_sequentially(words)
        page.locator(f".md-search-result__item:first-child a[href*='/{name}.html']").first.wait_for(timeout=60_000)
    assert faults == []
    page.context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", PAGES[:4])
def test_a_page_has_no_serious_barrier(site: Path, browser: Any, name: str, scheme: str) -> None:
    from axe_playwright_python.sync_playwright import Axe

    page, _ = visit(browser, f"file://{site}/{name}", viewport={"width": 1400, "height": 900}, color_scheme=scheme)
    found = Axe().run(page).response["violations"]
    serious = {
        one["id"]: [node["html"][:200] for node in one["nodes"]][:3]
        for one in found
        if one["impact"] in ("serious", "critical")
    }
    assert serious == {}
    page.context.close()

"""Pages of results in a browser: ``from browser_pages import needs_browser, serious_faults``.

All tests have the fixtures ``browser`` and ``page`` by way of ``tests/conftest.py``.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed")

WINDOWS: dict[str, dict[str, Any]] = {
    "light": {"color_scheme": "light"},
    "dark": {"color_scheme": "dark"},
    "dark phone": {"color_scheme": "dark", "viewport": {"width": 390, "height": 844}},
}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture
def page(request: pytest.FixtureRequest, browser: Any) -> Iterator[Any]:
    """A page in one of :data:`WINDOWS`, which must report no error and ask for nothing beyond the disk.

    ``page.told`` has what it reported until now.
    """
    told: list[str] = []

    def refuse(dialog: Any) -> None:
        told.append(f"a dialog opened: {dialog.message}")
        dialog.dismiss()

    found = browser.new_page(**WINDOWS[getattr(request, "param", "light")])
    found.on("console", lambda message: told.append(message.text) if message.type == "error" else None)
    found.on("pageerror", lambda error: told.append(str(error)))
    found.on("dialog", refuse)
    allowed = ("file:", "data:", "blob:")
    found.on("request", lambda asked: None if asked.url.startswith(allowed) else told.append(asked.url))
    found.told = told
    yield found
    found.close()
    assert told == []


def serious_faults(page: Any) -> list[str]:
    """Serious and critical findings of axe on a page that has reported no error until now.

    What the checker itself cannot load from a disk is no error of the page.
    """
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    assert page.told == []
    found = axe.Axe().run(page, options={"preload": False}).response["violations"]
    return [f"{v['id']}: {v['nodes'][0]['html']}" for v in found if v["impact"] in ("serious", "critical")]

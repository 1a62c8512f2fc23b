#!/usr/bin/env python3
"""Take the screenshots of docs/html-report.md: pages of the demo's report, on a desktop, on a phone and in the dark.

    relocbench demo --out demo-output
    tools/report_screenshots.py demo-output/leaderboard/html docs/images

Needs Chromium (``make browser``). The same report gives the same pictures, but for how a machine draws its fonts.
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
COLOURS = 128
"""of a picture's palette: pages have few colours, and their pictures are a third as large with a palette"""


@dataclass(frozen=True)
class Shot:
    """One picture: what is opened, how large the window is, and what is done before it is taken."""

    name: str
    page: str
    width: int = 1280
    height: int = 860
    dark: bool = False
    prepare: Callable[[Page], None] = lambda page: None
    photographs: bool = False
    """whether it shows photographs, which a palette would spoil"""


def _open_list(page: Page) -> None:
    """From the matrix to the pairs of the second method in the last condition."""
    page.locator(".matrix tbody tr").nth(1).locator("td.share a").last.click()
    page.wait_for_selector("#pair-list .thumb")
    page.wait_for_timeout(1500)


def _open_worst_pair(page: Page) -> None:
    """On from there to the pair that it got most wrong."""
    _open_list(page)
    page.locator("#pair-list a").first.click()
    page.wait_for_load_state("networkidle")
    page.wait_for_timeout(1500)


def _scroll_to_map(page: Page) -> None:
    """To the map of the drive, of a method that fails on some pairs."""
    page.locator("#map-method").select_option("orb-pnp")
    page.locator("#map-section").scroll_into_view_if_needed()
    page.evaluate("window.scrollTo(0, document.getElementById('map-about').offsetTop - 120)")
    page.wait_for_timeout(1500)


SHOTS = (
    Shot("report-start", "index.html"),
    Shot("report-set", "set-*.html", height=1500),
    Shot("report-list", "index.html", prepare=_open_list, photographs=True),
    Shot("report-pair", "index.html", height=1000, prepare=_open_worst_pair, photographs=True),
    Shot("report-map", "set-*.html", height=880, prepare=_scroll_to_map),
    Shot("report-phone", "index.html", width=390, height=844),
    Shot("report-dark", "set-*.html", height=1500, dark=True),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", type=Path, help="folder of a report: index.html is in it")
    parser.add_argument("out", type=Path, help="folder of the pictures")
    options = parser.parse_args()
    executable = next(filter(None, map(shutil.which, BROWSERS)), None)
    if executable is None:
        sys.exit(f"none of {', '.join(BROWSERS)} is installed; make browser installs Chromium")
    if not (options.report / "index.html").is_file():
        sys.exit(f"{options.report}: no index.html; expected the folder of a report")
    options.out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        for shot in SHOTS:
            print(_take(browser, shot, options.report, options.out))
        browser.close()


def _take(browser: Browser, shot: Shot, report: Path, out: Path) -> Path:
    page = browser.new_page(
        viewport={"width": shot.width, "height": shot.height}, color_scheme="dark" if shot.dark else "light"
    )
    page.goto(sorted(report.glob(shot.page))[0].resolve().as_uri())
    page.wait_for_selector("table.dataTable tbody tr")
    page.wait_for_timeout(1500)  # charts are drawn once their data are there
    shot.prepare(page)
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    page.close()
    path = out / f"{shot.name}.{'jpg' if shot.photographs else 'png'}"
    if shot.photographs:
        picture.save(path, quality=85)
    else:
        picture.quantize(COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


if __name__ == "__main__":
    main()

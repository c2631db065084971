"""Draw the pictures of README from the demo: `python -m docs.screenshots`, after `make demo`.

It needs chromium and playwright, as the tests of the page do.
"""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import sync_playwright

import splitband as sb
from splitband.cli.demo import METHODS, RECIPE, SIZES, TRAIN
from splitband.records.named import overhead_crane

ROOT = Path(__file__).parents[1]
LEFT, WIDTH, HEIGHT = 92, 1216, 2000
"""Pixels of the page."""


def main() -> None:
    """Draw the predictions of the demo's methods, and its page down to the errors by band."""
    images, demo = ROOT / "docs/img", ROOT / "demo"
    result = sb.compare(overhead_crane(), TRAIN, METHODS, seeds=1, settings=RECIPE, sizes=SIZES)
    result.plot().savefig(images / "demo.png")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1400, "height": HEIGHT}, color_scheme="light")
        page.goto((demo / "report.html").as_uri())
        page.wait_for_selector("html[data-drawn]")
        bands = page.locator("#bands").bounding_box()
        assert bands is not None
        end = bands["y"] + bands["height"]
        page.screenshot(
            path=images / "report.png",
            clip={"x": LEFT, "y": 0, "width": WIDTH, "height": end},
        )
        browser.close()


if __name__ == "__main__":
    main()

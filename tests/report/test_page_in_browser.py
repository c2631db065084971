"""The page in a real browser: what it shows, what it asks of the network, how it is operated."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from splitband.report.page import document as report
from splitband.report.page.parts import Usage
from tests.report import comparisons

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CHROMIUM = Path("/usr/bin/chromium")
AXE = Path(__file__).parents[2] / "node_modules/axe-core/axe.min.js"
"""From npm: `make axe` fetches it."""
ARGUMENTS = """
    --headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync
    --disable-background-networking --disable-component-update"""

pytestmark = pytest.mark.skipif(not CHROMIUM.exists(), reason=f"no browser at {CHROMIUM}")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=str(CHROMIUM), args=ARGUMENTS.split())
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    found = comparisons.compared(comparisons.record())
    used = Usage([("Fit it", f"splitband fit rig.csv {'--option value ' * 12}")])
    report.of_comparison(comparisons.as_if_trained(found), path, used)
    return path


class Opened:
    """A page that is drawn, and all that it said and asked for."""

    def __init__(self, browser: Browser, path: Path, **options: Any) -> None:
        self.context = browser.new_context(**options)
        self.page: Page = self.context.new_page()
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._said)
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-drawn]")

    def _said(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def range(self, figure: int) -> list[float]:
        """What a figure shows of its horizontal axis."""
        found = self.page.evaluate(
            "i => { const r = Bokeh.documents[0].roots()[i].x_range; return [r.start, r.end]; }",
            figure,
        )
        return [float(value) for value in found]

    def drawn(self, figure: int, name: str) -> bool:
        """Whether a curve of a figure is."""
        found = self.page.evaluate(
            "([i, name]) => Bokeh.documents[0].roots()[i].renderers"
            ".find(r => r.name === name).visible",
            [figure, name],
        )
        return bool(found)


@pytest.fixture
def opened(browser: Browser, file: Path) -> Iterator[Opened]:
    it = Opened(browser, file)
    yield it
    it.context.close()
    assert not it.complaints
    assert all(url.startswith(("file:", "data:", "blob:")) for url in it.requests)


def test_names_are_text_and_nothing_is_loaded(browser: Browser, tmp_path: Path) -> None:
    """Not even what draws formulas, which a name between dollar signs would ask for."""
    report.of_comparison(comparisons.everything(), tmp_path / "page.html")
    it = Opened(browser, tmp_path / "page.html")
    alerted = []
    it.page.on("dialog", lambda dialog: alerted.append(dialog.message))
    assert comparisons.NASTY in it.page.inner_text("h1")
    it.context.close()
    assert not it.complaints
    assert not alerted
    assert all(url.startswith("file:") for url in it.requests)


def test_plots_of_one_time_zoom_together(opened: Opened) -> None:
    """By dragging and by the buttons: measured and predicted, and the residuals below."""
    begun = opened.range(0)
    assert begun[0] < 0.0  # the whole record, with a margin
    assert begun[1] > 29.9
    opened.page.locator("#plot-0").scroll_into_view_if_needed()
    box = opened.page.locator("#plot-0").bounding_box()
    assert box is not None
    middle = box["y"] + box["height"] / 2
    opened.page.mouse.move(box["x"] + 0.4 * box["width"], middle - 40)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + 0.6 * box["width"], middle + 40, steps=4)
    opened.page.mouse.up()
    opened.page.wait_for_function(
        "end => Bokeh.documents[0].roots()[0].x_range.end < end", arg=begun[1]
    )
    dragged = opened.range(0)
    assert begun[0] < dragged[0] < dragged[1] < begun[1]
    assert opened.range(1) == dragged
    opened.page.get_by_role("button", name="Test").click()
    assert opened.range(0) == opened.range(1) == [20.0, 29.9]


def test_a_name_below_a_plot_shows_and_hides_its_curve_there(opened: Opened) -> None:
    """By click and by key; at first, the record shows the recommended method alone."""
    figure = opened.page.locator("figure").first
    other = figure.locator("[data-curve][aria-pressed=false]").first
    name = str(other.get_attribute("data-curve"))
    below = opened.page.locator("#bands .plot").first
    bands = int(str(below.get_attribute("id")).removeprefix("plot-"))
    assert not opened.drawn(0, name)
    other.click()
    assert opened.drawn(0, name)
    measured = figure.locator("[data-curve=measured]")
    measured.focus()
    opened.page.keyboard.press("Enter")
    assert measured.get_attribute("aria-pressed") == "false"
    assert not opened.drawn(0, "measured")
    assert opened.drawn(bands, name)


def test_dark_mode_phones_and_paper(browser: Browser, file: Path) -> None:
    """Page and plots change their colours; a phone shows a plot at once; paper gets pictures."""
    colors = (
        "() => { const [f] = Bokeh.documents[0].roots(); const line = f.renderers.at(-1).glyph;"
        "return [getComputedStyle(document.body).backgroundColor, f.background_fill_color,"
        "line.line_color.value]; }"
    )
    viewport = {"width": 390, "height": 844}
    it = Opened(browser, file, color_scheme="light", viewport=viewport)
    assert it.page.evaluate("document.documentElement.scrollWidth") <= 390
    first = it.page.locator("#plot-0").bounding_box()
    assert first is not None
    assert first["y"] + first["height"] < 844  # the first plot is on the first screen
    light = it.page.evaluate(colors)
    assert light[:2] == ["rgb(255, 255, 255)", "#ffffff"]
    it.page.emulate_media(color_scheme="dark")
    it.page.wait_for_function(f"before => ({colors})()[1] !== before", arg=light[1])
    dark = it.page.evaluate(colors)
    assert all(a != b for a, b in zip(light, dark, strict=True))
    it.page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert it.page.evaluate(colors) == light
    assert it.page.locator(".plot img").count() == it.page.locator("figure:visible").count() > 0
    it.page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert it.page.evaluate(colors) == dark
    assert it.page.locator(".plot img").count() == 0
    it.context.close()
    assert not it.complaints


@pytest.mark.skipif(not AXE.exists(), reason="axe-core is not there: make axe fetches it")
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1400])
def test_axe_has_no_serious_finding(browser: Browser, file: Path, scheme: str, width: int) -> None:
    viewport = {"width": width, "height": 800}
    it = Opened(browser, file, color_scheme=scheme, viewport=viewport, bypass_csp=True)
    it.page.add_script_tag(content=AXE.read_text(encoding="utf-8"))
    found = it.page.evaluate("axe.run().then(found => found.violations)")
    it.context.close()
    serious = [
        (each["id"], each["nodes"][0]["html"])
        for each in found
        if each["impact"] in ("serious", "critical")
    ]
    assert not serious

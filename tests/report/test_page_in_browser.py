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

    def drawn(self, method: str) -> list[bool]:
        """Whether the curves of a method are, in every figure."""
        found = self.page.evaluate(
            "name => Bokeh.documents[0].roots().flatMap(f => f.renderers)"
            ".filter(r => r.name === name && r.tags.includes('method'))"
            ".map(r => r.visible)",
            method,
        )
        return [bool(value) for value in found]


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
    it.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    # The recommended method is drawn at first, with the best of the other baselines.
    assert it.page.locator("input[name=method]:checked").count() == 2
    box, *_ = it.page.query_selector_all("input[name=method]:not(:checked)")
    worst = str(box.get_attribute("value"))
    assert not any(it.drawn(worst))
    box.check()
    assert all(it.drawn(worst))
    assert comparisons.NASTY in it.page.inner_text("h1")
    it.context.close()
    assert not it.complaints
    assert not alerted
    assert all(url.startswith("file:") for url in it.requests)


def test_plots_of_one_time_zoom_together(opened: Opened) -> None:
    """By dragging, by the buttons and by keys: forecasts and their residuals."""
    opened.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    residuals = opened.page.locator("#residuals .plot").last
    beside = int(str(residuals.get_attribute("id")).removeprefix("plot-"))
    begun = opened.range(0)
    assert begun == [18.8, 29.9]  # shortly before the forecast, which begins at 20 s
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
    assert opened.range(beside) == dragged
    opened.page.get_by_role("button", name="After it").click()
    after = opened.range(0)
    assert after == [20.0, 29.9]
    residuals.focus()
    opened.page.keyboard.press("+")
    closer = opened.range(0)
    assert closer[1] - closer[0] == pytest.approx((after[1] - after[0]) / 2)
    opened.page.keyboard.press("0")
    whole = opened.range(0)
    assert whole[0] < 0
    assert whole[1] > 29.9
    assert opened.range(beside) == whole


def test_a_method_is_switched_off_everywhere(opened: Opened) -> None:
    opened.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    assert len(opened.drawn("mean")) >= 4
    for name in ("mean", "persistence"):
        opened.page.get_by_role("checkbox", name=name).check()
    assert all(opened.drawn("mean"))
    opened.page.get_by_role("checkbox", name="mean").uncheck()
    assert not any(opened.drawn("mean"))
    assert all(opened.drawn("persistence"))
    parts = opened.page.locator("#components figure")
    assert parts.is_visible()
    opened.page.get_by_role("checkbox", name="persistence").uncheck()
    assert not parts.is_visible()


def test_the_table_sorts_by_keyboard(opened: Opened) -> None:
    """Tab leads to the button of every heading, and Enter sorts."""
    heading = opened.page.locator("#methods th").nth(1)
    for _ in range(60):
        opened.page.keyboard.press("Tab")
        if opened.page.evaluate("document.activeElement.textContent") == "fit %":
            break
    cells = "document.querySelectorAll('#methods td:nth-child(2)')"
    errors = f"Array.from({cells}, cell => +cell.dataset.value)"
    for order, ascending in (("ascending", True), ("descending", False)):
        opened.page.keyboard.press("Enter")
        assert heading.get_attribute("aria-sort") == order
        values = opened.page.evaluate(errors)
        assert values == sorted(values, reverse=not ascending)
    assert "fit %" in opened.page.inner_text("#status")


def test_dark_mode_phones_and_paper(browser: Browser, file: Path) -> None:
    """Page and plots change their colours; nothing is wider than a phone; paper gets pictures."""
    colors = (
        "() => { const [f] = Bokeh.documents[0].roots(); const line = f.renderers.at(-1).glyph;"
        "return [getComputedStyle(document.body).backgroundColor, f.background_fill_color,"
        "line.line_color.value]; }"
    )
    viewport = {"width": 360, "height": 740}
    it = Opened(browser, file, color_scheme="light", viewport=viewport)
    assert it.page.evaluate("document.documentElement.scrollWidth") <= 360
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
    it.page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    it.page.add_script_tag(content=AXE.read_text(encoding="utf-8"))
    found = it.page.evaluate("axe.run().then(found => found.violations)")
    it.context.close()
    serious = [
        (each["id"], each["nodes"][0]["html"])
        for each in found
        if each["impact"] in ("serious", "critical")
    ]
    assert not serious

"""The page as a file: well formed, names escaped, whole or not there, small."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import html5lib
import numpy as np
import pandas as pd
import pytest
import scipy.signal
from bokeh.models import HoverTool

import splitband as sb
from splitband import Record
from splitband.comparison.result import Comparison
from splitband.forecasters.base import titled
from splitband.report.numbers import number
from splitband.report.page import document, pages, plots
from splitband.report.page.charts import MOST, Axis, Chart, compact
from splitband.report.page.parts import Usage
from splitband.report.pictures import rollouts, times_of
from splitband.report.tables import labels_of
from splitband.report.words import afterwards
from tests.report import comparisons
from tests.report.comparisons import TRAIN


def parsed(path: Path) -> Any:
    """The document; html5lib raises for what is not well formed, as browsers report it."""
    parser = html5lib.HTMLParser(strict=True, namespaceHTMLElements=False)
    return parser.parse(path.read_text(encoding="utf-8"))


def words_of(tree: Any) -> str:
    """What is read, in one line."""
    return " ".join("".join(tree.itertext()).split())


@pytest.fixture(scope="module")
def everything() -> Comparison:
    return comparisons.everything()


@pytest.fixture(scope="module")
def written(everything: Comparison, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One of each kind."""
    folder = tmp_path_factory.mktemp("pages")
    used = Usage([("Fit it", "splitband fit 'a <b>'")], "splitband compare 'a <b>'")
    document.of_comparison(everything, folder / "comparison", used)
    document.of_comparison(comparisons.of_all(), folder / "of all", used)
    return {page.name: page for page in folder.iterdir()}


@pytest.mark.parametrize("kind", ["comparison", "of all"])
def test_each_page_is_well_formed_and_readable(written: dict[str, Path], kind: str) -> None:
    """Landmarks, one first heading, no level left out, captions, words for every plot."""
    tree = parsed(written[kind])
    assert tree.get("lang") == "en"
    assert all(tree.find(f".//{landmark}") is not None for landmark in ("header", "main", "nav"))
    headings = [e.tag for e in tree.iter() if e.tag in ("h1", "h2", "h3")]
    assert headings.count("h1") == 1
    assert headings[:2] == ["h1", "h2"]
    for table in tree.iter("table"):
        assert "".join(table.find("caption").itertext()).strip()
        assert {th.get("aria-sort") for th in table.findall("./thead//th")} == {"none"}
        assert all(row.find("th").get("scope") == "row" for row in table.findall("./tbody/tr"))
    drawn = [e for e in tree.iter("div") if e.get("class") == "plot"]
    assert all(len(plot.get("aria-label")) > 40 and plot.get("role") == "img" for plot in drawn)
    identities = [e.get("id") for e in tree.iter() if e.get("id")]
    assert len(identities) == len(set(identities))
    anchors = {a.get("href")[1:] for a in tree.findall(".//nav//a")}
    assert anchors <= set(identities)
    assert written[kind].stat().st_size < 6e6


def test_the_page_says_what_it_must_and_names_are_escaped(
    written: dict[str, Path], everything: Comparison
) -> None:
    assert "<script>alert" not in written["comparison"].read_text(encoding="utf-8")
    tree = parsed(written["comparison"])
    assert comparisons.NASTY in tree.find(".//h1").text
    assert "splitband fit 'a <b>'" in [code.text for code in tree.iter("code")]
    said, best = words_of(tree), everything.recommended
    assert titled(best, labels_of(everything)[best]) in said
    words = "samples have missing values", "a note", "Not tested: ", "Error over horizon"
    assert all(each in said for each in (*words, "test RMSE later", "splitband compare 'a <b>'"))


def test_a_page_is_written_whole_or_not_at_all(
    tmp_path: Path, everything: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "report.html"
    path.write_text("the old one")

    def failing(page: Any) -> str:
        raise RuntimeError("the template is wrong")

    monkeypatch.setattr(document, "html", failing)
    with pytest.raises(RuntimeError):
        everything.report(path)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("report.html", "the old one")]


def test_there_is_a_page_where_nothing_is_forecast_or_a_method_explodes(tmp_path: Path) -> None:
    """Numbers that no canvas takes are drawn to the edge."""
    r = comparisons.record()
    found = comparisons.compared(replace(r, start=5.0), ("mean", "persistence"), len(r), [r])
    assert [*pages.of_comparison(found, Usage()).views] == ["Whole record"]
    r = Record(r.y, r.sampling_time, y_sim=np.where(np.arange(len(r)) > 250, 1e60, 0.0))
    for each in (found, comparisons.compared(r, ("mean", "simulator"))):
        each.report(tmp_path / "page.html")
        parsed(tmp_path / "page.html")


def test_time_is_called_what_the_record_knows() -> None:
    r = comparisons.record()
    records = r, replace(r, start=7.0), replace(r, sampling_time=1.0)
    found = [(axis.label, axis.values[1]) for axis in map(Axis.over_time, records)]
    since = "time since the first sample (s)", 0.1
    assert found == [since, ("time (s)", 7.1), ("sample", 1.0)]


def test_time_goes_on_when_summer_time_ends() -> None:
    """It is that of the clock at the beginning."""
    begin = pd.Timestamp("2024-10-26 20:00", tz="Europe/Berlin")
    r = replace(comparisons.record(), sampling_time=600.0, start=begin)
    hours = [Axis.over_time(r).values / 3.6e6, times_of(r).astype("datetime64[ms]").astype(float)]
    hours[1] /= 3.6e6
    for found in hours:
        np.testing.assert_allclose(np.diff(found), 1 / 6, rtol=1e-6)
        assert found[0] % 24 == pytest.approx(20)


def test_tooltips_tell_samples_apart_however_short_a_step_is() -> None:
    for step, decimals in ((0.1, 3), (1e-6, 7)):
        axis = Axis.over_time(replace(comparisons.record(), sampling_time=step))
        chart = Chart(axis, "y", (-1.0, 1.0), "caption")
        hovers: Any = chart.figure.select(HoverTool)
        assert hovers[0].tooltips[1][1] == f"$x{{0,0.[{'0' * decimals}]}}"


def test_an_output_and_an_input_called_simulator_keep_their_curves() -> None:
    r = comparisons.record(nu=1, columns=("simulator",), inputs=("simulator",))
    found: Any = plots.spectrum(replace(r, y_sim=100 * r.y), None, {})
    power, *coherences = found
    own, other = power.figure.renderers
    assert other.name == "simulator, simulator"
    drawn = power.data.data
    np.testing.assert_allclose(drawn[other.glyph.y], 1e4 * drawn[own.glyph.y], rtol=1e-6)
    assert len(coherences) == 2


def test_a_nameless_record_is_called_so(tmp_path: Path) -> None:
    found = comparisons.compared(comparisons.record(name=""), ("mean", "persistence"))
    found.report(tmp_path / "page.html")
    captions = [words_of(each) for each in parsed(tmp_path / "page.html").iter("caption")]
    assert any(each.startswith("a record: 200 samples") for each in captions)
    assert not any(each.startswith(":") for each in captions)
    assert rollouts(found).get_suptitle().startswith("a record; recommended: ")


def test_nothing_is_said_of_fits_that_are_unknown() -> None:
    """The fit to a single sample has no meaning."""
    found = comparisons.compared(comparisons.record(TRAIN + 1), ("mean", "persistence"), TRAIN)
    assert afterwards(found) == []
    found = comparisons.compared(comparisons.record(), ("mean", "persistence"))
    assert afterwards(found)


def test_thinning_keeps_every_peak_and_the_direction_of_smooth_curves() -> None:
    rng = np.random.default_rng(0)
    samples = 5 * MOST + 7
    y = rng.standard_normal(samples)
    y[1234], y[7777] = 50.0, -40.0
    for axis in (
        Axis.over(np.arange(float(samples)), "sample"),
        Axis.over_frequency(np.arange(1.0, samples + 1), "Hz"),
    ):
        x, drawn = axis.drawn, axis.thinned(y)
        assert len(x) == len(drawn) <= MOST
        assert (np.diff(x) >= 0).all()
        bins = np.split(y, axis.bins[1:])
        extremes = [[each.min(), each.max()] for each in bins]
        np.testing.assert_allclose(np.sort(drawn.reshape(-1, 2), axis=1), extremes, rtol=1e-6)
        assert (np.diff(axis.thinned(-axis.values)) <= 0).all()


def test_thinning_leaves_gaps_and_short_curves() -> None:
    short = Axis.over(np.arange(100.0), "sample")
    np.testing.assert_array_equal(short.thinned(short.values), short.values)
    y = np.arange(5.0 * MOST)
    axis = Axis.over(y, "sample")
    y[20:40] = np.nan
    drawn = axis.thinned(y)
    assert np.isnan(drawn[4:8]).all()
    assert np.isfinite(np.delete(drawn, range(4, 8))).all()
    lower, upper = axis.edges(y - 1, y + 1)
    assert lower[:4].tolist() == [-1, -1, 9, 9]
    assert upper[:4].tolist() == [10, 10, 20, 20]


def test_single_precision_is_used_only_where_nobody_sees_it() -> None:
    assert compact(np.linspace(0, 1, 50)).dtype == np.float32
    assert compact(1e8 + np.linspace(0, 1, 50)).dtype == np.float64
    assert compact(np.array([1e100, 0.0])).dtype == np.float64


def test_the_linear_model_shows_its_orders_and_its_gain_with_its_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    u = rng.standard_normal(400)
    y = scipy.signal.lfilter([0.0, 0.5, 0.2], [1.0, -1.5, 0.7], u)
    record = Record(y + 0.1 * rng.standard_normal(400), 0.1, u=u, inputs=("force",))
    found = comparisons.compared(record, ("linear", "mean"), 300)
    found.report(tmp_path / "report.html")
    model = found.trained("linear")
    assert isinstance(model, sb.Linear)
    section = parsed(tmp_path / "report.html").find(".//section[@id='linear']")
    figures = {
        words_of(f.find("figcaption")): f.find("div").get("aria-label")
        for f in section.iter("figure")
    }
    singular, held_out, gain = figures
    assert singular == "Singular values; dashed: the order 2"
    assert f"2: {number(float(model.model.values[1]))}" in figures[singular]
    least = 100 * model.model.held_out[model.model.orders.index(2)]
    assert f"2: {number(float(least))}" in figures[held_out]
    assert gain.startswith("Gain, force to y; shaded: 95 % interval, ±")


def test_the_page_of_a_driven_record_has_stairs_responses_and_poles() -> None:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(40), 10)
    y = scipy.signal.lfilter([0.0, 0.5], [1.0, -0.8], u) + 0.01 * rng.standard_normal(400)
    record = Record(y, 0.1, u=u, inputs=("force",))
    page = pages.of_comparison(comparisons.compared(record, ("linear", "mean"), 300), Usage())
    by_name: dict[str, Any] = {section.name: section for section in page.sections}
    assert [*by_name][:5] == ["answer", "plot", "methods", "residuals", "responses"]
    assert not by_name["residuals"].folded
    output, force = by_name["plot"].plots
    assert [key.text.split(":")[0] for key in output.key] == ["measured", "linear model", "mean"]
    assert type(force.figure.renderers[0].glyph).__name__ == "Step"
    step, gain, _ = by_name["responses"].plots
    assert (step.label, gain.label) == ("change", "gain (dB)")
    assert gain.figure.above[0].axis_label.text == "rad/s"
    (poles,) = by_name["linear"].tables
    _, pole = next(iter(poles.rows)).split()
    assert float(pole) == pytest.approx(0.8, abs=0.01)


def test_an_inspection_has_its_columns_and_the_loss_of_each_cutoff(tmp_path: Path) -> None:
    record = comparisons.record(ny=2, nu=1)
    record = replace(record, y_sim=0.9 * record.y)
    used = Usage([("Run", "splitband compare rig.csv")])
    page = pages.of_inspection(sb.inspect(record), used)
    document.write(page, tmp_path / "page.html")
    tree = parsed(tmp_path / "page.html")
    captions = [words_of(each).split(" ")[0] for each in tree.iter("figcaption")]
    assert captions == ["Spectrum;", "Coherence", "Coherence", "Loss:"]
    expected = (*record.columns, *record.inputs, "input: ", "splitband compare rig.csv")
    assert all(text in words_of(tree) for text in expected)

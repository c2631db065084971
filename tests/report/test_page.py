"""The page as a file: well formed, names escaped, whole or not there, small."""

from __future__ import annotations

import hashlib
import re
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
from splitband.checks.responses import respond_over_range
from splitband.comparison.result import Comparison
from splitband.forecasters.base import titled
from splitband.report import words
from splitband.report.page import document, frequency, over_time, pages
from splitband.report.page.charts import MOST, Axis, Chart
from splitband.report.page.parts import Usage, looks
from splitband.report.pictures import rollouts, times_of
from splitband.report.tables import labels_of, of_gains
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
    assert all(tree.find(f".//{landmark}") is not None for landmark in ("header", "main"))
    headings = [e.tag for e in tree.iter() if e.tag in ("h1", "h2", "h3")]
    assert headings.count("h1") == 1
    assert headings[:2] == ["h1", "h2"]
    for table in tree.iter("table"):
        assert "".join(table.find("caption").itertext()).strip()
        assert all(row.find("th").get("scope") == "row" for row in table.findall("./tbody/tr"))
    drawn = [e for e in tree.iter("div") if e.get("class") == "plot"]
    assert all(len(plot.get("aria-label")) > 40 and plot.get("role") == "img" for plot in drawn)
    identities = [e.get("id") for e in tree.iter() if e.get("id")]
    assert len(identities) == len(set(identities))
    assert written[kind].stat().st_size < 2e6


def test_the_page_says_what_it_must_and_names_are_escaped(
    written: dict[str, Path], everything: Comparison
) -> None:
    assert "<script>alert" not in written["comparison"].read_text(encoding="utf-8")
    tree = parsed(written["comparison"])
    assert comparisons.NASTY in tree.find(".//h1").text
    assert "splitband fit 'a <b>'" in [code.text for code in tree.iter("code")]
    said, best = words_of(tree), everything.recommended
    assert titled(best, labels_of(everything)[best]) in said
    words = "samples are masked", "a note", "Error by frequency band"
    assert all(each in said for each in (*words, "later, angle (rad)", "splitband compare 'a <b>'"))


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
    assert not pages.of_comparison(found, Usage()).views
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


def test_errors_by_band_are_those_of_known_sinusoids_and_gaps_do_not_count() -> None:
    """The error is a tenth of a slow sinusoid and twice a fast one; another method is the mean."""
    time = 0.01 * np.arange(4000)
    slow, fast = np.sin(2 * np.pi * 0.5 * time), 0.2 * np.sin(2 * np.pi * 20 * time)
    errors = {"model": 0.1 * slow + 2 * fast, "mean": slow + fast}
    errors["model"][:1000] = np.nan
    middles, ratios, share = frequency.error_spectra(slow + fast, errors, 100.0)
    low, high = (int(np.argmin(abs(np.log(middles / f)))) for f in (0.5, 20.0))
    assert ratios["model"][[low, high]] == pytest.approx([0.1, 2.0], rel=0.05)
    np.testing.assert_allclose(ratios["mean"], 1.0, rtol=1e-6)
    power = share[np.abs(np.log(middles / 0.5)) < 0.5].sum()
    assert power == pytest.approx(1 / 1.04, abs=0.01)


def test_an_error_beyond_all_numbers_has_a_place_in_the_plot() -> None:
    y = np.random.default_rng(0).standard_normal(500)
    _, ratios, _ = frequency.error_spectra(y, {"exploding": np.full(500, 1e300) * y}, 1.0)
    assert (ratios["exploding"] > 100).all()


def test_the_record_shows_its_parts_and_the_interval_of_the_residuals() -> None:
    """Training, held-out and test samples; the half-width around zero is that of the interval."""
    found = comparisons.compared(comparisons.record(), ("mean", "persistence"))
    names = [found.recommended]
    (run,) = over_time.runs_of(found, names)
    assert run.parts == {"training": (0, 149), "held-out": (150, 199), "test": (200, 299)}
    said = found.predictions[found.recommended]
    assert said.upper is not None
    assert run.half is not None
    np.testing.assert_allclose(run.half[TRAIN:], said.upper - said.y, rtol=1e-9)
    assert np.isnan(run.half[:TRAIN]).all()
    np.testing.assert_array_equal(run.curves[found.recommended][TRAIN:], said.y)
    plots = over_time.over_time(run, looks({names[0]: "the best"}))
    assert [key.name for key in plots[0].legend][:2] == ["measured", "the best"]
    assert plots[1].caption.endswith("measured minus predicted, the best; shaded: 90\xa0% interval")


def test_forecasts_ahead_are_drawn_in_place_of_the_free_run() -> None:
    """Each begins at the measurement, and none overlaps another."""
    r = comparisons.record()
    found = sb.compare(r, TRAIN, ["persistence", "mean"], ahead=10)
    (run,) = over_time.runs_of(found, ["persistence"])
    curve, drawn = run.curves["persistence"][:, 0], 0
    for at, said in sorted((o.at, p) for o, p in found.judging("persistence")[0][1].items()):
        if at >= drawn:
            np.testing.assert_array_equal(curve[at : at + 10], said.y[:, 0])
            drawn = at + 10
    assert np.isnan(curve[:TRAIN]).all()
    assert "forecasts 10 samples ahead" in run.says


def test_a_nameless_record_is_called_so(tmp_path: Path) -> None:
    found = comparisons.compared(comparisons.record(name=""), ("mean", "persistence"))
    found.report(tmp_path / "page.html")
    captions = [words_of(each) for each in parsed(tmp_path / "page.html").iter("caption")]
    assert any(each.startswith("a record: the training part has 200 samples") for each in captions)
    assert not any(each.startswith(":") for each in captions)
    assert rollouts(found).get_suptitle() == "a record: forecast after the training part"


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


@pytest.fixture(scope="module")
def driven() -> Comparison:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(40), 10)
    y = scipy.signal.lfilter([0.0, 0.5], [1.0, -0.8], u) + 0.01 * rng.standard_normal(400)
    record = Record(y, 0.1, u=u, inputs=("force",), name="rig")
    return comparisons.compared(record, ("linear", "mean"), 300)


def test_the_page_of_a_driven_record_has_its_order_stairs_responses_and_poles(
    driven: Comparison, tmp_path: Path
) -> None:
    data = tmp_path / "rig.csv"
    data.write_text("time,y\n", encoding="utf-8")
    page = pages.of_comparison(driven, Usage(files=[str(data), "overhead-crane"]))
    by_name: dict[str, Any] = {section.name: section for section in page.sections}
    order = "answer", "bands", "methods", "residuals", "responses", "linear", "made"
    assert [name for name in by_name if name != "notes"] == [*order]
    _, _, force = by_name["answer"].plots
    assert type(force.figure.renderers[0].glyph).__name__ == "Step"
    step, gain, _ = by_name["responses"].plots
    assert step.caption == "Step, force to y: static gain 2.5"
    assert "95 % interval" in [key.name for key in gain.keys]
    (poles,) = by_name["linear"].tables
    _, pole = next(iter(poles.rows)).split()
    assert float(pole) == pytest.approx(0.8, abs=0.01)
    made = dict(by_name["made"].facts)
    assert made["SHA-256 of rig.csv"] == hashlib.sha256(data.read_bytes()).hexdigest()
    assert "SHA-256 of overhead-crane" not in made


def test_the_table_has_fits_near_and_far_and_the_interval(driven: Comparison) -> None:
    """One sample ahead of measurements, the last value is nearer than in a free run."""
    page = pages.of_comparison(driven, Usage())
    (table,) = next(section for section in page.sections if section.name == "methods").tables
    *labels, interval = table.headings()
    assert labels == ["fit %", "fit % 1 sample ahead", "fit % 10 samples ahead", "RMSE"]
    assert interval.startswith("inside the 90")
    assert [*table.notes] == [*labels, interval]
    assert all(column.values[driven.recommended] > 0 for column in table.columns)


def test_an_integrator_has_no_static_gain() -> None:
    u = np.repeat(np.random.default_rng(1).standard_normal(40), 10)
    y = 0.1 * np.cumsum(np.append(0.0, u[:-1])) + 0.001 * np.random.default_rng(2).standard_normal(
        400
    )
    record = Record(y, 0.1, u=u, inputs=("speed",))
    found = comparisons.compared(record, ("linear", "mean"), 300)
    page = pages.of_comparison(found, Usage())
    steps = next(section for section in page.sections if section.name == "responses").plots
    assert steps[0].caption == "Step, speed to y: integrating"
    (gains,) = of_gains(respond_over_range(found.model))
    assert [column.entry("speed to y") for column in gains.columns] == ["integrating"]


def test_an_unstable_plant_has_a_warning_responses_and_no_free_run() -> None:
    rng = np.random.default_rng(0)
    x, u = np.zeros(600), np.zeros(600)
    for n in range(599):
        u[n] = -0.4 * x[n] + rng.standard_normal()
        x[n + 1] = 1.1 * x[n] + u[n]
    record = Record(x + 0.01 * rng.standard_normal(600), 0.1, u=u, inputs=("torque",), name="rod")
    found = sb.compare(record, 400, ["linear", "mean"], ahead=10)
    page = pages.of_comparison(found, Usage())
    sections = {section.name: section for section in page.sections}
    assert sections["answer"].warnings[0].startswith("The recommended model is unstable")
    step, *_ = sections["responses"].plots
    assert step.caption == "Step, torque to y"
    (table,) = sections["methods"].tables
    assert table.headings() == [
        "fit % 1 sample ahead",
        "fit % 10 samples ahead",
        "inside the 90\xa0% interval",
    ]


def test_the_answer_has_the_size_of_what_is_not_explained() -> None:
    """The model lacks the square of the input: no accusation without a size."""
    rng = np.random.default_rng(3)
    u = rng.uniform(-1, 1, 1000)
    y = scipy.signal.lfilter([0.0, 0.5], [1.0, -0.8], u) + 0.4 * np.append(0.0, u[:-1] ** 2)
    record = Record(y + 0.001 * rng.standard_normal(1000), 0.1, u=u, inputs=("speed",))
    found = comparisons.compared(record, ("linear", "mean"), 500)
    fit = found.table["forecast fit %"]["linear"]
    (first, *_) = words.answer(found)
    assert first.startswith(f"Simulation of 500 samples: fit {fit:.1f} %.")
    assert "still contain an effect of speed, perhaps a nonlinear one, which the model" in first
    (size,) = re.findall(r"RMS of ([\d.]+) % of its", first)
    assert float(size) == pytest.approx(100 - fit, abs=1.0)


def test_each_training_counts_in_the_spread_over_seeds(everything: Comparison) -> None:
    page = pages.of_comparison(everything, Usage())
    (table,) = next(section for section in page.sections if section.name == "seeds").tables
    assert [*table.rows] == ["persistence"]
    assert table.columns[-1].values == {"persistence": 2.0}


def test_an_inspection_has_its_columns_and_its_spectrum(tmp_path: Path) -> None:
    record = comparisons.record(ny=2, nu=1)
    record = replace(record, y_sim=0.9 * record.y)
    used = Usage([("Run", "splitband compare rig.csv")])
    page = pages.of_inspection(sb.inspect(record), used)
    document.write(page, tmp_path / "page.html")
    tree = parsed(tmp_path / "page.html")
    captions = [words_of(each).split(" ")[0] for each in tree.iter("figcaption")]
    assert captions == ["Spectrum;", "Coherence", "Coherence"]
    expected = (*record.columns, *record.inputs, "input: ", "splitband compare rig.csv")
    assert all(text in words_of(tree) for text in expected)

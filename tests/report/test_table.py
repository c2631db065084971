"""What the terminal, the page, results.json and the data frame show of a comparison agrees."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import html5lib
import numpy as np
import pytest

from splitband import rmse
from splitband.cli import printing
from splitband.comparison.backtest import WORTH_TRAINING
from splitband.comparison.result import Comparison
from splitband.forecasters.fitted import FitReport
from splitband.report import results, words
from splitband.report.environment import environment
from splitband.report.table import Column, Table
from splitband.report.tables import columns, labels_of, of_comparison
from tests.report import comparisons

SCALE = 1000.0
ROOT = Path(__file__).parents[2]


def of_two_seeds(found: Comparison, method: str = "mean", apart: float = 0.2) -> Comparison:
    """Two seeds of a method whose errors cancel in their median, but not in either of them."""
    (fit,) = found.fits[method]
    fits = []
    for seed, sign in enumerate((-1, 1)):
        said = {
            origin: replace(each, y=each.y + (1 + (origin.at == origin.fitted)) * sign * apart)
            for origin, each in fit.forecasts.items()
        }
        fits.append(comparisons.with_report(fit, FitReport(seed, 1.0), forecasts=said))
    return replace(found, fits={**found.fits, method: fits})


@pytest.fixture(scope="module")
def seeds() -> Comparison:
    return of_two_seeds(comparisons.compared(comparisons.record()))


@pytest.fixture(scope="module")
def scales() -> Comparison:
    """Two channels, of scales 1 and 1000."""
    r = comparisons.record(ny=2)
    y = r.y * np.array([1.0, SCALE])
    return comparisons.compared(replace(r, y=y, columns=("small", "large")))


def column(comparison: Comparison, heading: str, channel: str = "") -> Column:
    (found,) = [c for c in columns(comparison) if (c.heading, c.channel) == (heading, channel)]
    return found


def printed(comparison: Comparison, width: int = 400) -> str:
    """Return the table as a terminal of this width shows it, with all columns."""
    with printing.console.capture() as captured, pytest.MonkeyPatch.context() as patch:
        patch.setattr(printing.console, "width", width)
        patch.setattr(printing, "verbose", lambda: True)
        printing.table(of_comparison(comparison))
    return captured.get()


def page_text(comparison: Comparison, folder: Path) -> str:
    comparison.report(folder / "page.html")
    tree = html5lib.parse((folder / "page.html").read_text(encoding="utf-8"))
    return " ".join("".join(tree.itertext()).split())


def test_errors_are_of_the_median_of_seeds_with_their_spread_beside(seeds: Comparison) -> None:
    record, train = seeds.record, seeds.plan.train
    shown = column(seeds, "forecast RMSE")
    level = record.y[:train].mean()
    expected = rmse(record.y[train:], np.full((len(record) - train, 1), level))
    assert shown.values["mean"] == pytest.approx(expected)
    alone = [rmse(record.y[train:], run.ahead) for run in seeds.fits["mean"]]
    assert shown.spreads == {"mean": pytest.approx(np.std(alone, ddof=1))}
    assert np.mean(alone) > 1.05 * expected  # what was shown before


def test_every_renderer_shows_the_same_numbers(seeds: Comparison, tmp_path: Path) -> None:
    terminal, page = printed(seeds), page_text(seeds, tmp_path)
    facts = {fact["heading"]: fact["values"] for fact in results.results(seeds)["table"]}
    for c in columns(seeds):
        assert facts[c.heading] == dict(c.values)
        assert dict(seeds.table[c.title].dropna()) == pytest.approx(dict(c.values))
        for name in c.values:
            assert c.entry(name) in terminal
            if c.heading in ("forecast fit %", "forecast RMSE", "in interval"):
                assert " ".join(c.entry(name).split()) in page


@pytest.mark.parametrize("best", ["mean", "persistence"])
def test_the_text_names_the_method_that_the_table_marks(seeds: Comparison, best: str) -> None:
    """Whichever is recommended: "gru did better (0.345)" stood above a bold 0.373 of linear."""
    other = "persistence" if best == "mean" else "mean"
    trial = seeds.require_trial()
    final = best, other
    scores = {best: 0.1, other: 9.0}
    two = {name: seeds.fits[name] for name in final}
    found = replace(seeds, fits=two, trial=replace(trial, final=final, scores=scores))
    assert found.recommended == best
    shown = column(found, "forecast fit %")
    said = " ".join(words.afterwards(found))
    assert f"fit {shown.entry(best)} %" in str(words.headline(found))
    if shown.best == best:
        assert "No other method with a result had a better fit." in said
    else:
        assert f"{labels_of(found)[shown.best]} {shown.entry(shown.best)} %" in said


def test_what_casts_doubt_stands_before_the_plots(seeds: Comparison, tmp_path: Path) -> None:
    trial = seeds.require_trial()
    held = {n: replace(each, deviation=0 * each.deviation) for n, each in trial.held_out.items()}
    grows = FitReport(growth=1.05, reach=20)
    unstable = [comparisons.with_report(fit, grows) for fit in seeds.fits["mean"]]
    fits = {**seeds.fits, trial.recommended: unstable}
    trial = replace(trial, held_out=held, failed={"gru": "it diverged"})
    doubtful = replace(seeds, fits=fits, trial=trial)
    said = " ".join(words.warnings(doubtful))
    assert said.startswith("The recommended model is unstable")
    assert "No method predicts this record better than the mean of the predicted samples" in said
    assert "as wide as the record itself" in said
    assert "GRU (gru): no result: it diverged." in said
    page = page_text(doubtful, tmp_path)
    assert page.index("The recommended model is unstable") < page.index("measured and predicted")
    assert "as wide as the record" in page
    assert "no result: it diverged" in page


def test_an_interval_that_held_too_few_or_too_many_samples_says_so_beside_its_share(
    seeds: Comparison, tmp_path: Path
) -> None:
    best, trial = seeds.recommended, seeds.require_trial()
    held = trial.held_out[best]
    for scale, mark in ((0.05, "narrow"), (30.0, "wide")):
        scaled = replace(held, errors=tuple(scale * e for e in held.errors))
        scaled = replace(scaled, bounded=np.zeros_like(held.bounded))
        changed = replace(trial, held_out={**trial.held_out, best: scaled})
        found = replace(seeds, trial=changed)
        said = column(found, "in interval").entry(best)
        assert said.endswith(f"% ({mark})")
        assert " ".join(said.split()) in " ".join(printed(found).split())
        ((_, facts),) = words.headline(found)
        assert facts[-1].replace("\xa0", " ").startswith("inside the 90 % interval: ")
        assert facts[-1].endswith(said)
        assert " ".join(said.split()) in page_text(found, tmp_path)
        (stored,) = [c for c in results.results(found)["table"] if c["heading"] == "in interval"]
        assert stored["marks"][best] == mark


def test_each_channel_has_errors_of_its_own(scales: Comparison, tmp_path: Path) -> None:
    record, train = scales.record, scales.plan.train
    terminal, page = printed(scales), page_text(scales, tmp_path)
    for i, channel in enumerate(record.columns):
        y, held = record.y[train:, i], record.y[train - 1, i]
        shown = column(scales, "forecast RMSE", channel)
        expected = np.sqrt(np.mean((y - held) ** 2))
        assert shown.values["persistence"] == pytest.approx(expected)
        assert shown.entry("persistence") in terminal
        fit = column(scales, "forecast fit %", channel)  # as MATLAB prints it
        assert f"{channel} {fit.entry('persistence')}" in page
        expected = 100 * (1 - np.linalg.norm(y - held) / np.linalg.norm(y - y.mean()))
        assert fit.values["persistence"] == pytest.approx(expected)
        assert fit.best != "persistence"
    headings = {c.heading for c in columns(scales) if c.channel}
    assert headings >= {"held-out RMSE", "forecast RMSE", "in interval"}


def test_what_is_recommended_has_the_lowest_score(scales: Comparison) -> None:
    """The errors of channels of different scale do not show it: the second would decide alone."""
    assert column(scales, "score").best == scales.recommended
    trial = replace(scales.require_trial(), trained=frozenset([scales.recommended]))
    dearer = replace(scales, trial=trial)
    expected = trial.scores[scales.recommended]
    found = column(dearer, "score").values[scales.recommended]
    assert found == pytest.approx(expected * (1 + WORTH_TRAINING))


def test_a_channel_that_was_never_measured_after_training_has_no_number() -> None:
    nothing = Column("forecast RMSE", "record", {"mean": np.nan, "linear": 1.0})
    assert (nothing.entry("mean"), nothing.best) == ("–", "linear")  # noqa: RUF001
    assert nothing.entry("gru") == "–"  # noqa: RUF001


def test_rows_are_in_the_order_of_the_score_and_the_recommended_one_is_marked(
    scales: Comparison,
) -> None:
    scores = column(scales, "score").values
    assert [*scales.table.index] == sorted(scores, key=lambda name: scores[name])
    first = next(line for line in printed(scales).splitlines() if "*" in line)
    assert labels_of(scales)[scales.recommended] in first


@pytest.mark.parametrize("ny", [1, 2])
@pytest.mark.parametrize("width", [60, 80, 100])
def test_a_terminal_folds_words_and_shows_every_number(
    ny: int, width: int, seeds: Comparison, scales: Comparison
) -> None:
    found = seeds if ny == 1 else scales
    table = of_comparison(found)
    text = replace(table, title="", rows=dict.fromkeys(table.rows, "")).as_text(width)
    assert max(map(len, text.splitlines())) <= width
    words_of_table = " ".join(text.split())
    for column in columns(found):
        shown = column.heading != "score"
        for name in column.values if shown else ():
            assert column.entry(name).split()[0] in words_of_table
    assert "score" not in text
    (marked,) = [line for line in text.splitlines() if "* " in line]
    assert labels_of(found)[found.recommended].startswith(marked.split()[1])
    assert text.encode("cp1252")
    if width == 100:
        assert text in str(found)


@pytest.mark.parametrize("width", [20, 40, 60, 100])
def test_a_terminal_that_is_too_narrow_for_a_table_cuts_no_number(
    width: int, scales: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table that is cut at the edge shows 98.75 as 98."""
    monkeypatch.setattr(printing.console, "width", width)
    monkeypatch.setattr(printing.console, "soft_wrap", False)
    with printing.console.capture() as captured:
        printing.table(of_comparison(scales))
    said = captured.get().split()
    for column in columns(scales):
        for name in column.values if column.heading != "score" else ():
            assert column.entry(name).split()[0] in said


def test_reasons_have_columns_of_their_own_on_request() -> None:
    name = "filtered-state-space-calibrated-conditioned"
    numbers = {name: 0.123, "mean": 0.5}
    listed = [Column("forecast fit %", "percent", dict.fromkeys(numbers, 90.0))]
    listed += [Column("score", "deviation", numbers)]
    words = {name: "calibrated simulator below 0.15 Hz, state-space network above", "mean": "mean"}
    table = Table("", listed, dict.fromkeys(numbers, ""), recommended=name, labels=words)
    for details in (False, True):
        with printing.console.capture() as captured:
            printing.console.print(table.drawn(details))
        said = captured.get()
        assert ("score" in said) == ("0.123" in said) == details
        first = "".join(line.split("│")[1] for line in said.splitlines() if "│" in line)
        assert "(filtered-state-space-" in first.replace(" ", "")
        assert "…" not in said


def test_a_notebook_shows_every_number(seeds: Comparison) -> None:
    shown = " ".join(seeds._repr_html_().split())
    entries = (c.entry(name) for c in columns(seeds) for name in c.values)
    assert all(" ".join(entry.split()) in shown for entry in entries)


def test_rows_of_different_channels_have_the_lines_that_they_have() -> None:
    """As results of different records do."""
    listed = [
        Column("fit %", "percent", {"arm": 90.0}, "x", ranked=False),
        Column("fit %", "percent", {"arm": 80.0}, "y", ranked=False),
        Column("fit %", "percent", {"pump": 70.0}, ranked=False),
        Column("score", "deviation", {"arm": 0.5, "pump": 0.25}, ranked=False),
    ]
    text = Table("", listed, {"arm": "", "pump": "", "none": ""}).as_text()
    rows = "arm", "x 90.0", "y 80.0", "pump 70.0", "none –"  # noqa: RUF001
    assert [line.split() for line in text.splitlines()[1:]] == [row.split() for row in rows]


def test_a_test_record_has_a_line_of_its_own_beside_the_record() -> None:
    numbers = {"arm": 90.0}
    own, test = (Column(f"{of} fit %", "percent", numbers) for of in ("forecast", "test"))
    alone = Table("", [replace(test, record="later")], {"arm": ""})
    both = Table("", [replace(own, values={"arm": 80.0}), *alone.columns], {"arm": ""})
    rows = [["arm", "90.0"]], [["arm", "80.0"], ["later", "90.0"]]
    for table, expected in zip((alone, both), rows, strict=True):
        lines = table.as_text().splitlines()[1:]
        assert [line.split() for line in lines] == expected


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ([0.0935, 1.7, 6.99], ["0.0935", "1.7000", "6.9900"]),
        ([12.3, 456.0, 1e9], ["12.3", "456.0", "1.00e+09"]),
        ([0.0, 0.5], ["0.000", "0.500"]),
    ],
)
def test_a_column_has_one_number_of_digits(values: list[float], shown: list[str]) -> None:
    names = "abc"[: len(values)]
    listed = Column("forecast RMSE", "record", dict(zip(names, values, strict=True)))
    assert [listed.entry(name) for name in names] == shown


def test_a_result_names_the_commit_of_its_checkout() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("this is no checkout: an unpacked source distribution has no commit")
    head = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    commit = environment()["commit"]
    assert commit
    assert head.startswith(commit.removesuffix("-dirty"))

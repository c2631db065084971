"""The page of a record's spectrum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from splitband.data import Record
from splitband.filters.cutoff import Choice
from splitband.report.numbers import number, percent
from splitband.report.page import tables, words
from splitband.report.page.about import lead, settings
from splitband.report.page.parts import Page, Section
from splitband.report.page.spectra import spectrum
from splitband.report.page.usage import Usage


@dataclass(frozen=True, eq=False)
class SpectrumReport:
    """What `splitband spectrum` has found.

    Attributes
    ----------
    record : All that was found_spectrum at.
    cutoff, choice : Which it is, and why.
    facts : The rest, as in results.json.
    """

    record: Record
    cutoff: float
    choice: Choice | None
    facts: Mapping[str, Any]


def page(found_spectrum: SpectrumReport, used: Usage) -> Page:
    """All of it."""
    record, facts = found_spectrum.record, found_spectrum.facts
    below = facts["share_below"]
    text = [
        f"Of the first {facts['train']:,} samples {percent(below)} of the power lies below the "
        f"cut-off and {percent(1 - below)} above. The bands of a filter pair of order "
        f"{facts['order']} add up to the record with RMSE {number(facts['reconstruction_rmse'])}, "
        "all of it at the ends."
    ]
    if found_spectrum.choice is not None:
        reason = found_spectrum.choice.reason
        text.append(f"Chosen by the first {facts['train']:,} samples: {reason}.")
    numbers = [("cut-off (Hz)", number(found_spectrum.cutoff)), ("power below", percent(below))]
    sections = [
        Section(
            "answer", f"Cut-off at {number(found_spectrum.cutoff)} Hz", text, words.of_gaps(record),
            facts=numbers,
        ),
        Section(
            "spectrum", "Spectrum", ["These plots zoom together."],
            plots=spectrum(record, found_spectrum.cutoff, found_spectrum.choice, {}),
        ),
        _peaks(facts["peaks"]),
    ]  # fmt: skip
    if "simulator" in facts:
        sections.append(_simulator(facts["simulator"]))
    sections.append(settings([], used))
    return Page(f"{record.name or 'a record'}: where its power lies", lead(record), sections)


def _peaks(peaks: Sequence[Mapping[str, float]]) -> Section:
    rows = [[p["frequency"], 1 / p["frequency"], p["share"]] for p in peaks]
    headings = ["frequency (Hz)", "period (s)", "share of the power"]
    caption = "The strongest peaks; shares are between 0 and 1"
    return Section("peaks", "Peaks", tables=[tables.plain(caption, headings, rows)])


def _simulator(facts: Mapping[str, Any]) -> Section:
    rows = [[o["cutoff"], o["perfect_network"], o["no_network"]] for o in facts["oracle"]]
    text = [
        f"The simulator itself has RMSE {number(facts['total_rmse'])}; up to the cut-off its mean "
        f"coherence with the record is {facts['mean_coherence_below_cutoff']:.2f}.",
        "A lower cut-off leaves more to the network.",
    ]
    if facts.get("training", {}).get("nothing_to_learn"):
        text.append(
            "On the training samples the low-passed simulator alone is better than with a network "
            "that is exactly right: there is nothing to learn unless it is calibrated."
        )
    headings = ["cut-off (Hz)", "with a perfect network", "without one"]
    caption = "What a hybrid model could reach at each cut-off: RMSE"
    table = tables.plain(caption, headings, rows)
    return Section("simulator", "Simulator", text, tables=[table])

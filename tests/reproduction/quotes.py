"""Sentences of the documents that state a figure, and the file of results that has it.

A sentence stands in `quotes` below with braces in place of the figures, and where these are found.
"""

from __future__ import annotations

import json
import re
import statistics
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.sets import SETS
from reproduction import published
from splitband.evaluation.search import SECONDS
from splitband.forecasters.names import QUICK

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
RESULTS = DOCS / "results"
README, DEVIATIONS, WHY = "README.md", "docs/deviations.md", "docs/why.md"
RELIABILITY, TUNING = "docs/reliability.md", "docs/results/tuning.md"
RULES = "docs/theory/rules.md"
SIMULATORS, SPEED, PAPER = "docs/theory/simulators.md", "docs/speed.md", "docs/reproducing.md"

WHOLE = (README, WHY, SIMULATORS, SPEED, PAPER)
"""Documents of which every decimal number is looked up."""
NO_RESULT = (
    "Python 3.11 or newer",
    "level=0.9",
)
"""What looks like a figure in them and is none."""


@dataclass(frozen=True)
class Quote:
    """A sentence of a document, `{}` for each figure, and the figures as files have them."""

    document: str
    sentence: str
    figures: tuple[float | str, ...]

    @property
    def text(self) -> str:
        return one_line(self.sentence.format(*self.figures))


@cache
def _json(path: str) -> Any:
    return json.loads((DOCS / path).read_text(encoding="utf-8"))


def _at(path: str, *keys: str) -> Any:
    found = _json(path)
    for key in keys:
        found = found[key]
    return found


def _row(table: str, system: str, method: str) -> dict[str, Any]:
    rows: list[dict[str, Any]] = _at(f"results/tables/{table}.json", "rows")
    return next(row for row in rows if (row["system"], row["method"]) == (system, method))


def _mean(table: str, system: str, method: str) -> float:
    return statistics.mean(_row(table, system, method)["total_rmse"])


def _handed_out(facts: dict[str, Any], key: str) -> float:
    """The error of the mean of a method's seeds."""
    return float((facts["mean_of_seeds"] or {key: facts[key][0]})[key])


def _of_seeds(facts: dict[str, Any], key: str) -> str:
    """As a table shows it: the error of the mean of the seeds, and how far these spread."""
    spread = facts.get(f"{key}_std")
    shown = f"{_handed_out(facts, key):.3f}"
    return shown if spread is None else f"{shown} ± {spread:.3f}"


def _number(text: str, after: str) -> float:
    """The number that stands behind a word in a description."""
    found = re.search(rf"{after} (-?[\d.]+\d)", text)
    assert found, (text, after)
    return float(found[1])


def one_line(text: str) -> str:
    return " ".join(text.split())


@cache
def quotes() -> tuple[Quote, ...]:
    return (
        *_compared(), *_beyond(), *_why(), *_filter_or_not(), *_how_sure(), *_speed(), *_paper(),
        *_deviations(), *_reliability(), *_tuned(),
    )  # fmt: skip


def _reliability() -> Iterator[Quote]:
    """What stands below the table of recommendations with networks."""
    found = _at("benchmarks/recommendation-default.json", "found")
    others = [facts for facts in found if facts["kind"] not in ("trend", "decay")]
    yield Quote(RELIABILITY, "Without these two records the mean regret is {:.2f}",
                (statistics.geometric_mean(facts["regret"] for facts in others),))  # fmt: skip
    over = {facts["kind"]: facts["over_baselines"] for facts in found}
    assert [k for k, of in _at("benchmarks/recommendation-default.json", "kinds").items()
            if of["networks"]] == ["Lorenz", "Mackey-Glass", "trend", "tanks, driven"]  # fmt: skip
    yield Quote(
        RELIABILITY,
        "Over the {} records that neither gains nor loses: the error over that without networks is "
        "{:.2f} on geometric average, {:.2f} on the tanks and {:.2f} on the trend",
        (len(found), statistics.geometric_mean(over.values()), over["tanks, driven"],
         over["trend"]),
    )  # fmt: skip
    baselines = _at("benchmarks/recommendation.json", "found")
    (with_networks, alone), (of_baselines, of_baselines_alone) = (
        [statistics.geometric_mean(facts[key] for facts in of)
         for key in ("regret", "regret_by_held_out_alone")]
        for of in (found, baselines)
    )  # fmt: skip
    yield Quote(
        RELIABILITY,
        "the mean regret on these {} records would have been {:.2f} instead of {:.2f}, as the "
        "trend would have been right; on the {} records above it would have been {:.2f} instead of "
        "{:.2f}",
        (len(found), alone, with_networks, len(baselines), of_baselines_alone, of_baselines),
    )
    yield Quote(
        RULES,
        "to {:.2f}; by the held-out error alone it would be {:.2f}. With networks there is none: "
        "on {} records it is {:.2f}, by the held-out error alone {:.2f}",
        (of_baselines, of_baselines_alone, len(found), with_networks, alone),
    )
    worst = max(baselines, key=lambda facts: float(facts["regret"]))
    errors = {name: of["error"] for name, of in worst["methods"].items()}
    assert (worst["recommended"], min(errors, key=errors.__getitem__)) == ("mean", "harmonic")
    yield Quote(RELIABILITY, "The worst regret, {:.2f}, is that of a {}",
                (worst["regret"], worst["kind"]))  # fmt: skip
    networks = [
        [facts for name, facts in of["methods"].items() if name not in QUICK] for of in found
    ]
    every = [facts["inside"] for of_record in networks for facts in of_record]
    best = [min(of, key=lambda facts: float(facts["held_out"]))["inside"] for of in networks]
    yield Quote(
        RELIABILITY,
        "The intervals of all {} networks hold {:.0f} % of the samples, those of the network with "
        "the lowest held-out error {:.0f} %.",
        (len(every), 100 * statistics.mean(every), 100 * statistics.mean(best)),
    )


def _compared() -> Iterator[Quote]:
    """The table of README.md and what stands beside it, by `splitband compare`."""
    yield Quote(README, "It is done within {:.0f} minutes at most", (SECONDS / 60,))
    shown = _at("results/demo.json", "methods")
    yield Quote(
        README,
        "the simulator is off by {:.2f} m, a GRU by {:.2f} m, and `{}`, which is recommended, by "
        "{:.2f} m",
        (shown["simulator"]["forecast_rmse"][0], shown["gru"]["forecast_rmse"][0],
         _at("results/demo.json", "recommended"),
         shown[_at("results/demo.json", "recommended")]["forecast_rmse"][0]),
    )  # fmt: skip
    of = _at("results/drill-string.json", "methods")
    recommended = _at("results/drill-string.json", "recommended")
    for name, facts in of.items():
        start, ahead = (_of_seeds(facts, key) for key in ("total_rmse", "forecast_rmse"))
        held_out = f"{facts['held_out_rmse']:.3f}"
        change = f"{facts['change']:.3f}" if facts["change"] else "0"
        covers = f"{100 * facts['interval']['covers']:.0f} %"
        label = name
        if name == recommended:
            label, held_out = f"**{name}** (recommended)", f"**{held_out}**"
            start, ahead = (re.sub(r"^[\d.]+", r"**\g<0>**", cell) for cell in (start, ahead))
        yield Quote(README, "| {} | {} | {} | {} | {} | {} |",
                    (label, held_out, change, start, ahead, covers))  # fmt: skip
    yield Quote(README, "simulator below {:.2f} Hz, network above",
                (_at("results/drill-string.json", "settings", "cutoff"),))  # fmt: skip
    yield Quote(
        README,
        "gain {:.3f}, offset {:.3f}, delay {:.3f} s",
        tuple(
            _number(of["simulator-calibrated"]["description"], term)
            for term in ("gain", "offset", "delay")
        ),
    )
    for name, words, number in (
        ("seasonal-naive", "the last", "the last {:.0f} samples, repeated"),
        ("periodic", "a period of", "harmonics of a period of {:.0f} samples"),
    ):
        yield Quote(README, number, (_number(of[name]["description"], words),))
    yield Quote(README, "The paper's best on this record is {:.3f}.",
                (published.HYBRID_RNN["vi"]["filtered-rnn"].mean,))  # fmt: skip
    of = _at("results/double-torsion.json", "methods")
    yield Quote(
        WHY,
        "recommends the mean over its periods, {:.3f}, where seasonal-naive has {:.3f} and a GRU "
        "{:.3f} ({:.2f})",
        (of["periodic"]["total_rmse_mean"], of["seasonal-naive"]["total_rmse_mean"],
         of["gru"]["total_rmse_mean"], of["gru"]["total_rmse_std"]),
    )  # fmt: skip


def _tuned() -> Iterator[Quote]:
    """What `compare` has without tuning, on the torsion record."""
    of = _at("results/double-torsion.json", "methods")
    networks = [name for name, facts in of.items() if facts.get("mean_of_seeds")]
    name = min(networks, key=lambda name: float(of[name]["held_out_rmse"]))
    mean = of[name]["mean_of_seeds"]
    yield Quote(
        TUNING,
        "| {}, the network with the lowest held-out error | {:.3f} | {:.3f} | {:.3f} |",
        (name, of[name]["held_out_rmse"], mean["total_rmse"], mean["forecast_rmse"]),
    )


def _beyond() -> Iterator[Quote]:
    """What calibration and conditioning do."""
    of = _at("results/beyond/v.json", "methods")
    raw, calibrated = (
        of[name]["total_rmse_mean"] for name in ("simulator", "simulator-calibrated")
    )
    note = of["simulator-calibrated"]["description"]
    terms = _number(note, "delay"), _number(note, "clock")
    yield Quote(
        SIMULATORS,
        "delay {:.2f} s, clock {:.4f}; the simulator's error falls from {:.3f} to {:.3f} with",
        (*terms, raw, calibrated),
    )
    yield Quote(
        DEVIATIONS,
        "(v): {:.3f} becomes {:.3f}, delay {:.2f} s and clock {:.4f} found",
        (raw, calibrated, *terms),
    )
    filtered = (
        f"filtered-gru{s}" for s in ("-calibrated-conditioned", "-calibrated", "-conditioned")
    )
    yield Quote(
        SIMULATORS,
        "Van der Pol: {:.3f} with the network in the high band ({:.3f} calibrated alone, {:.3f} "
        "conditioned alone) and {:.3f} with it added to the simulator, without a filter; the "
        "paper's best is {:.3f}.",
        (*(of[name]["total_rmse_mean"] for name in filtered),
         of["residual-gru-calibrated-conditioned"]["total_rmse_mean"],
         published.HYBRID_RNN["v"]["filtered-rnn"].mean),
    )  # fmt: skip
    for document in (SIMULATORS, WHY):
        yield Quote(document, "periodic regression has {:.3f} with no network",
                    (of["periodic"]["total_rmse_mean"],))  # fmt: skip
    yield Quote(WHY, "the best hybrid has {:.3f}",
                (of["residual-gru-calibrated-conditioned"]["total_rmse_mean"],))  # fmt: skip


def _why() -> Iterator[Quote]:
    """Where a network is worth its training, and where it is not."""
    decays = _at("results/beyond/pendulum-iv.json", "methods")
    yield Quote(WHY, "is recommended and has {:.3f}; a GRU has {:.3f}",
                tuple(decays[name]["total_rmse_mean"] for name in ("harmonic", "gru")))  # fmt: skip
    masses, tanks, duffing = (
        [_at("benchmarks/inputs.json", record, "methods", name) for name in names]
        for record, names in (("two masses", ("linear", "gru")), ("tanks", ("gru", "linear")),
                              ("Duffing", ("split-gru", "linear", "gru", "mean")))
    )  # fmt: skip
    start, ahead = "total_rmse_mean", "forecast_rmse_mean"
    yield Quote(WHY, "the forecast of the linear model has an error of {:.4f}, a GRU's {:.4f}",
                tuple(of[ahead] for of in masses))  # fmt: skip
    yield Quote(WHY, "Two tanks: the forecast's error is {:.3f} with a GRU, {:.2f} with the linear",
                tuple(of[ahead] for of in tanks))  # fmt: skip
    yield Quote(
        RULES,
        "errors of the forecast: two masses on springs, linear, {:.4f} where a GRU has {:.4f}; two "
        "tanks {:.2f} and {:.3f}; a Duffing oscillator {:.2f} and {:.2f}, where a split GRU has "
        "{:.2f}",
        tuple(of[ahead] for of in (*masses, *tanks[::-1], *duffing[1:3], duffing[0])),
    )
    yield Quote(
        WHY,
        "error is {:.2f} with a split GRU and {:.2f} with a GRU alone, averaged over their seeds; "
        "the linear model is recommended, as the networks' forecasts changed by more than their "
        "held-out errors, and has {:.2f}, hardly better than the mean's {:.2f}. From the start of "
        "this record on the split GRU has {:.2f}, the linear model {:.2f} and the mean {:.2f}.",
        (
            *(duffing[i][ahead] for i in (0, 2, 1, 3)),
            *(of[start] for of in (*duffing[:2], duffing[3])),
        ),
    )
    assert _at("benchmarks/inputs.json", "Duffing", "recommended") == "linear"
    assert all(of["change"] > of["held_out_rmse"] for of in (duffing[0], duffing[2]))
    cycle = [
        _at("benchmarks/inputs.json", "tanks and cycle", "methods", name)
        for name in ("residual-linear-gru-conditioned", "linear", "gru")
    ]
    assert _at("benchmarks/inputs.json", "tanks and cycle", "recommended") == "linear"
    yield Quote(
        RULES,
        "held out {:.2f}, where the linear model has {:.2f} and a GRU {:.2f}; in the forecast "
        "{:.2f}, {:.2f} and {:.2f}. The linear model is recommended all the same, as the forecasts "
        "on top of it changed by {:.2f}.",
        (*(of["held_out_rmse"] for of in cycle), *(of[ahead] for of in cycle), cycle[0]["change"]),
    )
    found = _at("benchmarks/recommendation-default.json", "found")
    other = next(facts for facts in found if facts["kind"] == "duffing, driven")
    errors = {name: facts["error"] for name, facts in other["methods"].items()}
    assert (other["recommended"], min(errors, key=errors.__getitem__)) == ("linear", "gru")
    yield Quote(WHY, "whose forecast's error is {:.2f} times that of the best, a GRU",
                (other["regret"],))  # fmt: skip
    of = _at("results/drill-string.json", "methods")
    hybrid, gru = of["filtered-gru-calibrated-conditioned"], of["gru"]
    yield Quote(
        WHY,
        "its error is {:.3f}, where the simulator has {:.3f}, the best of the simple methods "
        "{:.3f} and a GRU alone {:.3f}. In the forecast, the GRU alone has {:.3f} and the hybrid "
        "{:.3f}.",
        (*(_handed_out(each, "total_rmse")
           for each in (hybrid, of["simulator"], of["harmonic"], gru)),
         *(_handed_out(each, "forecast_rmse") for each in (gru, hybrid))),
    )  # fmt: skip
    assert gru["change"] == max(facts["change"] for facts in of.values())
    yield Quote(WHY, "the GRU's error is {:.3f} and the hybrid's {:.3f}",
                (gru["held_out_rmse"], hybrid["held_out_rmse"]))  # fmt: skip
    found = _at("results/benchmarks/tanks-0.json", "methods", "gru", "mean_of_seeds", "test_rmse")
    others = {
        name: float(score)
        for name, (score,) in SETS["tanks"].published.items()
        if "box" not in name
    }
    linear = others.pop("linear state space (Champneys et al., 2024)")
    yield Quote(
        WHY,
        "with an error of {:.3f} V on the test file; a linear model has {:.3f}, and published "
        "black boxes have {:.2f} to {:.3f}",
        (found[0], linear, min(others.values()), max(others.values())),
    )


def _filter_or_not() -> Iterator[Quote]:
    """A network above a cut-off against one that is added to the simulator."""
    pair = [f"{kind}-gru-calibrated-conditioned" for kind in ("filtered", "residual")]
    v, vi, searched = (
        [_at(path, "methods", name) for name in pair]
        for path in ("results/beyond/v.json", "results/beyond/vi.json", "results/drill-string.json")
    )
    demo = [
        _at("results/demo.json", "methods", f"{kind}-gru-conditioned")
        for kind in ("filtered", "residual")
    ]
    yield Quote(
        WHY,
        "{:.3f} filtered and {:.3f} residual; on the drill string {:.3f} ({:.3f}) and {:.3f} "
        "({:.3f}) by the default recipe, and {:.3f} and {:.3f} where training has been "
        "searched. In the demo, where nothing is calibrated, the forecast has {:.2f} and {:.2f}.",
        (
            *(of["total_rmse_mean"] for of in v),
            *(of[key] for of in vi for key in ("total_rmse_mean", "total_rmse_std")),
            *(of["total_rmse_mean"] for of in searched),
            *(of["forecast_rmse_mean"] for of in demo),
        ),
    )


def _how_sure() -> Iterator[Quote]:
    """What the recommended method's forecast has of the best one's error, beyond the paper."""
    ratios = []
    for name in ("double-torsion-record", "pendulum-ii", "pendulum-iii", "pendulum-iv", "v", "vi"):
        facts = _json(f"results/beyond/{name}-default.json")
        errors = {m: of["forecast_rmse_mean"] for m, of in facts["methods"].items()}
        ratios.append(errors[facts["recommended"]] / min(errors.values()))
    yield Quote(
        WHY,
        "has {:.2f}, {:.2f}, {:.2f}, {:.2f}, {:.2f} and {:.2f} times the error of the best "
        "method's, in order of size",
        tuple(sorted(ratios)),
    )


def _speed() -> Iterator[Quote]:
    one, two = (_at("benchmarks/rollout.json", f"GRU, {n} threads") for n in (1, 2))
    yield Quote(SPEED, "batch 50, window 150: ours | {:.1f} ms | {:.1f} ms |",
                (one["kernel, ms"], two["kernel, ms"]))  # fmt: skip
    for label, key in (
        ("a loop over `torch.nn.GRU`, step by step", "nn.GRU, step by step"),
        ("tsfast, autoregressive GRU", "tsfast AR_Model"),
        ("JAX `scan`, compiled whole, always on two threads", "JAX scan"),
    ):
        ratios = tuple(of[f"{key} / kernel"] for of in (one, two))
        yield Quote(SPEED, f"| {label} | {{:.1f}} | {{:.1f}} |", ratios)
    one, two = (_at("benchmarks/rollout.json", f"EulerMLP, {n} threads") for n in (1, 2))
    yield Quote(SPEED, "batch 50, window 200: ours | {:.0f} ms | {:.0f} ms |",
                (one["kernel, ms"], two["kernel, ms"]))  # fmt: skip
    yield Quote(SPEED, "| the loop in torch | {:.1f} | {:.1f} |",
                (one["plain loop / kernel"], two["plain loop / kernel"]))  # fmt: skip
    faster = (min(of[f"tsfast NeuralStateSpace, {b} / kernel"] for b in ("eager", "C"))
              for of in (one, two))  # fmt: skip
    yield Quote(SPEED, "its faster backend | {:.1f} | {:.1f} |", tuple(faster))
    one, two = (_at("benchmarks/system_i.json", f"{n} threads") for n in (1, 2))
    yield Quote(
        SPEED,
        "trains in {:.1f} s on one thread and {:.1f} s on two (the paper: {:.0f} s; our own loop: "
        "{:.0f} s and {:.0f} s)",
        (one["kernels, s"], two["kernels, s"], published.SECONDS["i"]["split-gru"].mean,
         one["plain loop, s"], two["plain loop, s"]),
    )  # fmt: skip
    yield Quote(
        SPEED,
        "of (50, 1500) samples, forward and backward, takes {:.1f} times SciPy's forward pass",
        (_at("benchmarks/filters.json", "(50, 1500)", "zero-phase / SciPy filtfilt"),),
    )


def _paper() -> Iterator[Quote]:
    """The paper's tables, in the documents."""
    off = [
        100 * abs(_mean("hybrid-gru", "vi", name) / published.HYBRID_GRU["vi"][name].mean - 1)
        for name in ("filtered-gru", "residual-gru")
    ]
    yield Quote(PAPER, "are reproduced to {:.0f} and {:.0f} %", tuple(off))
    yield Quote(
        PAPER,
        "at the paper's settings, {:.3f} where the paper has {:.3f}",
        (_mean("learning-based", "i", "split-gru"),
         published.LEARNING_BASED["i"]["split-gru"].mean),
    )  # fmt: skip
    best = {
        system: [
            min(_mean(table, system, method) for method in methods)
            for methods in (published_row, ("persistence", "seasonal-naive", "harmonic"))
        ]
        for table, of in (("learning-based", published.LEARNING_BASED),
                          ("hybrid-gru", published.HYBRID_GRU))
        for system, row in of.items()
        for published_row in [[name for name in row if name != "simulator"]]
    }  # fmt: skip
    assert [system for system, (network, naive) in best.items() if network < naive] == ["vi"]
    yield Quote(WHY, "beats the best of the naive baselines, {:.3f} against {:.3f}",
                tuple(best["vi"]))  # fmt: skip
    simulator = _row("hybrid-gru", "vi", "simulator")
    yield Quote(
        DEVIATIONS,
        "the simulator of (vi) has {:.3f} in the paper, {:.3f} here with the warm-up counted and "
        "{:.3f} without it",
        (simulator["paper"]["mean"], simulator["whole_rmse"][0], simulator["total_rmse"][0]),
    )
    losses = [f(_row("learning-based", "ii", name)["losses"]["high band"])
              for name in ("split-gru-hp", "split-gru") for f in (min, max)]  # fmt: skip
    yield Quote(
        DEVIATIONS,
        "training loss {:.2f} to {:.2f} over five seeds, against {:.2f} to {:.2f} without the "
        "filter",
        tuple(losses),
    )


def _deviations() -> Iterator[Quote]:
    """The improvements that docs/deviations.md lists."""
    held = {
        name: [statistics.mean(run["held_out"] for run in runs[told])
               for told in ("measurement", "prediction")]
        for name, runs in _json("benchmarks/conditioning.json").items()
    }  # fmt: skip
    draws = [held[f"i, draw {draw}"] for draw in (0, 1)]
    yield Quote(
        DEVIATIONS,
        "on the torsion record {:.3f} against {:.3f}, on two draws of (i) {:.3f} and {:.3f} "
        "against {:.3f} and {:.3f}",
        (*held["double-torsion record"], draws[0][0], draws[1][0], draws[0][1], draws[1][1]),
    )
    pendulum = _at("results/beyond/pendulum-ii.json", "methods")
    torsion = _at("results/beyond/double-torsion-record.json", "methods")
    names = ("periodic", "seasonal-naive")
    yield Quote(
        DEVIATIONS,
        "On the torsion record {:.3f} where seasonal-naive, which repeats one noisy period, has "
        "{:.3f}; on the simulated pendulum (ii) {:.3f} where harmonic regression has {:.2f}",
        (*(torsion[name]["total_rmse_mean"] for name in names),
         *(pendulum[name]["total_rmse_mean"] for name in ("periodic", "harmonic"))),
    )  # fmt: skip

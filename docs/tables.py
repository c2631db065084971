"""Write the tables and numbers of the documents from result files: `python -m docs.tables`.

A table, or the text of an example, stands between two comments, as the outputs of `docs.run` do:

    <!--={benchmark-silverbox}-->
    | ... |
    <!--/-->

A number in a sentence is a line of `NUMBERS`: the page, and the words around it. Templates are
format strings of Python. A name in them is a JSON file below docs, without its suffix, or a
function of `COMPUTED`; the keys that lead to the number follow in brackets.
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

from benchmarks import claims, clock, closed_loop, families, filter_case, page, recommendation
from benchmarks.sets import SETS
from reproduction import statements

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = (
    *(ROOT / "README.md", ROOT / "reproduction/REPORT.md"),
    *sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts),
)
"""Documents, which may have tables between comments."""
FIGURE = re.compile(r"^<!--=([^\n]+)-->\n(.*?)^<!--/-->$", re.DOTALL | re.MULTILINE)
FIELD = re.compile(r"\{[^{}]+\}")
NUMBER = r"(-?\d(?:[\d,]*\d)?(?:\.\d+)?(?:e-?\d+)?(?:\s+(?:to|of)\s+[\d.]*\d)?%?)"
Rows = Iterable[Iterable[object]]
SEEDS = 5
"""Runs of a record of which README.md shows the median."""

NUMBERS: tuple[tuple[str, str], ...] = (
    (
        "README.md",
        "the swing (fit {results/demo[table][0][values][simulator]:.0f} %), a linear model reaches "
        "{results/demo[table][0][values][linear]:.0f} %",
    ),
    (
        "README.md",
        "a network combined reach "
        "{results/demo[table][0][values][residual-gru-conditioned]:.0f} %, with the filter pair "
        "{results/demo[table][0][values][filtered-gru-conditioned]:.0f} %",
    ),
    (
        "docs/howto/embed.md",
        "Over {benchmarks/desks[steps]:,} steps of five kinds of models, the largest difference "
        "from a stream is {benchmarks/desks[most][win64]:.0e} of the signal's deviation on Windows "
        "(under wine) and {benchmarks/desks[most][linux64]:.0e} on Linux",
    ),
    (
        "docs/why.md",
        "all periods has an error of "
        "{results/double-torsion[methods][periodic][total_rmse_mean]:.3f}, a GRU "
        "{results/double-torsion[methods][gru][total_rmse_mean]:.3f}",
    ),
    (
        "docs/why.md",
        "harmonic regression has "
        "{results/beyond/pendulum-iv[methods][harmonic][total_rmse_mean]:.3f}, a GRU "
        "{results/beyond/pendulum-iv[methods][gru][total_rmse_mean]:.3f}",
    ),
    (
        "docs/why.md",
        "`linear` has a forecast error of "
        "{benchmarks/inputs[two masses][methods][linear][forecast_rmse_mean]:.4f}, a GRU "
        "{benchmarks/inputs[two masses][methods][gru][forecast_rmse_mean]:.4f}",
    ),
    (
        "docs/why.md",
        "a GRU has a forecast error of "
        "{benchmarks/inputs[tanks][methods][gru][forecast_rmse_mean]:.3f}, `linear` "
        "{benchmarks/inputs[tanks][methods][linear][forecast_rmse_mean]:.2f}",
    ),
    (
        "docs/why.md",
        "the simulator has a forecast error of "
        "{results/drill-string[methods][simulator][forecast_rmse][0]:.2f} standard deviations",
    ),
    (
        "docs/why.md",
        "other black boxes have {published[lowest]:.2f} to {published[highest]:.2f} V",
    ),
    (
        "docs/why.md",
        "On {over_best[records]} random records the ratio was {over_best[mean]:.2f} on average",
    ),
    (
        "docs/howto/intervals.md",
        "With networks, {benchmarks/recommendation-default[all][inside]:.0%}",
    ),
    *(
        (
            "docs/results/beyond.md",
            before.format(
                *(
                    f"{{results/beyond/{row}[methods][{name}][total_rmse_mean]:.3f}}"
                    for name in (
                        "filtered-gru",
                        "filtered-gru-calibrated",
                        "filtered-gru-conditioned",
                        "filtered-gru-calibrated-conditioned",
                    )
                )
            ),
        )
        for row, before in (
            ("v", "Filtered GRU on (v): {}, calibrated {}, conditioned {}, both {}"),
            ("vi", "On (vi): {}, {}, {}, {}"),
        )
    ),
    (
        "docs/results/beyond.md",
        "A residual GRU with both has "
        "{results/beyond/v[methods][residual-gru-calibrated-conditioned][total_rmse_mean]:.3f} and "
        "{results/beyond/vi[methods][residual-gru-calibrated-conditioned][total_rmse_mean]:.3f}.",
    ),
    (
        "docs/results/beyond.md",
        "a GRU on the torsion record from "
        "{results/beyond/double-torsion-record[methods][gru][total_rmse_mean]:.3f} to "
        "{results/beyond/double-torsion-record[methods][gru][mean_of_seeds][total_rmse]:.3f}, of a "
        "split GRU from "
        "{results/beyond/double-torsion-record[methods][split-gru][total_rmse_mean]:.3f} to "
        "{results/beyond/double-torsion-record[methods][split-gru][mean_of_seeds][total_rmse]:.3f}",
    ),
    ("docs/howto/validation.md", "{few_samples[lowest]:.2f} to {few_samples[highest]:.2f} times"),
    (
        "docs/theory/simulators.md",
        "a delay of {calibration[delay]:.2f} s and a clock of {calibration[clock]:.4f} are found, "
        "and the error falls from {results/beyond/v[methods][simulator][total_rmse_mean]:.3f} to "
        "{results/beyond/v[methods][simulator-calibrated][total_rmse_mean]:.3f}",
    ),
    (
        "docs/theory/parameters.md",
        "the largest relative error is {parameters[largest]:.2f} %, and the 95 % confidence "
        "intervals hold the true value in {parameters[covered]:.0f} %",
    ),
    (
        "reproduction/REPORT.md",
        "the filtered hybrid reaches "
        "{results/beyond/v[methods][filtered-gru-calibrated-conditioned][total_rmse_mean]:.3f} on "
        "(v) and "
        "{results/beyond/vi[methods][filtered-gru-calibrated-conditioned][total_rmse_mean]:.3f} on "
        "(vi), the residual one "
        "{results/beyond/v[methods][residual-gru-calibrated-conditioned][total_rmse_mean]:.3f} and "
        "{results/beyond/vi[methods][residual-gru-calibrated-conditioned][total_rmse_mean]:.3f}.",
    ),
    (
        "reproduction/REPORT.md",
        "`harmonic` with {results/beyond/v[methods][harmonic][total_rmse_mean]:.3f} and `periodic` "
        "with {results/beyond/v[methods][periodic][total_rmse_mean]:.3f}",
    ),
    (
        "reproduction/REPORT.md",
        "(v) rnn {unversioned[v][rnn]}, residual-rnn {unversioned[v][residual-rnn]}, filtered-rnn "
        "{unversioned[v][filtered-rnn]}; (vi) rnn {unversioned[vi][rnn]}, residual-rnn "
        "{unversioned[vi][residual-rnn]}, filtered-rnn {unversioned[vi][filtered-rnn]}.",
    ),
    (
        "reproduction/REPORT.md",
        "Split GRU takes {time_shares[ours][i]:.2f}, {time_shares[ours][ii]:.2f}, "
        "{time_shares[ours][iii]:.2f} and {time_shares[ours][iv]:.2f} times the GRU's time on (i) "
        "to (iv); in the paper {time_shares[paper][i]:.2f}, {time_shares[paper][ii]:.2f}, "
        "{time_shares[paper][iii]:.2f} and {time_shares[paper][iv]:.2f}",
    ),
    (
        "reproduction/REPORT.md",
        "split GRU takes {seconds_by_factor[k2]:.1f}, {seconds_by_factor[k3]:.1f}, "
        "{seconds_by_factor[k4]:.1f}, {seconds_by_factor[k5]:.1f} and {seconds_by_factor[k10]:.1f} "
        "s",
    ),
    (
        "reproduction/REPORT.md",
        "{results/beyond/v[methods][simulator][total_rmse_mean]:.3f} becomes "
        "{results/beyond/v[methods][simulator-calibrated][total_rmse_mean]:.3f}",
    ),
    ("reproduction/REPORT.md", "then have {own_warmup:.2f} times the error"),
    (
        "reproduction/REPORT.md",
        "{conditioning[double-torsion record][measurement]:.3f} against "
        "{conditioning[double-torsion record][prediction]:.3f} on the torsion record, "
        "{conditioning[i, draw 0][measurement]:.3f} and "
        "{conditioning[i, draw 1][measurement]:.3f} against "
        "{conditioning[i, draw 0][prediction]:.3f} and {conditioning[i, draw 1][prediction]:.3f}",
    ),
    ("reproduction/REPORT.md", "below it on {noise_draws[below]} draws"),
    ("reproduction/REPORT.md", "The GRU's training loss, {row[i][gru][loss of network]}, is"),
    ("reproduction/REPORT.md", "its seeds end at {row[i][gru][seeds]}:"),
    ("reproduction/REPORT.md", "holds for split GRU, {row[i][split-gru][seeds]}."),
    ("reproduction/REPORT.md", "the seeds end at {row[v][residual-rnn][seeds]}."),
    (
        "reproduction/REPORT.md",
        "The seeds of the GRU end at {row[v][gru][seeds]}, those of the RNN at "
        "{row[v][rnn][seeds]}:",
    ),
    (
        "reproduction/REPORT.md",
        "The low band is learned in every seed of (iii), with a loss of "
        "{row[iii][split-gru][loss of low band]}",
    ),
    ("reproduction/REPORT.md", "its loss is {row[v][residual-rnn][loss of network]}"),
    ("reproduction/REPORT.md", "of that RNN is still {row[vi][rnn][loss of network]}"),
    (
        "reproduction/REPORT.md",
        "its training loss is {row[ii][split-gru-hp][loss of high band]} on (ii), against "
        "{row[ii][split-gru][loss of high band]} without",
    ),
)
"""Pages, and sentences of them whose numbers come from result files."""


class Figures(Mapping[str, Any]):
    """Result files and what is computed from them, by the names that templates use."""

    def __getitem__(self, name: str) -> Any:
        return COMPUTED[name]() if name in COMPUTED else _read(name)

    def __iter__(self) -> Iterator[str]:
        return iter(COMPUTED)

    def __len__(self) -> int:
        return len(COMPUTED)


def filled(template: str) -> str:
    """Return a template with its fields as the result files have them.

    Raises
    ------
    ValueError : A file or a key is unknown.
    """
    try:
        return template.format_map(Figures())
    except (AttributeError, LookupError, OSError, TypeError, ValueError) as error:
        raise ValueError(f"{template}: {error!r}") from error


def with_tables(text: str) -> str:
    """Return a page with the tables between its comments made again, outputs as they are.

    Raises
    ------
    ValueError : The comments do not come in pairs, each on a line of its own, or see `filled`.
    """
    if not len(FIGURE.findall(text)) == text.count("<!--=") == text.count("<!--/-->"):
        raise ValueError(
            "a table must stand between <!--=...--> and <!--/-->, each alone on its line"
        )

    def made(found: re.Match[str]) -> str:
        if found[1] == "output":
            return found[0]
        return f"<!--={found[1]}-->\n{filled(found[1]).strip()}\n<!--/-->"

    return FIGURE.sub(made, text)


def numbers_of(text: str, template: str) -> list[tuple[int, int]]:
    """Return where a page has the numbers of a sentence, whatever they are.

    Raises
    ------
    ValueError : The sentence does not stand on the page once.
    """
    words = (re.sub(r"(\\\s)+", r"\\s+", re.escape(part)) for part in FIELD.split(template))
    found = [*re.finditer(NUMBER.join(words), text)]
    if len(found) != 1:
        raise ValueError(f"{template!r} must stand once on the page, got {len(found)} times")
    return [*found[0].regs[1:]]


def with_numbers(text: str, template: str) -> str:
    """Return a page with the numbers of one sentence as the result files have them.

    Raises
    ------
    ValueError : See `numbers_of` and `filled`.
    """
    places = zip(numbers_of(text, template), FIELD.findall(template), strict=True)
    for (start, end), field in reversed([*places]):
        if filled(field) != " ".join(text[start:end].split()):
            text = text[:start] + filled(field) + text[end:]
    return text


@cache
def _read(name: str) -> Any:
    return json.loads((DOCS / f"{name}.json").read_text(encoding="utf-8"))


def _table(heads: Iterable[str], rows: Rows, words: int = 1) -> str:
    """Return a table in Markdown; all but the first columns are numbers, to the right."""
    heads = [*heads]
    rule = "|---" * words + "|---:" * (len(heads) - words)
    lines = [heads, *rows]
    texts = [f"| {' | '.join(str(cell) for cell in line)} |" for line in lines]
    return "\n".join([texts[0], f"{rule}|", *texts[1:]]) + "\n"


def published(name: str = "tanks5") -> dict[str, float]:
    """Return the lowest and the highest error of other black boxes, on the first test record."""
    scores = [
        float(scores[0])
        for method, scores in SETS[name].published.items()
        if re.fullmatch(r"[\d.]+", scores[0]) and not re.search("grey box|linear", method)
    ]
    return {"lowest": min(scores), "highest": max(scores)}


def over_best() -> dict[str, float]:
    """Return on how many drawn records, and how far, the recommended method misses the best."""
    facts = [
        each
        for name in ("", "-default")
        for each in _read(f"benchmarks/recommendation{name}")["found"]
    ]
    mean = statistics.geometric_mean(each["regret"] for each in facts)
    return {"records": len(facts), "mean": mean}


def parameters() -> dict[str, float]:
    """Return how well the parameters of the crane are found, in per cent."""
    crane = _read("benchmarks/physics")["crane"]
    return {
        "largest": 100 * max(crane["largest_relative_error"].values()),
        "covered": 100 * crane["covered_together"],
    }


def few_samples() -> dict[str, float]:
    """Return the range over networks of the error from few initial samples over that from all."""
    ratios = [
        statistics.geometric_mean(each["few"] / each["all"] for each in found.values())
        for found in _read("benchmarks/warmup").values()
    ]
    return {"lowest": min(ratios), "highest": max(ratios)}


def calibration() -> dict[str, float]:
    """Return what calibrates the simulator of the Van der Pol oscillator."""
    said = _read("results/beyond/v")["methods"]["simulator-calibrated"]["description"]
    terms = re.findall(r"(\w+) (-?[\d.]+\d)", said)
    return {term: float(value) for term, value in terms}


def conditioning() -> dict[str, dict[str, float]]:
    """Return the mean held-out error by record and by what the fast network was trained on."""
    return {
        record: {told: statistics.mean(run["held_out"] for run in of) for told, of in runs.items()}
        for record, runs in _read("benchmarks/conditioning").items()
    }


def own_warmup() -> float:
    """Return forecast errors with own warm-ups over those with windows of the filtered record."""
    return statistics.geometric_mean(
        statistics.geometric_mean(
            own / cut
            for forms in methods.values()
            for own, cut in zip(forms["own warm-up"], forms["filtered record"], strict=True)
        )
        for methods in _read("benchmarks/split_training").values()
    )


def others_of(name: str, test: int) -> str:
    """Return the two lowest published errors on a test record, and that of the linear model."""
    scores = {
        re.split("[,(]", method)[0].strip(): float(each[test].split(" to ")[0])
        for method, each in SETS[name].published.items()
        if each[test]
    }
    best = sorted(scores, key=scores.__getitem__)[:2]
    return "; ".join(f"{method} {scores[method]:g}" for method in (*best, "linear state space"))


def filter_pays() -> str:
    """Return in a sentence what the primary comparisons of the filter's case came to."""
    found = filter_case.comparisons(claims.read(filter_case.FILE))
    of = found[found["group"] == "primary"].set_index("other")
    residual, control = of.loc["residual"], of.loc["control"]

    def told(row: Any) -> str:
        within = f"95 % interval {row['low']:.2f} to {row['high']:.2f}, p = {row['p']:.1g}"
        return f"({within}{'; undecided' if row['verdict'] == 'undecided' else ''})"

    return (
        f"On {residual['n']} random systems, whose simulator is accurate below a frequency and "
        f"noise above it, the filtered hybrid has\n{residual['ratio']:.2f} times the error of the "
        f"hybrid without a filter {told(residual)},\nand {control['ratio']:.2f} times that of a "
        f"hybrid that filters only the simulator {told(control)}."
    )


def readme_benchmarks() -> str:
    """Return what two minutes of the plain command come to, beside published errors.

    A record is shown when five seeds have been run with today's code.
    """
    rows = clock.groups(filter(claims.current, claims.read(page.OUT / clock.FILE)))
    simulator = _read("results/drill-string")["methods"]["simulator"]["forecast_rmse"][0]
    lines, left_out = [], []
    for name, test, title, scale, unit, others in (
        ("tanks5", 0, "cascaded tanks, from 5 samples", 1, " V", others_of("tanks5", 0)),
        ("silverbox", 0, "Silverbox, multisine", 1000, " mV", others_of("silverbox", 0)),
        ("silverbox", 1, "Silverbox, arrow", 1000, " mV", others_of("silverbox", 1)),
        ("drill string", 0, "drill string, normalised", 1, "", f"its simulator {simulator:.3f}"),
    ):
        of = [scale * row["errors"][test] for row in rows.get((name, 120.0, 0), [])]
        if len(of) >= SEEDS:
            ranged = f"{min(of):.3f} to {max(of):.3f}"
            lines.append([title, f"{statistics.median(of):.3f}{unit}", ranged, others])
        else:
            left_out.append(title)
    heads = ["record", f"median of {SEEDS} seeds", "range", "others"]
    said = [_table(heads, lines)] if lines else []
    if left_out:
        said.append(
            f"Still to be measured with today's code, by `make claims`: {'; '.join(left_out)}."
        )
    return "\n".join(said).strip()


def physics_wrong() -> str:
    """Return errors of incomplete equations, networks and hybrids, and what was recommended."""
    kinds = {
        "as given": "simulator-as-given",
        "fitted": "grey-box",
        "network alone": "state-space",
        "residual hybrid": "residual-grey-box-state-space-conditioned",
        "filtered hybrid": "filtered-grey-box-state-space-conditioned",
    }
    shown = {name: kind for kind, name in kinds.items()}
    rows, study = [], {"commit": "c5ae2c0"}
    for case, records in _read("benchmarks/physics")["wrong"].items():
        for found in records:
            errors = [f"{found['forecast_rmse'][name]:.3f}" for name in kinds.values()]
            best = shown.get(found["recommended"], found["recommended"])
            rows.append([case + claims.sign([study]), *errors, best])
    return _table(["equation", *kinds, "recommended"], rows) + claims.note([study])


def beyond() -> str:
    """Return what the default command recommended on the paper's systems."""
    papers = {
        system: min(
            row["paper"]["mean"]
            for table in ("hybrid-gru", "hybrid-rnn")
            for row in _read(f"results/tables/{table}")["rows"]
            if row["system"] == system and row["paper"]
        )
        for system in ("v", "vi")
    }
    titles = {
        "double-torsion-record": "double-torsion record",
        "pendulum-ii": "pendulum (ii)",
        "pendulum-iii": "pendulum (iii)",
        "pendulum-iv": "pendulum (iv)",
        "v": "(v) Van der Pol",
        "vi": "(vi) drill string",
    }
    rows, runs = [], []
    for name, title in titles.items():
        found = _read(f"results/beyond/{name}-default")
        runs.append({"commit": found["environment"]["commit"]})
        recommended, methods = found["recommended"], found["methods"]
        best = methods[recommended]
        together = (best.get("median_of_seeds") or best.get("mean_of_seeds") or {}).get(
            "total_rmse", best["total_rmse_mean"]
        )
        errors = {method: facts["total_rmse_mean"] for method, facts in methods.items()}
        errors[recommended] = together
        first = min(errors, key=errors.__getitem__)
        found = best["total_rmse_mean"], best["forecast_rmse_mean"], together
        row = [
            title + claims.sign(runs[-1:]),
            f"`{recommended}`",
            *(f"{error:.3f}" for error in found),
        ]
        row += [
            papers.get(name, ""),
            f"`{first}` {errors[first]:.3f}",
            f"{together / errors[first]:.2f}",
        ]
        rows.append([*row, f"{best['interval']['covers']:.0%}"])
    heads = ["system", "recommended", "from the start", "forecast", "seeds together"]
    heads += ["the paper's best", "best row", "ratio", "in interval"]
    return _table(heads, rows, 2) + claims.note(runs)


def speed_training() -> str:
    """Return the time of a training step, as multiples of ours, on one thread and on two."""
    rows = []
    rollout = _read("benchmarks/rollout")
    gru, mlp = "GRU of 64 units, batch 50, window 150", "EulerMLP 4-500-500-4, batch 50, window 200"
    of_gru = {
        "a loop over `torch.nn.GRU`, step by step": ["nn.GRU, step by step"],
        "tsfast, autoregressive GRU": ["tsfast AR_Model"],
        "JAX `scan`, compiled whole, always on two threads": ["JAX scan"],
    }
    backends = ["tsfast NeuralStateSpace, eager", "tsfast NeuralStateSpace, C"]
    of_mlp = {
        "the loop in torch": ["plain loop"],
        "tsfast, neural state space, its faster backend": backends,
    }
    for network, title, digits, peers in (
        ("GRU", f"{gru}: ours", 1, of_gru),
        ("EulerMLP", f"{mlp}: ours", 0, of_mlp),
    ):
        found = [rollout[f"{network}, {threads} threads"] for threads in (1, 2)]
        rows.append([title, *(f"{each['kernel, ms']:.{digits}f} ms" for each in found)])
        for peer, names in peers.items():
            times = [min(each[f"{name} / kernel"] for name in names) for each in found]
            rows.append([peer, *(f"{value:.1f}" for value in times)])
    return _table(["", "one thread", "two threads"], rows)


def speed_state_space() -> str:
    """Return the time of a gradient of a state-space network, and of others as multiples of it."""
    peers = ("products", "JAX scan", "GRU of as many units")
    rows = []
    for batch, window in ((25, 400), (50, 180), (128, 250), (650, 100), (1, 1050), (1, 65050)):
        for states, units in ((4, 8), (16, 32)):
            found = _read("benchmarks/state_space")[
                f"{states} states, {units} units, batch {batch}, window {window}"
            ]
            times = [f"{found[f'{peer} / kernel']:.1f}" for peer in peers]
            sizes = f"{states}, {units}", f"{batch}, {window:,}"
            rows.append([*sizes, f"{found['kernel, ms']:.1f} ms", *times])
    heads = ["states, units", "batch, window", "ours"]
    return _table([*heads, "products by `torch.mm`", "JAX `scan`", peers[-1]], rows, 2)


_EXPORTED = {
    "GRU of 64 units": "GRU",
    "split GRU, 64 units each": "split GRU",
    "filtered hybrid, conditioned, 64 units": "filtered hybrid, conditioned",
    "ensemble of 3 GRUs of 64 units": "ensemble of 3 GRUs",
    "linear": "linear",
}


def speed_steps() -> str:
    """Return the microseconds of a step, by model and by where it runs."""
    formats = {
        **{"stream": ".0f", "C, double": ".2g", "C, float": ".2g"},
        **dict.fromkeys(("onnxruntime, step by step", "onnxruntime, a simulation"), ".0f"),
    }
    rows = []
    for title, name in _EXPORTED.items():
        found = _read("benchmarks/export")[name]["microseconds a step"]
        rows.append([title, *(format(found[key], how) for key, how in formats.items())])
    heads = ["stream, Python", *list(formats)[1:4], "a simulation"]
    return _table(["", *heads], rows)


def speed_accuracy() -> str:
    """Return the largest differences of exported models, as shares of the signal's deviation."""
    columns = {
        "stream": ("predict, 10,000", "stream"),
        "C, FMU": ("stream, 10,000", "C, double"),
        "ONNX": ("stream, 10,000", "ONNX, double"),
        "C, float": ("stream, 1,000", "C, float"),
        "ONNX, float": ("stream, 1,000", "ONNX, float"),
    }
    rows = []
    for title, name in _EXPORTED.items():
        found = _read("benchmarks/export")[name]
        cells = (found[f"difference from {of} steps"][key] for of, key in columns.values())
        rows.append([title, *(f"{value:.0e}" for value in cells)])
    return _table(["", *columns], rows)


def fuzz() -> str:
    """Return how many damaged files and command lines were tried, and what became of them."""
    rows = []
    for target, facts in _read("benchmarks/fuzz")["targets"].items():
        read = facts["inputs"] - facts["refused"] if "refused" in facts else facts["loaded"]
        counts = [f"{value:,}" for value in (facts["inputs"], read, facts["inputs"] - read)]
        rows.append([target.replace("_", " "), *counts, f"{facts['seconds']:.0f}"])
    total = _read("benchmarks/fuzz")["inputs"]
    said = f"\n{total:,} inputs: no traceback, no hang, no file beside the output touched.\n"
    return _table(["target", "inputs", "with a result", "refused", "time (s)"], rows) + said


def memory() -> str:
    """Return the most memory that a command on a million samples holds, and its time."""
    rows = [
        [command, f"{facts['bytes'] / 2**30:.2f}", f"{facts['seconds']:.0f}"]
        for command, facts in _read("benchmarks/memory")["commands"].items()
    ]
    return _table(["command", "GiB", "time (s)"], rows)


def _intervals(methods: str) -> str:
    path = ROOT / recommendation.FILES[methods]
    return recommendation.table(json.loads(path.read_text(encoding="utf-8")))


def _families() -> str:
    return families.table(claims.read(page.OUT / families.FILE))


def examples() -> dict[str, str]:
    """Return the programs in the folder of examples, by name, as they stand on a page."""
    return {
        path.stem: f"```python\n{path.read_text(encoding='utf-8')}```"
        for path in (ROOT / "examples").glob("*.py")
    }


def _filter_case() -> str:
    return f"{filter_pays()}\n\n{filter_case.verdicts(claims.read(filter_case.FILE))}"


COMPUTED: dict[str, Callable[[], Any]] = {
    **{
        function.__name__: cache(function)
        for function in (
            *(beyond, calibration, conditioning, examples, few_samples, filter_pays, fuzz, memory),
            *(over_best, own_warmup, parameters, physics_wrong, published, readme_benchmarks),
            *(speed_accuracy, speed_state_space, speed_steps, speed_training),
            *statements.FIGURES,
        )
    },
    **{f"intervals-{each}": partial(_intervals, each) for each in recommendation.FILES},
    **{name: partial(page.table_of, name) for name in page.TABLES},
    "benchmark-against": page.of_libraries,
    "benchmark-drawn": page.of_short,
    "families": _families,
    "filter-case": _filter_case,
    "closed-loop-pendulum": lambda: closed_loop.of_pendulum(claims.read(closed_loop.FILE)),
    "closed-loop-networks": lambda: closed_loop.of_loops(claims.read(closed_loop.FILE)),
}


def written() -> Iterator[tuple[Path, str]]:
    """Yield each page, and its text as it should be.

    Raises
    ------
    ValueError : A table or a number cannot be written; the message begins with its page.
    """
    for path in PAGES:
        text = path.read_text(encoding="utf-8")
        try:
            text = with_tables(text)
            for name, template in NUMBERS:
                text = with_numbers(text, template) if ROOT / name == path else text
        except ValueError as error:
            raise ValueError(f"{path.relative_to(ROOT)}: {error}") from error
        yield path, text


def main() -> None:
    """Write the tables, and the numbers of every page, and say which files changed."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for path, text in written():
        if path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
            print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()

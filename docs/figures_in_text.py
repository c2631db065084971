"""Write the figures of the documents from their result files: `python -m docs.figures_in_text`.

A figure in a page stands between two HTML comments, which no viewer shows:

    a GRU has <!--={results/demo[methods][gru][forecast_rmse][0]:.2f}-->3.30<!--/--> m

The first comment is a format string of Python. A name in it is a JSON file below docs, without its
suffix, or a function of `COMPUTED` for a figure that takes more than looking it up; the keys that
lead to the figure follow in brackets. What stands between the comments is replaced.
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.clock import FILE, groups, read
from benchmarks.sets import SETS
from reproduction import statements
from splitband.evaluation.plan import BUDGET
from splitband.forecasters.names import NAMES, QUICK

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FIGURE = re.compile(r"(<!--=(.+?)-->)(\s*)(.*?)(\s*)(<!--/-->)", re.DOTALL)
NAIVE = ("persistence", "seasonal-naive", "harmonic")


class Figures(Mapping[str, Any]):
    """Result files and computed figures, by the names that pages use."""

    def __getitem__(self, name: str) -> Any:
        return COMPUTED[name]() if name in COMPUTED else _read(name)

    def __iter__(self) -> Iterator[str]:
        return iter(COMPUTED)

    def __len__(self) -> int:
        return len(COMPUTED)


def filled(text: str) -> str:
    """Return a page with each of its figures as the result files have it.

    Raises
    ------
    ValueError : The comments do not come in pairs, a line begins with one and goes on (Markdown
        ends the paragraph there), or a file or a key is unknown.
    """
    pairs = FIGURE.findall(text)
    if not len(pairs) == text.count("<!--=") == text.count("<!--/-->"):
        raise ValueError("a figure must stand between <!--=...--> and <!--/-->")
    broken = re.search(r"^\s*<!--(=.+?|/)-->[ \t]*\S.*$", text, re.MULTILINE)
    if broken:
        raise ValueError(f"a line must not begin with the comment of a figure: {broken[0]}")
    return FIGURE.sub(_filled, text)


def pages() -> list[Path]:
    """Return the Markdown files that have figures."""
    found = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
    return [
        page
        for page in found
        if "_build" not in page.parts and "<!--=" in page.read_text(encoding="utf-8")
    ]


def _filled(figure: re.Match[str]) -> str:
    opening, template, before, _, after, closing = figure.groups()
    try:
        text = template.format_map(Figures())
    except (AttributeError, LookupError, OSError, TypeError, ValueError) as error:
        raise ValueError(f"{template}: {error!r}") from error
    return f"{opening}{before}{text}{after}{closing}"


@cache
def _read(name: str) -> Any:
    return json.loads((DOCS / f"{name}.json").read_text(encoding="utf-8"))


def _methods(name: str) -> dict[str, dict[str, Any]]:
    methods: dict[str, dict[str, Any]] = _read(name)["methods"]
    return methods


def _number(text: str, after: str) -> float:
    """Return the number behind a word in a method's description."""
    found = re.search(rf"{after} (-?[\d.]+\d)", text)
    if not found:
        raise ValueError(f"there is no number behind {after!r} in {text!r}")
    return float(found[1])


# Comparisons


def default_minutes() -> float:
    """Return the minutes that `compare` takes at most by default."""
    return BUDGET / 60


def drill_string() -> dict[str, dict[str, float]]:
    """Return each method's errors on the drill string, and those of the recommended one."""
    methods = _methods("results/drill-string")
    errors = {name: facts["median_of_seeds"] for name, facts in methods.items()}
    return errors | {"recommended": errors[_read("results/drill-string")["recommended"]]}


def drill_string_table() -> str:
    """Return the table of README.md: the fit first, methods in words, the recommended one bold."""
    found = _read("results/drill-string")
    columns = {column["heading"]: column["values"] for column in found["table"]}
    rows = [
        "| method | short name | forecast fit % | RMSE | in the 90 % interval |",
        "|---|---|---:|---:|---:|",
    ]
    for name in sorted(columns["score"], key=lambda name: float(columns["score"][name])):
        best = name == found["recommended"]
        cells = [
            _bold(_in_words(name, found["settings"]["cutoff"]), best),
            f"`{name}`",
            _bold(f"{columns['forecast fit %'][name]:.1f}", best),
            f"{columns['forecast RMSE'][name]:.3f}",
            f"{columns['in interval'][name]:.0%}".replace("%", " %"),
        ]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def _bold(text: str, yes: bool) -> str:
    return f"**{text}**" if yes else text


def _in_words(name: str, cutoff: float) -> str:
    """Return what a method is, with the frequency that separates its bands."""
    words = NAMES[name].in_words().replace("in the low band", f"below {cutoff:.2f} Hz")
    return words.replace("in the high band", "above")


def calibration_of_v() -> dict[str, float]:
    """Return what calibrates the simulator of (v)."""
    described = _methods("results/beyond/v")["simulator-calibrated"]["description"]
    return {term: _number(described, term) for term in ("delay", "clock")}


def regrets_beyond() -> str:
    """Return the regret on each record beyond the paper, in order of size."""
    ratios = []
    for name in ("double-torsion-record", "pendulum-ii", "pendulum-iii", "pendulum-iv", "v", "vi"):
        found = _read(f"results/beyond/{name}-default")
        errors = {m: facts["forecast_rmse_mean"] for m, facts in found["methods"].items()}
        ratios.append(errors[found["recommended"]] / min(errors.values()))
    *others, last = (f"{ratio:.2f}" for ratio in sorted(ratios))
    return f"{', '.join(others)} and {last}"


# Benchmarks


def clock() -> dict[str, dict[str, dict[str, float]]]:
    """Return median and range of the first error, by record and by seconds asked for."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for (name, asked, beside), rows in groups(read(DOCS / "results/benchmarks" / FILE)).items():
        of = [row["errors"][0] for row in rows]
        spread = {
            "seeds": len(of),
            "median": statistics.median(of),
            "lowest": min(of),
            "highest": max(of),
        }
        if not beside:
            found.setdefault(name, {})[f"{asked:g}s"] = spread
    return found


def reliability() -> dict[str, Any]:
    """Return what recommendations with and without networks come to, and intervals of networks."""
    baselines, found, by_change = (
        _read(f"benchmarks/recommendation{which}")["found"]
        for which in ("", "-default", "-by-change")
    )
    networks = [[f for name, f in facts["methods"].items() if name not in QUICK] for facts in found]
    every = [facts["inside"] for of_record in networks for facts in of_record]
    best = [min(of, key=lambda facts: float(facts["held_out"]))["inside"] for of in networks]
    worst = max(baselines, key=lambda facts: float(facts["regret"]))
    over: dict[str, list[float]] = {}
    for facts in found:
        over.setdefault(facts["kind"], []).append(facts["over_baselines"])
    return {
        "baselines": {"records": len(baselines), "regret": _mean_of(baselines, "regret")},
        "networks": {
            "records": len(found),
            "regret": _mean_of(found, "regret"),
            "over": _mean_of(found, "over_baselines"),
            "recommended": sum(facts["recommended"] not in QUICK for facts in found),
            "inside": 100
            * statistics.mean(facts["methods"][facts["recommended"]]["inside"] for facts in found),
        },
        "over": {kind: statistics.geometric_mean(of_kind) for kind, of_kind in over.items()},
        "by_change": {
            "records": len(by_change),
            "with": _mean_of(by_change, "regret"),
            "without": _mean_of(by_change, "regret_by_held_out_alone"),
        },
        "worst": worst | {"best": _best(worst)},
        "intervals": {
            "networks": len(every),
            "every": 100 * statistics.mean(every),
            "best": 100 * statistics.mean(best),
        },
    }


def _mean_of(found: list[dict[str, Any]], key: str) -> float:
    return statistics.geometric_mean(facts[key] for facts in found)


def _best(facts: dict[str, Any]) -> str:
    return min(facts["methods"], key=lambda name: float(facts["methods"][name]["error"]))


def tanks_published() -> dict[str, float]:
    """Return published errors on the cascaded tanks: of a linear model, and of black boxes."""
    scores = {
        name: float(score)
        for name, (score,) in SETS["tanks5"].published.items()
        if not any(word in name for word in ("box", "second-hand", "measured by us"))
    }
    linear = scores.pop("linear state space (Champneys et al., 2024)")
    return {"linear": linear, "lowest": min(scores.values()), "highest": max(scores.values())}


def conditioning() -> dict[str, dict[str, float]]:
    """Return the mean held-out error by record and by what the fast network was trained on."""
    return {
        record: {told: statistics.mean(run["held_out"] for run in of) for told, of in runs.items()}
        for record, runs in _read("benchmarks/conditioning").items()
    }


def split_training() -> dict[str, float]:
    """Return forecast errors with own warm-ups over those with windows of the filtered record.

    Geometric means, by record and over all of them.
    """
    ratios = {
        record: statistics.geometric_mean(
            own / cut
            for forms in methods.values()
            for own, cut in zip(forms["own warm-up"], forms["filtered record"], strict=True)
        )
        for record, methods in _read("benchmarks/split_training").items()
    }
    whole = {"ratio": statistics.geometric_mean(ratios.values()), "records": len(ratios)}
    return ratios | whole


def tsfast() -> dict[str, float]:
    """Return the time of tsfast's faster backend over ours, by number of threads."""
    return {
        f"{n} threads": min(
            _read("benchmarks/rollout")[f"EulerMLP, {n} threads"][
                f"tsfast NeuralStateSpace, {backend} / kernel"
            ]
            for backend in ("eager", "C")
        )
        for n in (1, 2)
    }


# The paper's tables


def paper() -> dict[str, dict[str, dict[str, Any]]]:
    """Return the rows of the paper's tables by table, system and method.

    Each has its mean error `ours`, and `off`, by how many per cent that differs from the paper's.
    """
    tables: dict[str, dict[str, dict[str, Any]]] = {}
    for path in sorted((DOCS / "results/tables").glob("*.json")):
        for row in _read(f"results/tables/{path.stem}")["rows"]:
            if "system" not in row or "method" not in row:
                continue
            kept = dict(row)
            if row.get("total_rmse"):
                kept["ours"] = statistics.mean(row["total_rmse"])
                if row["paper"]:
                    kept["off"] = 100 * abs(kept["ours"] / row["paper"]["mean"] - 1)
            tables.setdefault(path.stem, {}).setdefault(row["system"], {})[row["method"]] = kept
    return tables


def drill_string_of_the_paper() -> dict[str, float]:
    """Return the best network's error on (vi) at the paper's settings, and the best baseline's.

    Raises
    ------
    ValueError : Another record has a network that beats the best baseline.
    """
    won = {}
    for table in ("learning-based", "hybrid-gru"):
        for system, rows in paper()[table].items():
            published = [n for n, row in rows.items() if row["paper"] and n != "simulator"]
            network = min(rows[name]["ours"] for name in published)
            baseline = min(rows[name]["ours"] for name in NAIVE)
            if network < baseline:
                won[system] = {"network": network, "baseline": baseline}
    if [*won] != ["vi"]:
        raise ValueError(f"networks beat the baselines on {', '.join(won)}, not on vi alone")
    return won["vi"]


def losses() -> dict[str, str]:
    """Return the range over seeds of the high band's training loss on (ii)."""
    rows = paper()["learning-based"]["ii"]
    return {
        name: "{:.2f} to {:.2f}".format(*(f(rows[name]["losses"]["high band"]) for f in (min, max)))
        for name in ("split-gru", "split-gru-hp")
    }


def lowest_deviation() -> float:
    """Return the smallest deviation over seeds at the last epoch, of all readings of split GRU."""
    readings = _read("results/readings")["readings"]["split-gru"].values()
    return min(float(found["total_rmse"]["deviation"]) for found in readings)


def physics() -> dict[str, dict[str, float]]:
    """Return how well parameters are found, and errors on the tanks in V (5 initial samples)."""
    found = _read("benchmarks/physics")
    crane, tanks = found["crane"], found["tanks"]
    return {
        "crane": {
            "largest": 100 * max(crane["largest_relative_error"].values()),
            "covered": 100 * crane["covered_together"],
        },
        "tanks": {"alone": tanks["grey box"]["5"], "network": tanks["residual"]["5"]},
    }


def physics_wrong_table() -> str:
    """Return errors of incomplete equations, networks and hybrids, and what was recommended."""
    kinds = {
        "as given": "simulator-as-given",
        "fitted": "grey-box",
        "network alone": "state-space",
        "residual hybrid": "residual-grey-box-state-space-conditioned",
        "filtered hybrid": "filtered-grey-box-state-space-conditioned",
    }
    shown = {name: kind for kind, name in kinds.items()}
    rows = [f"| equation | {' | '.join(kinds)} | recommended |", f"|---|{'---:|' * len(kinds)}---|"]
    for case, records in _read("benchmarks/physics")["wrong"].items():
        for found in records:
            errors = [f"{found['forecast_rmse'][name]:.3f}" for name in kinds.values()]
            best = shown.get(found["recommended"], found["recommended"])
            rows.append(f"| {case} | {' | '.join(errors)} | {best} |")
    return "\n".join(rows)


def few_samples() -> dict[str, float]:
    """Return the error from a few initial samples over that from all, by kind of network."""
    return {
        network: statistics.geometric_mean(each["few"] / each["all"] for each in found.values())
        for network, found in _read("benchmarks/warmup").items()
    }


COMPUTED: dict[str, Callable[[], Any]] = {
    function.__name__: cache(function)
    for function in (
        default_minutes, drill_string, drill_string_table, calibration_of_v,
        regrets_beyond, reliability, clock, tanks_published, conditioning, tsfast, paper,
        drill_string_of_the_paper, losses, lowest_deviation, physics, physics_wrong_table,
        few_samples, split_training, *statements.FIGURES,
    )
}  # fmt: skip


def main() -> None:
    """Write the figures of every page, and say which pages changed."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for page in pages():
        text = page.read_text(encoding="utf-8")
        try:
            new = filled(text)
        except ValueError as error:
            raise SystemExit(f"{page.relative_to(ROOT)}: {error}") from error
        if new != text:
            page.write_text(new, encoding="utf-8")
            print(page.relative_to(ROOT))


if __name__ == "__main__":
    main()

"""Make the tables and README.md from the run files: `python -m reproduction.fill`.

README.md is pages/results.md with whatever stands between double braces replaced by what the
function of that name in `Page` says of the tables, so that no figure is typed in. pages/causes.md
has, for rows that differ from the paper's, what was found, with figures in the same way.
"""

from __future__ import annotations

import json
import re
import shlex
import statistics
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from reproduction.__main__ import main as reproduction
from reproduction.tables import SETTLED_SHARE, epochs, full_seconds, spread
from splitband.data.named import double_mass_spring
from splitband.metrics import rmse

RESULTS = Path(__file__).parents[1] / "docs" / "results"
PAGES = Path(__file__).parent / "pages"
Row = Mapping[str, Any]
ERRORS = ("learning-based", "hybrid-gru", "hybrid-rnn", "pendulum")
"""Tables whose rows have one system and one method each."""
NAIVE = ("persistence", "seasonal-naive", "harmonic")
APART = 2.0
"""Standard errors by which two means are called different; standard deviations, from the paper."""


class Page:
    """What results.md and causes.md may ask for: each public method, by its name.

    A row is named by system and method, as in `v/filtered-gru`.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.tables = {
            path.stem: json.loads(path.read_text(encoding="utf-8"))
            for path in sorted((folder / "tables").glob("*.json"))
        }
        self.rows_of = {name: table["rows"] for name, table in self.tables.items()}
        self.rows = {f"{r['system']}/{r['method']}": r for t in ERRORS for r in self.rows_of[t]}

    def fill(self, template: str) -> str:
        """The text with its placeholders replaced, its paragraphs wrapped again."""
        text = re.sub(r"\{\{(.+?)\}\}", self._replaced, template, flags=re.DOTALL)
        return "\n\n".join(_wrapped(block) for block in text.split("\n\n"))

    def _replaced(self, found: re.Match[str]) -> str:
        name, *arguments = shlex.split(found[1])
        if name.startswith("_") or not hasattr(type(self), name):
            raise SystemExit(f"results.md asks for {name}, which fill.py does not know: {found[0]}")
        return str(getattr(self, name)(*arguments))

    # One row

    def error(self, row: str) -> str:
        """Mean and standard deviation over seeds of the total RMSE."""
        return spread(self.rows[row]["total_rmse"])

    def whole(self, row: str) -> str:
        """The same with the warm-up counted."""
        return spread(self.rows[row]["whole_rmse"])

    def paper(self, row: str) -> str:
        """The paper's value."""
        return str(self.rows[row]["paper_text"])

    def each(self, row: str) -> str:
        """The total RMSE of every seed, ascending."""
        return _listed(f"{value:.2f}" for value in sorted(self.rows[row]["total_rmse"]))

    def epochs(self, row: str) -> str:
        """How many were run, and of how many."""
        return epochs(self.rows[row])

    def noise(self) -> str:
        """The root mean square of the noise on (i)."""
        record = double_mass_spring()
        return f"{rmse(record.y, record.truth):.2f}"

    def alone(self, row: str, part: str) -> str:
        """The error that one part of a model has without the others."""
        return f"{self.rows[row]['parts_rmse'][part]:.3f}"

    def losses(self, row: str, network: str = "network") -> str:
        """The lowest and the highest training loss at the end, over seeds."""
        return _range(self.rows[row]["losses"][network])

    # Several rows

    def table(self, name: str) -> str:
        """A table as it stands in its file."""
        return str(self.tables[name]["markdown"]).strip()

    def fewer_seeds(self, name: str) -> str:
        """How many seeds the rows of a table have, and what a run takes."""
        rows = [row for row in self.rows_of[name] if row["epochs"] is not None]
        if any(row["epochs"] != row["paper_epochs"] for row in rows):
            raise SystemExit(
                f"{name} has rows of fewer epochs than the paper's; results.md denies it"
            )
        runs = [row["runs"] for row in rows]
        counts = sorted({min(runs), max(runs)})
        minutes = {
            system: statistics.median(
                full_seconds(row) / 60 for row in rows if row["system"] == system
            )
            for system in dict.fromkeys(row["system"] for row in rows)
        }
        said = _listed(f"{took:.0f} on ({system})" for system, took in minutes.items())
        return (
            f"These rows have {' to '.join(map(str, counts))} of {rows[0]['asked']} seeds, each "
            "trained for all of the paper's epochs. A run takes so many minutes of a core, in the "
            f"median: {said}."
        )

    def tally(self, ours: str, theirs: str, *systems: str) -> str:
        """On which systems one method is better than another, and on which it is not."""
        found: dict[str, list[str]] = {"better": [], "level": [], "worse": []}
        for system in systems:
            a, b = (self.rows[f"{system}/{method}"] for method in (ours, theirs))
            values = f"({system}) {_mean(a):.3f} against {_mean(b):.3f}"
            found[_verdict(a["total_rmse"], b["total_rmse"])].append(values)
        parts = [f"{verdict} on {_listed(values)}" for verdict, values in found.items() if values]
        return "; ".join(parts)

    def draws(self, ours: str, theirs: str) -> str:
        """Two methods over the noise draws of (i)."""
        rows = {row["method"]: row["total_rmse"] for row in self.rows_of["noise-draws"]}
        better = sum(a < b for a, b in zip(rows[ours], rows[theirs], strict=True))
        medians = (statistics.median(rows[method]) for method in (ours, theirs))
        run = {row["method"]: epochs(row) for row in self.rows_of["noise-draws"]}
        return (f"better on {better} of {len(rows[ours])} noise draws of (i), median "
                f"{next(medians):.3f} against {next(medians):.3f}, after {run[ours]} and "
                f"{run[theirs]} epochs")  # fmt: skip

    def draw_median(self, method: str) -> str:
        """Over the noise draws of (i)."""
        rows = {row["method"]: row["total_rmse"] for row in self.rows_of["noise-draws"]}
        return f"{statistics.median(rows[method]):.3f}"

    def draw_share_below(self, method: str, row: str) -> str:
        """How many of the noise draws a method has a lower error on than the paper reports."""
        rows = {r["method"]: r["total_rmse"] for r in self.rows_of["noise-draws"]}
        below = sum(value < self.rows[row]["paper"]["mean"] for value in rows[method])
        return f"{below} of {len(rows[method])}"

    def ablation(self, name: str, method: str) -> str:
        """The errors of an ablation, and how far they are apart."""
        rows = [row for row in self.rows_of[name] if row["method"] == method]
        values = _listed(f"{spread(r['total_rmse'])} at {r['value']:g}" for r in rows)
        means = [_mean(row) for row in rows]
        deviation = statistics.mean(statistics.stdev(row["total_rmse"]) for row in rows)
        return (f"{values}; the best and the worst are {(max(means) - min(means)) / deviation:.1f} "
                f"standard deviations over seeds apart")  # fmt: skip

    def settled_share(self) -> str:
        """What twice the epochs must leave of a loss that has settled."""
        return f"{SETTLED_SHARE:.0%}"

    def naive(self) -> str:
        """Where the best network at the paper's settings beats the best naive baseline."""
        won: list[str] = []
        lost: list[str] = []
        for system in dict.fromkeys(row["system"] for row in self.rows.values()):
            rows = [row for row in self.rows.values() if row["system"] == system]
            baseline = min((r for r in rows if r["method"] in NAIVE), key=_mean)
            network = min((r for r in rows if r["epochs"] and r["total_rmse"]), key=_mean)
            text = (f"({system}) {network['method']} {_mean(network):.3f} against "
                    f"{baseline['method']} {_mean(baseline):.3f}")  # fmt: skip
            (won if _mean(network) < _mean(baseline) else lost).append(text)
        return f"On {_listed(won or ['no record'])}. Not on {_listed(lost or ['any other'])}."

    # Run times

    def paper_seconds(self, name: str, row: str) -> str:
        """What the paper reports in a row of a table of run times."""
        found = {f"{r['system']}/{r['method']}": r for r in self.rows_of[name]}[row]
        return f"{found['paper']['mean']:.0f}"

    def shares(self, ours: str, theirs: str, *systems: str) -> str:
        """The run time of one method against another's, ours and the paper's, by system."""
        rows = {(r["system"], r["method"]): r for r in self.rows_of["runtime-learning-based"]}
        found = []
        for system in systems:
            a, b = (rows[system, method] for method in (ours, theirs))
            if a["seconds"] and b["seconds"]:
                share = full_seconds(a) / full_seconds(b)
                papers = a["paper"]["mean"] / b["paper"]["mean"]
                found.append(f"({system}) {share:.2f}, in the paper {papers:.2f}")
        return _listed(found)

    def file(self, path: str, *keys: str) -> str:
        """A figure of a JSON file beside this folder; the last key is how it is printed."""
        facts = json.loads((self.folder / path).read_text(encoding="utf-8"))
        for key in keys[:-1]:
            facts = facts[key]
        return format(facts, keys[-1])

    # Studies

    def tried(self, row: str, key: str) -> str:
        """Mean and standard deviation over the seeds of a row, such as `segments/nothing`."""
        return spread([run[key] for run in self._tried(row)])

    def tried_setting(self, row: str, name: str) -> str:
        """How a row was trained."""
        return str(self._tried(row)[0]["settings"][name])

    def key(self, study: str, name: str) -> str:
        """What a study calls a row of its facts, which must be there."""
        facts = json.loads((self.folder / study / f"{study}.json").read_text(encoding="utf-8"))
        if name not in facts:
            raise SystemExit(f"{study} has nothing of {name}, just {', '.join(facts)}")
        return name

    def _tried(self, row: str) -> list[dict[str, Any]]:
        paths = sorted(self.folder.glob(f"{row}-seed*.json"))
        return [json.loads(path.read_text(encoding="utf-8")) for path in paths]

    # What differs from the paper

    def worse(self) -> str:
        """Rows of the paper's tables that are worse than there, with what was found."""
        return self._differing(1)

    def better(self) -> str:
        """Rows that are better than in the paper."""
        return self._differing(-1)

    def far(self) -> str:
        """From how many of the paper's standard deviations on a row is listed."""
        return f"{APART:g}"

    def ablations_worse(self) -> str:
        """How many published rows of the ablations are worse than there."""
        known = [row for t in ("cutoff", "downsampling") for row in self.rows_of[t] if row["paper"]]
        return f"{sum(_deviations(row) > APART for row in known)} of {len(known)}"

    def _differing(self, sign: int) -> str:
        rows = {
            name: row for name, row in self.rows.items()
            if row["paper"] and row["paper"]["std"] and row["total_rmse"]
            and sign * _deviations(row) > APART
        }  # fmt: skip
        text, named = [], set()
        for names, cause in _causes(PAGES / "causes.md"):
            here = [name for name in names if name in rows]
            named |= {*here}
            if here:
                text.append(f"- {self._differences(here)} {self.fill(cause)}")
        text += [f"- {self._differences([n])} No cause was found." for n in rows if n not in named]
        return "\n".join(text) or "- None."

    def _differences(self, names: Iterable[str]) -> str:
        found = []
        for name in names:
            row = self.rows[name]
            found.append(f"({row['system']}) {row['method']}, {self.error(name)} against "
                         f"{self.paper(name)}: {abs(_deviations(row)):.1f} deviations")  # fmt: skip
        return f"**{'; '.join(found)}.**"


def _wrapped(block: str) -> str:
    """A paragraph, or the items of a list, in lines of 100 characters; other blocks as they are."""
    if not re.match(r"[A-Za-z(*]|- ", block) or "\n|" in block:
        return block
    indent = "  " if block.startswith("- ") else ""
    wrap = textwrap.TextWrapper(100, subsequent_indent=indent, break_long_words=False,
                                break_on_hyphens=False)  # fmt: skip
    items = re.split(r"\n(?=- )", block.rstrip("\n"))
    end = "\n" if block.endswith("\n") else ""
    return "\n".join(wrap.fill(" ".join(item.split())) for item in items) + end


def _causes(path: Path) -> list[tuple[list[str], str]]:
    """Each heading's rows, and the text below it."""
    parts = re.split(r"^## (.+)$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    return [
        (names.split(), text.strip()) for names, text in zip(parts[::2], parts[1::2], strict=True)
    ]


def _mean(row: Row) -> float:
    return statistics.mean(row["total_rmse"]) if row["total_rmse"] else float("inf")


def _deviations(row: Row) -> float:
    """How much worse a row is than the paper's, in the paper's standard deviations."""
    return float((_mean(row) - row["paper"]["mean"]) / row["paper"]["std"])


def _verdict(ours: Sequence[float], theirs: Sequence[float]) -> str:
    """By the difference of two means and its standard error (Welch's)."""
    errors = [statistics.variance(v) / len(v) if len(v) > 1 else 0.0 for v in (ours, theirs)]
    difference = statistics.mean(ours) - statistics.mean(theirs)
    if abs(difference) <= APART * sum(errors) ** 0.5:
        return "level"
    return "better" if difference < 0 else "worse"


def _range(values: Sequence[float]) -> str:
    lowest, highest = f"{min(values):.2f}", f"{max(values):.2f}"
    return lowest if lowest == highest else f"{lowest} to {highest}"


def _listed(texts: Iterable[str]) -> str:
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def main() -> None:
    """Make the tables again and write README.md."""
    if reproduction(["table", "all", "--no-run", "--out", str(RESULTS)]):
        raise SystemExit("README.md is left as it is")
    text = Page(RESULTS).fill((PAGES / "results.md").read_text(encoding="utf-8"))
    (RESULTS / "README.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

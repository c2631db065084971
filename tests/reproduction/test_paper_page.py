"""docs/paper.md: its equations, its code; and figures that are as fresh as the run files."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from reproduction import figures, horizons, specs
from reproduction.__main__ import main
from reproduction.jobs import SYSTEMS, Job
from reproduction.runs import complete, load
from reproduction.settings import OURS
from splitband.comparison.methods import NAMES
from splitband.metrics import rmse
from splitband.records.named import RECORDS

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "paper.md"
RESULTS = ROOT / "docs" / "results"
NAMED = (
    "dynamics, observation, complementarity, recurrence, decomposition, joint recurrence, "
    "recurrent model, rollout, down-sampling, training, prediction, hybrid loss"
)
EQUATIONS = dict(enumerate(NAMED.split(", "), 1))
"""The numbered equations of the paper's main text."""
MENTION = re.compile(r"\bEqs?\.\s+(\d+)(?:, ([a-z][a-z-]*(?: (?:loss|model|recurrence))?))?")


def mentions(text: str) -> list[tuple[int, str]]:
    """Each equation that a text names, with the words behind its number."""
    return [(int(number), name) for number, name in MENTION.findall(" ".join(text.split()))]


def wrong(text: str) -> list[tuple[int, str]]:
    return [(number, name) for number, name in mentions(text) if EQUATIONS.get(number) != name]


@pytest.mark.parametrize("folder", ["src", "reproduction", "benchmarks", "docs", "README.md"])
def test_every_equation_is_named_and_numbered_as_in_the_paper(folder: str) -> None:
    files = [ROOT / folder] if folder.endswith(".md") else (ROOT / folder).rglob("*.*")
    found = {
        str(path.relative_to(ROOT)): faults
        for path in files
        if path.suffix in (".py", ".md") and "_build" not in path.parts
        if (faults := wrong(path.read_text(encoding="utf-8")))
    }
    assert found == {}


def test_the_page_has_every_equation_and_the_files_that_it_names_are_there() -> None:
    assert {number for number, _ in mentions(PAGE.read_text(encoding="utf-8"))} == {*EQUATIONS}
    for path in re.findall(r"`((?:filters|models|networks|data|tests)/[\w./]*)`", PAGE.read_text()):
        assert (ROOT / path).exists() or (ROOT / "src/splitband" / path).exists(), path


JOBS = {"Split(": ("i", "split-gru"), "Filtered(None": ("v", "filtered-gru")}
BLOCKS = re.findall(r"```python\n(.+?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def error_of(method: str, epochs: int | None) -> tuple[float, float]:
    """The RMSE of a block of the page, and what its comment says."""
    (code,) = (block for block in BLOCKS if f"sb.{method}" in block)
    if epochs is not None:
        code = re.sub(r"epochs=\d+", f"epochs={epochs}", code)
    names: dict[str, Any] = {}
    exec(code, names)
    y = names["y"]
    return rmse(names["record"].truth[-len(y) :], y), float(re.findall(r"\]: ([\d.]+)", code)[0])


@pytest.mark.parametrize("method", JOBS)
def test_five_lines_are_the_paper_s_row(method: str, tmp_path: Path) -> None:
    """Of two epochs, by the page and by the reproduction."""
    system, name = JOBS[method]
    job = Job(system, name, epochs=2)
    complete([job], tmp_path)
    assert error_of(method, 2)[0] == pytest.approx(load(job, tmp_path)["total_rmse"], abs=1e-6)


@pytest.mark.soak
@pytest.mark.parametrize("method", JOBS)
def test_five_lines_have_the_stored_error(method: str) -> None:
    stored = load(Job(*JOBS[method]), RESULTS / "runs")["total_rmse"]
    found, said = error_of(method, None)
    assert found == pytest.approx(stored, abs=1e-6)
    assert said == pytest.approx(stored, abs=5e-4)


def test_a_simulator_of_one_s_own_works_as_printed() -> None:
    (code,) = (block for block in BLOCKS if "sb.Ode(" in block)
    names: dict[str, Any] = {}
    exec(code, names)
    assert rmse(names["record"].y[600:], names["y"]) < 0.1  # the simulator has 0.33


COMMANDS = {
    command: None
    for page in (PAGE, ROOT / "reproduction/REPORT.md")
    for command in re.findall(r"^    python -m reproduction (.+)$", page.read_text("utf-8"), re.M)
}


@pytest.mark.usefixtures("public_data")
@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_of_the_pages_runs(command: str, tmp_path: Path) -> None:
    """With the stored runs, beside which it writes nothing."""
    words, out = shlex.split(command, comments=True), ["--out", str(tmp_path)]
    (tmp_path / "runs").symlink_to(RESULTS / "runs", target_is_directory=True)
    assert main([*words, *(["--no-run"] if words[0] != "list" else []), *out]) == 0


def test_the_map_names_what_is_there() -> None:
    section = PAGE.read_text(encoding="utf-8").split("## Tables, figures, systems and methods")[1]
    for kind, numbered in (("Table", specs.NUMBERED), ("Figure", figures.NUMBERED)):
        found = re.findall(rf'`{kind.lower()} "{kind} (\d+)"`', section)
        assert {*map(int, found)} == {*numbered}
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if line[:2] == "| "]
    known = {4: ({*OURS, *NAMES}, {*NAMES}), 3: ({*SYSTEMS}, {*RECORDS})}
    for row in (row for row in rows if len(row) in known and row[1].startswith("`")):
        for cell, names in zip(row[1:], known[len(row)], strict=False):
            assert {*re.findall(r"`([\w-]+)", cell)} <= names, row
    assert len([row for row in rows if len(row) in known]) == 7 + 4 + 2


@pytest.mark.usefixtures("public_data")
def test_errors_by_horizon_are_those_of_the_committed_runs() -> None:
    """Where they are not: `make figures`."""
    committed = json.loads((RESULTS / "horizons.json").read_text(encoding="utf-8"))
    assert json.loads(json.dumps(horizons.collected(RESULTS / "runs"))) == committed

"""Nothing of what the package has given up is left in its code, help texts or documentation."""

import re
from pathlib import Path

import pytest

import splitband

ROOT = Path(__file__).parents[1]
FILES = [
    *Path(splitband.__file__).parent.rglob("*.py"),
    *(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts),
    ROOT / "README.md",
]
REMOVED = {
    "resuming by a hash of code": r"[Cc]heckpoints?\b|code_digest|content_digest|fit_key",
    "caches of simulators": r"simulator[-_](cache|reads)\b|key_of\b|_Runs\b",
    "probing how an FMU is read": r"reading_of|_is_late|LateError|_two_steps",
    "whole forecasters in torch": r"as_torch|TorchSimulation|ModelSimulation|\.differentiable\b",
    "records beyond their end": r"[Rr]ecord\.beyond|u_beyond",
    "commands with code of their own": r"sb\.[Ff]orecast\b|run_forecast|list_records|data fetch",
    "hints at earlier versions": r"GONE\b",
    "behaviour by a name, layout by hand": r"__module__\.startswith|fmt: ?(skip|off)",
    "names of settings": r"sb\.Settings|most_(batches|samples)|[Qq]uasi_?[Nn]ewton",
    "simulators that hold inputs": r"held=|--held\b",
    "methods of forecasters": r"check_residuals|as_casadi|sb\.(EulerMLP|Cell|rollout)\b",
    "names of files": r"splitband[./]evaluation|forecasters[./](names|backtest|checking)\b",
}
INSTEAD = ["skip_done", "TrainingSettings", "lbfgs_iterations", "--simulator-hold", "casadi_step"]


def lines_with(pattern: str) -> list[str]:
    """The lines of code and documentation in which the pattern is found as a word's beginning."""
    find = re.compile(rf"(?<!\w)(?:{pattern})").search
    lines = ((path, line) for path in FILES for line in path.read_text("utf-8").splitlines())
    return [f"{path.name}: {line.strip()}" for path, line in lines if find(line)]


@pytest.mark.parametrize("what", REMOVED)
def test_what_went_is_not_named_any_more(what: str) -> None:
    assert lines_with(REMOVED[what]) == []


@pytest.mark.parametrize("name", INSTEAD)
def test_what_a_user_has_instead_is_named(name: str) -> None:
    assert lines_with(re.escape(name))

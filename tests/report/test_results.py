"""What every result says of where it comes from."""

import subprocess
from pathlib import Path

import pytest

from splitband.report.environment import environment

ROOT = Path(__file__).parents[2]


def test_a_result_names_the_commit_of_its_checkout() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("this is no checkout: an unpacked source distribution has no commit")
    head = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    commit = environment()["commit"]
    assert commit
    assert head.startswith(commit.removesuffix("-dirty"))

"""Results of older code are marked on the pages, and left out of the README."""

import importlib
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
TODAY = {"sources": "today", "commit": "abc", "computer": None}


@pytest.fixture
def claims(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("benchmarks.claims")


def copied(claims: Any, folder: Path, change: Callable[[str], str]) -> Path:
    """Return the root of a copy of the package with a changed file."""
    for room in claims.ROOMS:
        shutil.copytree(ROOT / "src/splitband" / room, folder / "src/splitband" / room)
    shutil.copy(ROOT / "src/splitband/metrics.py", folder / "src/splitband")
    path = folder / "src/splitband/training/settings.py"
    text = path.read_text(encoding="utf-8")
    path.write_text(changed := change(text), encoding="utf-8")
    assert changed != text
    return folder


@pytest.mark.parametrize(
    ("change", "counts"),
    [
        (lambda text: text.replace('"""', '"""It said: ', 1), False),
        (lambda text: f"# Said.\n{text}\n\n\n# More.\n", False),
        (lambda text: f'{text}\nMORE = 1\n"""Its reason."""\n', True),
        (lambda text: re.sub(r"(: float = )\d[\d.e-]*", r"\g<1>0.12345", text, count=1), True),
    ],
    ids=["docstring", "comments", "new constant", "changed number"],
)
def test_what_decides_accuracy_has_a_hash_of_code_alone(
    claims: Any, tmp_path: Path, change: Callable[[str], str], counts: bool
) -> None:
    assert (claims.sources(copied(claims, tmp_path, change)) != claims.sources()) is counts


def test_every_folder_with_numbers_counts(claims: Any) -> None:
    """A folder that is new, or renamed, has to be named in one list or in the other."""
    folders = {path.parent.name for path in (ROOT / "src/splitband").glob("*/__init__.py")}
    shown = {"checks", "cli", "export", "records", "report", "runtime"}
    assert folders == {*claims.ROOMS} | shown


def test_sources_that_compute_the_same_are_followed_from_pair_to_pair(
    claims: Any, tmp_path: Path
) -> None:
    pairs = [["a", "b"], [claims.sources(), "b"], ["c", "d"]]
    path = tmp_path / "equal.jsonl"
    path.write_text("".join(json.dumps({"sources": pair}) + "\n" for pair in pairs))
    assert claims.equal(path) == {claims.sources(), "a", "b"}


def test_sources_that_differ_on_one_record_are_the_same_for_others(
    claims: Any, tmp_path: Path
) -> None:
    row = {"sources": ["a", claims.sources()], "others": ["pendulum"]}
    (path := tmp_path / "equal.jsonl").write_text(json.dumps(row) + "\n")
    assert claims.equal(path, record="tanks") == {claims.sources(), "a"}
    assert claims.equal(path, record="pendulum") == claims.equal(path) == {claims.sources()}


def test_the_check_of_equal_numbers_lists_both_sources_with_its_output(
    claims: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frozen = importlib.import_module("benchmarks.frozen")
    listed = claims.read(claims.EQUAL)
    monkeypatch.setattr(claims, "EQUAL", path := tmp_path / "equal.jsonl")
    frozen.list_as_equal("abc", ["before", claims.sources()], ["tanks: equal (40 facts)"])
    assert claims.equal(path) == {"before", claims.sources()}
    for row in [*listed, *claims.read(path)]:
        assert len(row["sources"]) == len(row["commits"]) == 2
        assert row["output"]
        others = tuple(f"{name}: " for name in row.get("others", []))
        said = [line for line in row["output"] if not line.startswith(others)]
        assert all(re.search(r": equal( \(\d+ facts\))?$", line) for line in said)


def test_pages_mark_the_runs_of_older_code_and_no_others(claims: Any) -> None:
    clock, page, sets = (
        importlib.import_module(f"benchmarks.{name}") for name in ("clock", "page", "sets")
    )
    rows = claims.read(claims.STORED / clock.FILE)
    stale: dict[tuple[str, str, bool], bool] = {}
    for row in rows:
        key = row["record"], f"{row['asked']:g}", bool(row["beside"])
        stale[key] = stale.get(key, False) or not claims.current(row)
    shown = {}
    for line in page.table_of("benchmark-time").splitlines():
        if found := re.match(r"\| (.+?)( †)? \| (\d+) s(, busy)? \|", line):
            shown[found[1], found[3], bool(found[4])] = bool(found[2])
    assert shown == stale
    for name in sets.SETS:
        text = page.table_of(f"benchmark-{name}")
        own = re.findall(
            r"^\| `splitband compare --budget (\d+)s`( beside .*?)?( †)? \|", text, re.M
        )
        marks = {(name, asked, bool(beside)): bool(mark) for asked, beside, mark in own}
        assert marks == {key: old for key, old in stale.items() if key[0] == name}
        measured = {row["commit"] for row in rows if row["record"] == name}
        assert all(commit in text for commit in measured)


def test_the_readme_shows_a_record_once_five_seeds_are_of_todays_code(
    claims: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    tables = importlib.import_module("docs.tables")
    asked = {"asked": 120.0, "beside": 0}
    old = [{"record": "silverbox", "errors": [9e-4], "commit": "old"} | asked] * 5
    new = [{"record": "tanks5", "errors": [0.2 + 0.01 * i]} | asked | TODAY for i in range(5)]
    few = [{"record": "drill string", "errors": [0.3]} | asked | TODAY] * 4
    monkeypatch.setattr(claims, "equal", lambda **_: {"today"})
    monkeypatch.setattr(claims, "read", lambda path: [*old, *new, *few])
    text = tables.readme_benchmarks()
    assert "| 0.220 V | 0.200 to 0.240 |" in text
    assert "0.900" not in text
    assert text.endswith(
        "`make claims`: Silverbox, multisine; Silverbox, arrow; drill string, normalised."
    )
    monkeypatch.setattr(claims, "read", lambda path: old)
    assert "|" not in tables.readme_benchmarks()


def test_a_note_says_where_runs_were_measured(claims: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claims, "equal", lambda **_: {claims.sources()})
    new, old = claims.marked({"commit": "abc"}, 0.001), {"commit": "def"}
    said = claims.note([old, new]).strip().split("\n\n")
    assert said[0] == "† Measured at commit def, before code that decides accuracy changed."
    assert re.fullmatch(
        r"The others were measured at commit abc \(.+, \d+ cores, reference training "
        r"0\.001 to [\d.]+ s\)\.",
        said[1],
    )
    assert claims.sign([new]) == ""
    assert claims.sign([new, old]) == " †"

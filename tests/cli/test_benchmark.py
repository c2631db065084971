"""`splitband benchmark`: many records by a list, compared one by one and put into one table."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from splitband.cli import cases, main
from splitband.cli.benchmark import cases_at_once
from splitband.cli.comparing import Request
from splitband.evaluation.plan import Plan
from splitband.evaluation.run import run
from splitband.evaluation.work import Work
from splitband.runtime.files import CHECKPOINTS
from splitband.runtime.outputs import locked
from tests.cli.support import (
    QUICK,
    SAMPLES,
    TRAIN,
    A,
    assert_fails,
    call,
    files,
    results,
)
from tests.drawing import nothing_drawn
from tests.records import rms

LIST = """\
record,name,columns,inputs,test,simulator,train,warmup
data/record.csv,free,a,,,,,
data/record.csv,tested,a,force,data/history.csv; data/record.csv,,,12
data/record.csv,wrong,absent,,,,,
data/record.csv,beside,a,,,data/simulated.csv,120,
"""
COMPARE = "splitband.cli.comparing.run"
NAMES = ["free", "tested", "wrong", "beside"]
OPTIONS = f"--methods gru,mean {QUICK} --seeds 1 --jobs 1"


@pytest.fixture(scope="module")
def begun(workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a list, the data beside it and what the command makes of them."""
    folder = tmp_path_factory.mktemp("benchmark")
    (folder / "data").mkdir()
    for name in ("record", "history", "simulated"):
        shutil.copy(workspace / f"{name}.csv", folder / "data")
    (folder / "list.csv").write_text(LIST)
    with pytest.MonkeyPatch.context() as undrawn:
        nothing_drawn(undrawn)
        # From elsewhere, as files are relative to the list.
        call(f"benchmark {folder}/list.csv {OPTIONS}", folder / "out")
    return folder


@pytest.fixture
def again(begun: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The test runs in a copy of that folder; how many samples each comparison since then had."""
    shutil.copytree(begun, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    compared: list[int] = []

    def counted(plan: Plan, work: Work) -> Any:
        compared.append(len(plan.record))
        return run(plan, work)

    monkeypatch.setattr(COMPARE, counted)
    return compared


def table(folder: Path) -> pd.DataFrame:
    return pd.read_csv(folder / "table.csv", index_col="name")


def assert_same_tables(found: pd.DataFrame, expected: pd.DataFrame, *but: str) -> None:
    but_for = [*but]
    pd.testing.assert_frame_equal(
        found.drop(columns=but_for), expected.drop(columns=but_for), check_exact=True
    )


def test_each_case_has_what_compare_writes(begun: Path, tmp_path: Path) -> None:
    data = begun / "data"
    line = f"compare {data}/record.csv --columns a"
    call(
        f"{line} --inputs force --test {data}/history.csv --test {data}/record.csv {OPTIONS} "
        "--warmup 12",
        tmp_path / "tested",
    )
    call(f"{line} --simulator {data}/simulated.csv --train 120 {OPTIONS}", tmp_path / "beside")
    for name in ("tested", "beside"):
        assert files(begun / "out" / name).keys() == files(tmp_path / name).keys()
        ours, theirs = results(begun / "out" / name), results(tmp_path / name)
        for facts in (ours, theirs):
            for method in facts["methods"].values():
                del method["seconds"]
        for key in theirs.keys() - {"command", "arguments", "time"}:
            assert ours[key] == theirs[key], key
        predictions = Path(name) / "predictions.csv"
        assert (begun / "out" / predictions).read_bytes() == (tmp_path / predictions).read_bytes()


def test_the_table_has_the_numbers_of_the_cases(begun: Path) -> None:
    found = table(begun / "out")
    assert [*found.index] == NAMES
    for name, protocol in (("free", "forecast"), ("tested", "test"), ("beside", "forecast")):
        facts, row = results(begun / "out" / name), found.loc[name]
        each: dict[str, list[float]] = {}
        for column in facts["table"]:
            if column["heading"] == f"{protocol} fit %":
                for method, fit in column["values"].items():
                    each.setdefault(method, []).append(1 - fit / 100)
        errors = {method: np.mean(of_records) for method, of_records in each.items()}
        best = min(errors, key=lambda method: errors[method])
        assert (row["protocol"], row["best"]) == (protocol, best)
        assert row["recommended"] == facts["recommended"]
        assert row["error"] == pytest.approx(errors[facts["recommended"]])
        assert row["best_error"] == pytest.approx(errors[best])
        assert row["regret"] == pytest.approx(errors[facts["recommended"]] / errors[best])
        assert row["seconds"] == facts["seconds"] > 0
        covers = facts["methods"][facts["recommended"]]["interval"].get("covers", np.nan)
        assert row["held"] == pytest.approx(covers, nan_ok=True)
    # The mean's error by hand; it knows three quarters of a record that has a mean of nearly 0.
    facts = results(begun / "out" / "free")["methods"]["mean"]
    assert facts["forecast_rmse"] == [pytest.approx(rms(A[TRAIN:] - A[:TRAIN].mean()))]


def test_a_case_that_fails_has_a_row_that_says_why(begun: Path) -> None:
    row = table(begun / "out").loc["wrong"]
    assert "column 'absent' is unknown" in row["failed"]
    assert row[["error", "regret", "held", "seconds"]].isna().all()
    assert not (begun / "out" / "wrong").exists()
    found = results(begun / "out")
    assert [case["name"] for case in found["cases"]] == NAMES
    assert (found["summary"]["cases"], found["summary"]["failed"]) == (4, 1)
    assert found["environment"]["versions"]["numpy"] == np.__version__


def test_given_again_it_computes_nothing_and_ends_with_the_same_table(
    again: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    before = table(Path("out"))
    (Path("out") / "free" / CHECKPOINTS).mkdir()  # as after a kill just before it is removed
    call(f"benchmark list.csv {OPTIONS.replace('--jobs 1', '--jobs 2')}", Path("out"))
    assert again == []
    assert not [*Path("out").rglob(CHECKPOINTS)]
    assert_same_tables(before, table(Path("out")), "failed")  # which names the file as it was given
    said = capsys.readouterr().out
    for row in table(Path("out")).itertuples():
        line = next(line for line in said.splitlines() if line.startswith(f"│ {row.Index} "))
        assert ("failed" in line) if row.Index == "wrong" else (f"{row.error:.3g}" in line)


def test_cases_at_once_have_the_numbers_of_one_after_the_other(
    again: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("list.csv").write_text("\n".join([*LIST.splitlines()[:2], LIST.splitlines()[3]]))
    call(f"benchmark list.csv {OPTIONS.replace('--jobs 1', '--jobs 2')} --at-once 2", Path("side"))
    said = capsys.readouterr().out
    assert "2 cases at once, each on 1 of 2 cores" in said
    assert "2 of 2" in said
    assert again == []  # in other processes
    found = table(Path("side"))
    assert_same_tables(table(Path("out")).loc[["free", "wrong"]], found, "failed", "seconds")
    assert "column 'absent' is unknown" in str(found.loc["wrong", "failed"])
    predictions = Path("free") / "predictions.csv"
    assert (Path("out") / predictions).read_bytes() == (Path("side") / predictions).read_bytes()
    assert not [*Path("side").rglob(CHECKPOINTS)]


@pytest.mark.parametrize(
    ("cases", "cores", "asked", "commanding", "expected"),
    [
        (10, 2, None, None, 1),
        (10, 16, None, None, 8),
        (3, 16, None, None, 3),
        (10, 2, 4, None, 4),
        (3, 2, 4, None, 3),
        (1000, 1000, None, 8, 32),
        (1000, 4, None, 8, 2),
    ],
)
def test_a_case_has_two_cores_unless_the_user_says_otherwise(
    cases: int, cores: int, asked: int | None, commanding: int | None, expected: int
) -> None:
    assert cases_at_once(cases, cores, asked, commanding) == expected


def test_what_decides_the_numbers_of_a_case_makes_it_anew(again: list[int]) -> None:
    listed = LIST.replace("history.csv; data/record.csv", "history.csv")
    Path("list.csv").write_text(listed)
    call(f"benchmark list.csv {OPTIONS}", Path("out"))
    assert again == [SAMPLES]  # one case has other tests
    simulated = pd.read_csv("data/simulated.csv")
    simulated.assign(a=simulated["a"] + 0.1).to_csv("data/simulated.csv", index=False)
    call(f"benchmark list.csv {OPTIONS}", Path("out"))
    assert again == [SAMPLES] * 2  # and another one another simulator
    call(f"benchmark list.csv {OPTIONS.replace(',mean', '')}", Path("out"))
    assert again == [SAMPLES] * 5
    assert "mean" not in results(Path("out") / "free")["methods"]


@pytest.mark.parametrize("content", ["", "[]"])
def test_results_that_are_damaged_are_made_anew(again: list[int], content: str) -> None:
    Path("list.csv").write_text("\n".join(LIST.splitlines()[:2]))
    (Path("out") / "free" / "results.json").write_text(content)
    line = f"benchmark list.csv {OPTIONS.replace('gru,', '')}"
    call(line, Path("out"))
    assert again == [SAMPLES]
    assert results(Path("out"))["summary"]["failed"] == 0


def test_ctrl_c_ends_in_one_line_and_the_same_command_goes_on(
    again: list[int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.move("out", "whole")
    line = f"benchmark list.csv {OPTIONS} --out out"

    def interrupted(plan: Plan, work: Work) -> Any:
        if again:
            raise KeyboardInterrupt
        again.append(len(plan.record))
        return run(plan, work)

    with monkeypatch.context() as patch:
        patch.setattr(COMPARE, interrupted)
        assert main(line.split()) == 130
    assert capsys.readouterr().err == (
        "error: stopped; no file is half written, and the same command goes on from here\n"
    )
    assert (Path("out") / "free" / "results.json").exists()
    assert not (Path("out") / "table.csv").exists()
    call(line)
    assert len(again) == 3  # the first of the three that can be was not compared again
    assert_same_tables(table(Path("out")), table(Path("whole")), "failed", "seconds")
    assert not [*Path("out").rglob(CHECKPOINTS)]


def test_where_every_case_fails_so_does_the_command(
    again: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    line = f"benchmark list.csv {OPTIONS.replace('--epochs 2', '--epochs 0')} --out other"
    assert main(line.split()) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: no case could be compared; free: --epochs must")
    assert said.count("\n") == 1
    assert table(Path("other"))["failed"].notna().all()
    assert again == []


HEAD = "record,name,test,train,sampling_time,gaps,simulator\n"
GOOD = "data/record.csv,,,,,,\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "list.csv, row 1: must have a column record, got nothing"),
        ("name\nx\n", "list.csv, row 1: must have a column record, got name"),
        ("record,colour\n", "list.csv, row 1, column 2: must be one of record, name, "),
        ("record,record\n", "list.csv, row 1, column 2: must be there once, got record"),
        (HEAD, "list.csv: must have a row for each case below its header, got none"),
        (HEAD + "\n,,,,,,\n", "list.csv: must have a row for each case below its header, got none"),
        (
            HEAD + GOOD + "absent.csv,x\n",
            "list.csv, row 3, column record: must be a file or one of double-mass-spring, ",
        ),
        (HEAD + ",x\n", "list.csv, row 2, column record: must be a file or a named record, got no"),
        (
            HEAD + GOOD + "\ndata/record.csv,,,,,,\n",
            "list.csv, row 4, column name: must differ from that of row 2 (without a name a case "
            "is called after its record), got record",
        ),
        (HEAD + GOOD + "data/history.csv,Record\n", "must differ from that of row 2"),
        (HEAD + "data/record.csv,../x\n", "row 2, column name: must be the name of a folder"),
        (HEAD + "data/record.csv,table.csv\n", "row 2, column name: must be the name of a folder"),
        (
            HEAD + "data/record.csv,,data/history.csv;absent.csv\n",
            "list.csv, row 2, column test: must be a file, got data/history.csv;absent.csv",
        ),
        (
            HEAD + "data/record.csv,,,many\n",
            "row 2, column train: must be a whole number, got many",
        ),
        (
            HEAD + "data/record.csv,,,,-1\n",
            "row 2, column sampling_time: must be a number of seconds above 0, got -1",
        ),
        (HEAD + "data/record.csv,,,,,fill\n", "column gaps: must be one of refuse, mask, got fill"),
        (
            HEAD + "data/record.csv,,,,,,sim.py:run\n",
            "column simulator: must be a file, FILE.py:FUNCTION or one of ",
        ),
        (
            HEAD + "data/record.csv,,,,,,,a,b\n",
            "list.csv, row 2: must have a cell for each of the 7 columns, one with commas in ",
        ),
        (HEAD + '"data', "LIST must be a CSV file in UTF-8, got list.csv: "),
    ],
)
def test_a_bad_list_is_one_line_before_anything_is_computed(
    content: str, says: str, again: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("list.csv").write_text(content)
    assert_fails(f"benchmark list.csv {OPTIONS} --out other", (says,), capsys)
    assert again == []
    assert not Path("other").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            "--methods gru,nothing",
            "--methods must be forecasters or names that `splitband methods` lists",
        ),
        ("--budget soon", "--budget must be a time such as 90s, 10m or 1h, got soon"),
        ("--hidden 3", "--hidden must be HIGH,LOW, two whole numbers, got 3"),
        ("--lr-milestones x", "--lr-milestones must be EPOCH:RATE"),
        ("--device abacus", "--device must be one that is there, got abacus"),
    ],
)
def test_a_bad_option_is_one_line_before_anything_is_computed(
    options: str, says: str, again: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert_fails(f"benchmark list.csv {options} --out other", (says,), capsys)
    assert again == []


def test_a_list_that_is_not_there_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rule = "LIST must be a CSV file with a row for each case"
    for path, why in ((tmp_path, "is a folder"), (tmp_path / "none.csv", "does not exist")):
        assert main(["benchmark", str(path)]) == 2
        assert capsys.readouterr().err == f"error: {rule}, got {path}, which {why}\n"


def test_every_column_of_the_list_is_an_option_of_the_same_name(
    begun: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(begun)
    cells = {
        "record": "data/record.csv", "name": "n", "columns": '"a,b"', "inputs": "force",
        "time_column": "time", "sampling_time": "0.1", "gaps": "mask", "missing": "Bad",
        "skip_rows": "2", "header_row": "1", "train": "90", "warmup": "7",
        "test": "data/history.csv;data/record.csv", "test_simulator": "drill-string",
        "more": "data/history.csv", "more_simulator": "data/simulated.csv",
        "simulator": "linear", "simulator_columns": '"a,b"',
        "simulator_reads": "data/simulated.csv",
    }  # fmt: skip
    assert tuple(cells) == cases.COLUMNS
    Path("all.csv").write_text(f"{','.join(cells)}\n{','.join(cells.values())}\n")
    (case,) = cases.read_cases(Path("all.csv").absolute(), Request(""))
    listed = {**case.identity()["arguments"]}
    several = {"test", "test_simulator", "more", "more_simulator", "simulator_reads"}
    for column in set(cells) - {"name"}:
        cell = cells[column].strip('"')
        expected = cell.split(";") if column in several else cell
        assert (listed[column] if column in several else str(listed[column])) == expected
    assert case.request.testing.test == [f"{begun}/data/history.csv", f"{begun}/data/record.csv"]
    assert case.request.testing.test_simulator == ["drill-string"]
    assert case.request.simulator.simulator == "linear"
    assert {*case.files} == {"data/record.csv", "data/history.csv", "data/simulated.csv"}


def test_a_case_whose_folder_is_in_use_is_left_alone(
    workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("list.csv").write_text(
        f"record,columns,name\n{workspace}/record.csv,a,free\n{workspace}/record.csv,a,used\n"
    )
    with locked("out/used"):
        before = files(Path("out/used"))
        call("benchmark list.csv --methods mean --at-once 1", Path("out"))
        assert files(Path("out/used")) == before
    found = table(Path("out"))["failed"]
    assert pd.isna(found["free"])
    assert "out/used is in use by another splitband command" in found["used"]


def test_a_case_is_computed_again_when_a_module_or_a_file_of_its_simulator_changes(
    workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(workspace / "record.csv", tmp_path)
    Path("list.csv").write_text(
        "record,columns,simulator,simulator_reads\nrecord.csv,a,sim.py:f,table.txt\n"
    )
    here = f"open({str(tmp_path / 'table.txt')!r})"
    Path("sim.py").write_text(
        f"import helper\ndef f(t):\n    return 0 * t + helper.LEVEL + float({here}.read())\n"
    )

    def error(level: float, offset: float) -> float:
        Path("helper.py").write_text(f"LEVEL = {level}\n")
        Path("table.txt").write_text(f"{offset}\n")
        call("benchmark list.csv --methods simulator --warmup 10", Path("out"))
        found = results(Path("out/record"))["methods"]["simulator"]["total_rmse"][0]
        return float(found)

    for level, offset in ((5.0, 0.0), (50.0, 0.0), (50.0, 500.0)):
        assert error(level, offset) == pytest.approx(rms(A[10:] - level - offset), rel=1e-6)

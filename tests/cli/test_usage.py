"""The commands that the page shows are those of the options given, and can be pasted."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import splitband as sb
from splitband.cli.usage import usage
from splitband.comparison.methods import named
from splitband.comparison.plan import Plan

GIVEN: dict[str, Any] = {"record": "my rig.csv", "inputs": "force", "columns": None, "gaps": "mask"}
GIVEN |= {"test": ["later.csv"], "more": ["a.csv", "b.csv"], "train": 150, "out": "out"}
GIVEN |= {"methods": "gru,linear", "refit": True, "cutoff": 1.0, "hidden": 8}
GIVEN |= {"recipe": "default", "device": "cuda", "budget": "1m"}
OUT = Path("out")


def planned(nu: int = 0, start: float | None = 0.0, name: str = "rig") -> Plan:
    u = np.zeros((200, nu)) if nu else None
    record = sb.Record(np.zeros((200, 1)), 0.1, u=u, start=start, name=name)
    return Plan(record, 150, 50, (), sb.TrainingSettings())


def said(command: str) -> list[str]:
    """The words of a command over several lines."""
    return shlex.split(command.replace("\\\n", ""))


def test_the_trained_model_is_simulated_with_what_was_given() -> None:
    """What decides how a network is trained is in the folder; the record and the device are not."""
    found = usage("compare", GIVEN, OUT, planned(1), named("gru"))
    (_, simulate), (_, fit), (_, export), (_, checked), (_, python) = found.commands
    without_stamps = usage("compare", GIVEN, OUT, planned(1, None), named("gru"))
    assert "--future-inputs FILE" in without_stamps.commands[-2][1]
    assert export == "splitband export out/model model.fmu"
    assert said(checked) == said("splitband check out/model --gaps mask --record later.csv")
    assert said(simulate) == said(
        "splitband simulate out/model --future-inputs 'my rig.csv' --steps 50 --out ahead.csv"
    )
    assert said(fit) == said(
        "splitband fit 'my rig.csv' --inputs force --gaps mask --more a.csv --more b.csv "
        "--like out --device cuda --out out/model-of-all"
    )
    assert "sb.load('out/model')" in python
    assert "u=u" in python
    assert "--refit" in found.asked
    assert "--test later.csv" in found.asked


def test_the_check_of_the_page_reads_the_test_record_as_it_was_read() -> None:
    given = {**GIVEN, "skip_rows": 2, "missing": "Bad,-9", "time_column": "when"}
    commands = usage("compare", given, OUT, planned(), named("gru")).commands
    (checked,) = [command for _, command in commands if " check " in command]
    words = " ".join(said(checked))
    assert "--gaps mask --time-column when --missing Bad,-9 --skip-rows 2" in words


def test_the_check_of_a_hybrid_runs_the_simulator_or_asks_for_its_output() -> None:
    """A simulator that the inputs drive runs for any record; recorded output is of one of them."""
    plan, ran = planned(1), np.zeros((200, 1))
    cases = (ran, None, "rig.fmu"), (None, None, "FILE"), (ran, ["later-sim.csv"], "later-sim.csv")
    for y_sim, own, simulator in cases:
        given = {**GIVEN, "simulator": "rig.fmu", "simulator_columns": "y", "test_simulator": own}
        tested = replace(plan, tests=(replace(plan.record, y_sim=y_sim),))
        commands = dict(usage("compare", given, OUT, tested, named("filtered-gru")).commands)
        words = " ".join(said(commands["Check it on the test record"]))
        assert f"--simulator {simulator} --simulator-columns y --record later.csv" in words


def test_rounds_of_a_search_are_left_out_for_a_method_that_is_not_trained() -> None:
    given = {**GIVEN, "rounds": 1}
    for method in ("mean", "gru"):
        commands = dict(usage("compare", given, OUT, planned(), named(method)).commands)
        assert "--rounds" not in commands["Fit it to the whole record"]


def test_only_a_model_that_asks_for_a_simulator_is_simulated_with_one() -> None:
    given = {"record": "rig.csv", "simulator": "rig.fmu", "simulator_columns": "y"}
    given["simulator_start"] = "record"
    for method, asked in (("filtered-gru", True), ("gru", False), ("linear", False)):
        (_, simulate), *_ = usage("compare", given, OUT, planned(), named(method)).commands
        words = " ".join(said(simulate))
        opened = "--simulator rig.fmu --simulator-columns y --simulator-start record --steps"
        assert (opened in words) == asked


def test_a_record_that_the_command_made_has_a_name_for_the_others() -> None:
    made = planned(1, name="overhead-crane")
    found = usage("demo", {"out": "demo"}, OUT, made, named("harmonic"))
    (_, simulate), (_, command), *_ = found.commands
    assert "--future-inputs overhead-crane" in simulate
    assert command.startswith("splitband fit overhead-crane --method harmonic")
    assert found.asked == "splitband demo --out demo"

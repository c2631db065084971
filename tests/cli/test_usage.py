"""The commands that the page shows are those of the options given, and can be pasted."""

import shlex
from pathlib import Path

import pytest

from splitband.cli.usage import usage

GIVEN = {
    "record": "my rig.csv", "inputs": "force", "columns": None, "gaps": "mask", "cutoff": "auto",
    "train": 150, "test": ["later.csv"], "methods": "gru,linear", "calibrate": True, "out": "out",
    "recipe": "default", "device": "cpu", "more": ["a.csv", "b.csv"],
}  # fmt: skip


def test_a_network_is_fitted_and_simulated_with_what_was_given() -> None:
    found = usage("compare", GIVEN, "gru", driven=True)
    (_, fit), (_, simulate) = found.commands
    assert shlex.split(fit.replace("\\\n", "")) == shlex.split(
        "splitband fit 'my rig.csv' --inputs force --gaps mask --more a.csv --more b.csv "
        "--cutoff auto --method gru --out model"
    )
    assert simulate.startswith("splitband simulate model --history FILE --steps 100")
    assert "--future-inputs FILE" in simulate
    assert found.reading == "record = sb.read('my rig.csv', inputs=['force'], gaps='mask')"
    assert "--calibrate" in found.asked
    assert "--test later.csv" in found.asked


def test_a_network_is_trained_again_as_it_was_found() -> None:
    """What decides how to train is in the file; the record and the device are not."""
    given = GIVEN | {"budget": "1m", "hidden": 8, "device": "cuda"}
    (_, fit), _ = usage("compare", given, "gru", driven=True, found=Path("out/found.json")).commands
    assert shlex.split(fit.replace("\\\n", "")) == shlex.split(
        "splitband fit 'my rig.csv' --inputs force --gaps mask --more a.csv --more b.csv "
        "--settings out/found.json --device cuda --method gru --out model"
    )


def test_a_simulator_is_forecast_with() -> None:
    ((_, command),) = usage("compare", GIVEN, "simulator-calibrated").commands
    assert command.startswith("splitband forecast 'my rig.csv' --inputs force --gaps mask")
    assert command.endswith("--method simulator-calibrated --steps 100")


def test_only_a_model_that_asks_for_a_simulator_is_simulated_with_one() -> None:
    given = {"record": "rig.csv", "simulator": "sim.csv", "simulator_columns": "y"}
    for method, asked in (("filtered-gru", True), ("gru", False), ("linear", False)):
        _, (_, simulate) = usage("compare", given, method).commands
        assert ("--simulator sim.csv --simulator-columns y" in simulate) == asked


def test_a_record_that_the_command_made_has_a_name_for_the_others() -> None:
    found = usage("demo", {"out": "demo"}, "harmonic", named="overhead-crane")
    (_, command), _ = found.commands
    assert command.startswith("splitband fit overhead-crane --method harmonic")
    assert found.asked == "splitband demo --out demo"


@pytest.mark.parametrize("command", ["demo", "benchmark"])
def test_a_command_without_a_record_has_no_example(command: str) -> None:
    found = usage(command, {"listed": "a list.csv", "out": "out"})
    assert not found.commands
    assert found.asked == f"splitband {command} 'a list.csv' --out out"

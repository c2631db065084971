"""An exported FMU is valid, and says what a stream says, as FMPy runs it."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.simulation import instantiate_fmu
from fmpy.validation import validate_fmu
from hypothesis import example, given
from hypothesis import strategies as st

import splitband as sb
from docs.run import blocks
from splitband.export.fmu import PortNames, port_name
from tests.export.test_c import STRICT
from tests.streams import driven, fitted, free, rows


class Instance:
    """An FMU in FMPy, with the methods of a stream: inputs are set before outputs are read."""

    def __init__(self, file: Path, folder: Path, record: sb.Record) -> None:
        fmpy.extract(str(file), str(folder))
        description = fmpy.read_model_description(str(file))
        self.fmu: Any = instantiate_fmu(str(folder), description)
        self.fmu.setupExperiment()
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.record, self.time = record, 0.0

    def _tick(self, observe: bool, **signals: Any) -> Any:
        record = self.record
        names = {
            "u": record.inputs,
            "y_sim": [f"{name}_simulated" for name in record.columns],
            "y": [f"{name}_measured" for name in record.columns],
        }
        for signal, values in signals.items():
            self.fmu.setReal([self.references[name] for name in names[signal]], values.ravel())
        self.fmu.setBoolean([self.references["observe"]], [observe])
        found = self.fmu.getReal([self.references[name] for name in record.columns])
        self.fmu.doStep(self.time, record.sampling_time)
        self.time += record.sampling_time
        return np.array(found)

    def observe(self, y: Any, **signals: Any) -> Any:
        return self._tick(True, y=y, **signals)

    def step(self, **signals: Any) -> Any:
        return self._tick(False, **signals)


@pytest.mark.parametrize("name", ["linear", "filtered", "filtered high", "ensemble"])
def test_an_fmu_says_what_a_stream_says(name: str, tmp_path: Path) -> None:
    forecaster, record = fitted(name)
    file = tmp_path / "rig.fmu"
    assert forecaster.export(file) == [file]
    assert validate_fmu(str(file)) == []
    instance, stream = Instance(file, tmp_path / "rig", record), forecaster.stream()
    sources = [str(tmp_path / "rig/sources" / each) for each in ("rig_model.c", "fmu.c")]
    subprocess.run(["gcc", *STRICT, "-fsyntax-only", *sources], check=True)
    at = rows(record, stream)
    worst = 0.0
    for n in range(150, 250):
        if n < 175 or 200 <= n < 225:
            stream.observe(record.y[n], **at(n))
            np.testing.assert_array_equal(instance.observe(record.y[n], **at(n)), record.y[n])
        else:
            worst = max(worst, np.abs(instance.step(**at(n)) - stream.step(**at(n))).max())
    assert worst < 1e-9 * np.std(record.y)


def test_an_fmu_observes_the_channels_that_are_measured(tmp_path: Path) -> None:
    """It shows them as observed, and the others as predicted."""
    forecaster, record = fitted("linear")
    forecaster.export(tmp_path / "rig.fmu")
    instance, stream = Instance(tmp_path / "rig.fmu", tmp_path / "rig", record), forecaster.stream()
    for n in range(150, 190):
        y, u = record.y[n] + 3.0, record.u[n]
        y[0] = np.nan
        shown = np.where(np.isnan(y), stream.copy().step(u), y)
        np.testing.assert_allclose(instance.observe(y, u=u), shown, rtol=1e-9)
        stream.observe(y, u)
    np.testing.assert_allclose(instance.step(u=u), stream.step(u), rtol=1e-9)


def test_an_fmu_says_its_units(tmp_path: Path) -> None:
    record = driven().detrend()
    sb.Linear().fit(record[:150]).export(tmp_path / "rig.fmu")
    variables = fmpy.read_model_description(str(tmp_path / "rig.fmu")).modelVariables
    said, level = {v.name: v for v in variables}, record.reading.levels
    assert said["force"].description == f"force (minus {level['force']:.6g}): known input"
    assert said["y0"].description.startswith(f"y0 (minus {level['y0']:.6g}): predicted")
    assert float(said["y0_measured"].start) == pytest.approx(record.y[149, 0])


def test_an_importer_that_reads_outputs_before_it_sets_inputs(tmp_path: Path) -> None:
    """As FMPy's own loop: an output then takes the last input as held, the state never does."""
    forecaster, record = fitted("linear")
    forecaster.export(tmp_path / "rig.fmu")
    columns = {"time": 0.1 * np.arange(60)} | dict(
        zip(record.inputs, record.u[150:210].T, strict=True)
    )
    table = np.array([*zip(*columns.values(), strict=True)], dtype=[(n, float) for n in columns])
    others = [f"{name}_measured" for name in record.columns]
    given = {"input": table, "output": [*record.columns]}
    given["start_values"] = dict.fromkeys(others, 0.0)
    unit = str(tmp_path / "rig.fmu")
    found = fmpy.simulate_fmu(unit, stop_time=5.9, output_interval=0.1, **given)
    stream, wanted = forecaster.stream(), []
    for n in range(150, 210):
        wanted.append(stream.copy().step(record.u[max(n - 1, 150)]))
        stream.step(record.u[n])
    said = np.column_stack([found[name] for name in record.columns])
    assert np.abs(said - np.stack(wanted)).max() < 1e-9 * np.std(record.y)


def test_an_fmu_is_a_simulator_again_with_the_names_and_units_of_the_record(
    tmp_path: Path,
) -> None:
    record = sb.Record(free().y, 0.1, columns=("way [mm]",))
    forecaster = sb.Periodic().fit(record[:150])
    forecaster.export(tmp_path / "rig.fmu")
    with sb.Fmu(tmp_path / "rig.fmu") as simulator:
        said = np.asarray(simulator.simulate(np.arange(60) / 10.0))
    assert said == pytest.approx(forecaster.predict(60).y, abs=1e-9)
    variables = fmpy.read_model_description(str(tmp_path / "rig.fmu")).modelVariables
    ports = [("way_mm", "mm"), ("way_mm_measured", "mm")]
    assert [(v.name, v.unit) for v in variables[:2]] == ports


def test_a_compiler_is_needed_and_may_have_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mean = sb.Mean().fit(free())
    for compiler, said in (
        ("no-such-compiler", "an FMU needs a C compiler: none of no-such-compiler"),
        ("gcc --no-such-option", r"could not be compiled by .*gcc: "),
    ):
        monkeypatch.setenv("CC", compiler)
        with pytest.raises(ValueError, match=said):
            mean.export(tmp_path / "rig.fmu")
    assert not [*tmp_path.iterdir()]
    monkeypatch.setenv("CC", "gcc -m64 -DNOTHING")
    mean.export(tmp_path / "rig.fmu")


@pytest.mark.parametrize("name", ["fmi2Functions", "math"])
def test_any_name_of_a_file_will_do(name: str, tmp_path: Path) -> None:
    """Also those of the FMU's own files and of headers."""
    sb.Mean().fit(free()).export(tmp_path / f"{name}.fmu")
    with sb.Fmu(tmp_path / f"{name}.fmu") as fmu:
        assert np.isfinite(np.asarray(fmu.simulate(np.arange(5.0)))).all()


def test_an_exported_hybrid_needs_its_simulator_as_an_input(tmp_path: Path) -> None:
    """Which no record has; one that needs none is driven by the inputs, as below."""
    forecaster, record = fitted("filtered")
    forecaster.export(tmp_path / "rig.fmu")
    again = sb.Simulation(sb.Fmu(tmp_path / "rig.fmu"))
    with pytest.raises(ValueError, match=r"inputs .--simulator-inputs. must name .*_simulated"):
        again.fit(record).on(record)


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("level (cm)", "level_cm"),
        ("H\u00f6he", "Hohe"),
        ("\u0394p [bar]", "p_bar"),
        ("1st", "x_1st"),
        ("end", "x_end"),
        ("\u6e29\u5ea6", "x"),
        ("a__b_", "a__b_"),
    ],
)
def test_a_port_has_a_name_that_simulink_takes(label: str, name: str) -> None:
    assert port_name(label) == name


@given(st.lists(st.text(max_size=80), min_size=1, max_size=6))
@example(["level (cm)", "level_cm", "level [cm]", "observe", "begin empty", "a" * 80, "a" * 79])
def test_ports_have_names_of_their_own(labels: list[str]) -> None:
    names = PortNames()
    found = [names.new(each, ending) for ending in ("", "_measured") for each in labels]
    assert len({*found}) == len(found)
    assert all(re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,62}", each) for each in found)
    assert not {*found} & {"observe", "begin_empty", "end", "for"}


def test_an_exported_fmu_is_matched_by_the_columns_that_it_was_trained_on(tmp_path: Path) -> None:
    """Their names are labels of its ports, whatever the order of the columns."""
    record = replace(
        driven(),
        columns=("level (cm)", "level_cm"),
        inputs=("valve (%)", "\u0394p [bar]"),
        y_sim=None,
    )
    model = sb.Linear().fit(record[:150])
    model.export(tmp_path / "rig.fmu")
    assert validate_fmu(str(tmp_path / "rig.fmu")) == []
    variables = fmpy.read_model_description(str(tmp_path / "rig.fmu")).modelVariables
    said = {v.name: v.description for v in variables}
    assert [*said][:4] == ["level_cm", "level_cm_2", "valve_percent", "p_bar"]
    assert said["level_cm_2_measured"] == "level_cm: what is observed"
    ahead = record[150:210]
    columns, inputs, u = ahead.columns[::-1], ahead.inputs[::-1], ahead.u[:, ::-1]
    other = sb.Record(ahead.y[:, ::-1], 0.1, u=u, columns=columns, inputs=inputs)
    simulation = sb.Simulation(sb.Fmu(tmp_path / "rig.fmu"))
    found = simulation.fit(other).on(other).y_sim
    wanted = model.predict(60, record[:150], ahead.u).y
    np.testing.assert_allclose(found[:, ::-1], wanted, atol=1e-9 * float(np.std(record.y)))


def test_a_column_may_have_characters_that_xml_lacks(tmp_path: Path) -> None:
    record = sb.Record(free().y, 0.1, columns=("le\x01vel\x0b [m\x02]",))
    sb.Mean().fit(record).export(tmp_path / "rig.fmu")
    assert validate_fmu(str(tmp_path / "rig.fmu")) == []


def test_too_few_observed_samples_are_said_in_the_log(tmp_path: Path) -> None:
    """The outputs are NaN until then."""
    forecaster, record = fitted("gru")
    forecaster.export(tmp_path / "rig.fmu")
    said: list[str] = []
    found = fmpy.simulate_fmu(
        str(tmp_path / "rig.fmu"),
        start_values={"begin_empty": True},
        stop_time=3 * record.sampling_time,
        output_interval=record.sampling_time,
        logger=lambda env, name, status, category, message: said.append(message.decode()),
    )
    assert np.isnan(found["y"] if "y" in found.dtype.names else found[found.dtype.names[1]]).all()
    needed = f"{forecaster.warmup} in a row are needed"
    assert [needed in message for message in said] == [True]


def test_the_loop_of_the_guide_gives_the_numbers_of_predict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Inputs, outputs, step; FMPy's own loop reads too soon where the input steps."""
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[2] / "docs/howto/embed.md").read_text(encoding="utf-8")
    code = next(block["code"] for block in blocks(page) if "doStep" in block["code"])
    known: dict[str, Any] = {}
    exec(code, known)
    found, wanted, force = np.array(known["found"][40:]), known["p"].y[:, 0], known["run"].u[40:]
    deviation = float(np.std(wanted))
    np.testing.assert_allclose(found, wanted, atol=1e-9 * deviation)
    signals: Any = 0.05 * np.arange(460), force[:, 0]
    table = np.rec.fromarrays(signals, names="time,force")  # type: ignore[call-overload]
    model = known["model"]
    model.export("again.fmu", history=known["run"][:40], other_record=True)
    own = fmpy.simulate_fmu("again.fmu", input=table, stop_time=22.95, output_interval=0.05)
    apart, steps = np.abs(own["position"] - wanted), np.diff(force[:, 0], prepend=force[0, 0]) != 0
    assert apart[~steps].max() < 1e-9 * deviation < 1e-3 * deviation < apart[steps].max()

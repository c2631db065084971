"""The simulator of a saved model is described, and opened only where its user gives it again."""

from __future__ import annotations

import json
import shutil
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import splitband as sb
from splitband.cli import main
from tests.support import edit

DT, TRAIN, STEPS = 0.1, 60, 10
RECORD = sb.Record(np.sin(DT * np.arange(TRAIN)), DT)
SHORT = sb.TrainingSettings.paper(window=30, warmup=5, epochs=1)


def sine(time: Any) -> Any:
    return np.sin(time)


def made(simulator: sb.Simulator) -> dict[str, sb.Forecaster]:
    """What holds a simulator of its own."""
    hybrid = sb.Residual(simulator, sb.GRU(2), settings=SHORT)
    return {"simulation": sb.Simulation(simulator), "ensemble": sb.Ensemble(hybrid, 2)}


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Every FMU that is opened from now on."""
    found: list[Any] = []
    begin = sb.Fmu.__init__

    def noted(self: sb.Fmu, path: Any, *arguments: Any) -> None:
        found.append(path)
        begin(self, path, *arguments)

    monkeypatch.setattr(sb.Fmu, "__init__", noted)
    return found


@pytest.mark.parametrize("kind", ["simulation", "ensemble"])
def test_an_fmu_is_opened_only_where_it_is_given(
    kind: str, van_der_pol_fmu: Path, tmp_path: Path, opened: list[Any]
) -> None:
    shutil.copy(van_der_pol_fmu, tmp_path / "rig.fmu")
    with sb.Fmu(tmp_path / "rig.fmu", ["x"]) as fmu:
        model = made(fmu)[kind].fit(RECORD, seed=0)
        expected = model.predict(STEPS, level=0.9)
        model.save(tmp_path / "model")
        opened.clear()
        loaded = sb.load(tmp_path / "model")
        remedy = r'simulator rig\.fmu; pass it: sb\.load\(folder, simulator=sb\.Fmu\("rig\.fmu"\)\)'
        with pytest.raises(ValueError, match=remedy):
            loaded.predict(STEPS)
        assert not opened
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            given = sb.load(tmp_path / "model", simulator=fmu)
        found = given.predict(STEPS, level=0.9)
        np.testing.assert_array_equal(found.y, expected.y)
        np.testing.assert_array_equal(found.upper, expected.upper)
    texts = [path.read_text() for path in (tmp_path / "model").rglob("*.json")]
    assert "rig.fmu" in "".join(texts)
    assert not [text for text in texts if str(tmp_path) in text]


def test_saving_what_was_loaded_keeps_what_is_known_of_the_simulator(tmp_path: Path) -> None:
    model = sb.Simulation(sb.Function(sine)).fit(RECORD)
    model.save(tmp_path / "one")
    sb.load(tmp_path / "one").save(tmp_path / "two")
    one, two = ((tmp_path / name / "forecaster.json").read_text() for name in ("one", "two"))
    assert one == two
    with pytest.raises(ValueError, match=r"simulator=sb\.Function\(\.\.\.\)"):
        sb.load(tmp_path / "two").predict(STEPS)
    found = sb.load(tmp_path / "two", simulator=sb.Function(sine)).predict(STEPS)
    np.testing.assert_array_equal(found.y, model.predict(STEPS).y)


@pytest.mark.parametrize("how", [{"parameters": {"mu": 3.0}}, {"outputs": ["v"]}, {}])
def test_another_fmu_than_the_one_of_the_model_is_said_to_be(
    how: dict[str, Any], van_der_pol_fmu: Path, tmp_path: Path
) -> None:
    """With another value of a parameter, another variable, or another content."""
    file = tmp_path / "rig.fmu"
    shutil.copy(van_der_pol_fmu, file)
    with sb.Fmu(file, ["x"]) as fmu:
        sb.Simulation(fmu).fit(RECORD).save(tmp_path / "model")
    if not how:
        with zipfile.ZipFile(file, "a") as archive:
            archive.writestr("documentation/notes.txt", "changed")
    with (
        sb.Fmu(file, **{"outputs": ["x"], **how}) as fmu,
        pytest.warns(UserWarning, match=r"another one than rig\.fmu, .* fingerprint is"),
    ):
        sb.load(tmp_path / "model", simulator=fmu)


@pytest.mark.parametrize(("saved", "given"), [(3.0, None), (None, 3.0), ("record", 0)])
def test_a_simulator_with_another_start_is_refused(saved: Any, given: Any, tmp_path: Path) -> None:
    """The function is the same, and has no key."""
    model = sb.Simulation(sb.Function(sine, start=saved)).fit(RECORD)
    model.save(tmp_path)
    with pytest.raises(
        ValueError, match=r"must have start=.* model was saved, got start="
    ) as found:
        sb.load(tmp_path, simulator=sb.Function(sine, start=given))
    assert all(f"start={json.dumps(each or 0.0)}" in str(found.value) for each in (saved, given))
    again = sb.load(tmp_path, simulator=sb.Function(sine, start=saved)).predict(STEPS)
    np.testing.assert_array_equal(again.y, model.predict(STEPS).y)


def test_a_model_by_name_knows_how_the_simulator_of_its_record_was_run(tmp_path: Path) -> None:
    """The record contains its output; the command line runs it again as it was run."""
    (tmp_path / "f.py").write_text(
        "import numpy as np\n\ndef sine(time):\n    return np.sin(time)\n"
    )
    function, record = f"{tmp_path}/f.py:sine", tmp_path / "record.csv"
    RECORD.to_frame().to_csv(record, index=False)
    line = f"fit {record} --method simulator --out {tmp_path}/model --simulator {function}"
    assert main(f"{line} --simulator-start 3".split()) == 0
    line = f"simulate {tmp_path}/model --steps 5 --out {tmp_path}/out.csv --simulator {function}"
    assert main(line.split()) == 0
    found = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)[:, 1]
    np.testing.assert_allclose(found, np.sin(3 + DT * (TRAIN + np.arange(5))))
    assert main(f"{line} --simulator-start 5".split()) == 2
    with pytest.raises(ValueError, match=r"must have start=3.0 .* got start=0.0"):
        sb.load(tmp_path / "model", simulator=sb.Function(sine))


def test_a_simulator_that_nobody_asks_for_is_refused(tmp_path: Path) -> None:
    sb.Mean().fit(RECORD).save(tmp_path)
    with pytest.raises(ValueError, match="simulator must be left out for mean"):
        sb.load(tmp_path, simulator=sb.Function(sine))


@pytest.fixture
def forged(van_der_pol_fmu: Path, tmp_path: Path) -> Path:
    """A simulation whose description names an FMU of somebody else's."""
    folder = tmp_path / "model"
    sb.Simulation(sb.Function(sine)).fit(RECORD).save(folder)
    shutil.copy(van_der_pol_fmu, folder / "evil.fmu")
    fmu = {"kind": "Absent", "options": {"kind": "Fmu", "file": "evil.fmu", "fingerprint": None}}
    facts = {"method": "simulator", "columns": ["y[0]"], "inputs": [], "sampling_time": DT}
    facts |= {"setup": {"settings": {"warmup": 5}}, "calibration": None, "range": [[-1.0], [1.0]]}
    edit(
        folder,
        lambda d: (d.update(facts), d["forecaster"]["options"].update(simulator=fmu)),
    )
    return folder


def test_no_file_says_what_is_opened(
    forged: Path, opened: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Neither by `load` nor by the command line."""
    history, out = tmp_path / "history.csv", tmp_path / "out.csv"
    rows = [f"{DT * n:.1f},{y}" for n, y in enumerate(RECORD.y[:, 0])]
    history.write_text("\n".join(["time,y[0]", *rows]))
    with pytest.raises(ValueError, match=r"with the simulator evil\.fmu"):
        sb.load(forged).predict(STEPS)
    line = ["simulate", str(forged), "--history", str(history), "--steps", "5", "--out", str(out)]
    assert main(line) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: --simulator must be given: this model was saved with the simu")
    assert not opened
    assert main([*line, "--simulator", str(forged / "evil.fmu"), "--simulator-columns", "x"]) == 0
    assert len(out.read_text().splitlines()) == 6


@pytest.mark.parametrize(
    "change",
    [{"file": "../rig.fmu"}, {"kind": "os.system('x')"}, {"file": 3}],
    ids=str,
)
def test_a_description_of_a_simulator_is_checked(change: dict[str, Any], tmp_path: Path) -> None:
    sb.Simulation(sb.Function(sine)).fit(RECORD).save(tmp_path)
    edit(
        tmp_path,
        lambda d: d["forecaster"]["options"]["simulator"]["options"].update(change),
    )
    with pytest.raises(ValueError, match="a simulator must"):
        sb.load(tmp_path)

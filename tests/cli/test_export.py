"""`splitband export`: a saved model as a program."""

from pathlib import Path

import pytest

from tests.cli.support import assert_fails, call

pytestmark = pytest.mark.usefixtures("inside")


def test_export_says_what_it_writes(
    driven_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"export {driven_model} {tmp_path}/new/rig.c --precision float")
    assert sorted(file.name for file in (tmp_path / "new").iterdir()) == ["rig.c", "rig.h"]
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("gru is written to ")
    header = (tmp_path / "new" / "rig.h").read_text()
    assert "u[1]: force" in header
    assert "int rig_step(rig_state *s, const float *u, float *y);" in header


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("export gru 1.c", ("path must be named as functions of C are, such as model_1.c",)),
        ("export gru rig.fmu --precision float", ("--precision must be double for an FMU",)),
        ("export filtered rig.c", ("its time is calibrated", "gain and offset alone")),
        ("export gru record.csv/rig.c", ("OUT must be a folder that can be written",)),
    ],
)
@pytest.mark.usefixtures("model", "hybrid_model")
def test_what_cannot_be_exported(
    line: str, says: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert_fails(line, says, capsys)

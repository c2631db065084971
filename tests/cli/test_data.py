"""`splitband data`: the public records."""

from pathlib import Path

import pytest

from tests.cli.support import call

pytestmark = pytest.mark.usefixtures("inside")


@pytest.mark.usefixtures("public_data")
def test_data_finds_and_lists_the_public_records(
    public_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("data list")
    listed = capsys.readouterr().out
    for name in ("drill_string_data", "double_torsion_phi2", "van-der-pol", "CC BY 4.0"):
        assert name in listed
    call("data fetch drill_string_sim")
    path = public_data / "drill_string" / "drill_string_sim.txt"
    assert capsys.readouterr().out == f"drill_string_sim: {path}\n"
    call("data fetch")
    assert len(capsys.readouterr().out.splitlines()) == 4

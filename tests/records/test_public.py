"""The public records, how they are fetched, and a generated one against what is known of it."""

import hashlib
import http.server
import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pooch
import pytest

from splitband.records import (
    PUBLIC,
    PublicFile,
    double_torsion,
    drill_string,
    fetch,
    public,
    read,
)
from splitband.records import named as crane

CONTENT = b"1\n2\n3\n"

TINY = PublicFile(
    "tiny", "sub/tiny.txt", hashlib.sha256(CONTENT).hexdigest(), len(CONTENT), "", "", ""
)


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PUBLIC, "tiny", TINY)
    monkeypatch.delenv("SPLITBAND_DATA_DIR", raising=False)


def test_public_files_are_the_published_ones(public_data: Path) -> None:
    for name, record in PUBLIC.items():
        assert fetch(name) == public_data / record.path
        assert fetch(name).stat().st_size == record.size
        assert (record.name, bool(record.licence), bool(record.citation)) == (name, True, True)
    assert {name: len(read(fetch(name), sampling_time=0.01)) for name in PUBLIC} == {
        "drill_string_data": 23814,
        "drill_string_sim": 6001,
        "double_torsion_phi2": 9998,
        "double_torsion_num_phi2": 400,
    }


@pytest.mark.usefixtures("public_data")
def test_drill_string_simulator_error_is_that_of_the_paper() -> None:
    trajectory = drill_string()
    assert len(trajectory) == 4001
    assert trajectory.sampling_rate == 100.0
    assert trajectory.y.mean() == pytest.approx(0, abs=1e-12)
    assert trajectory.y.std() == pytest.approx(1)
    error = np.sqrt(np.mean((trajectory.y_sim - trajectory.y) ** 2))
    assert error == pytest.approx(0.7292, abs=5e-5)


@pytest.mark.usefixtures("public_data")
def test_double_torsion_repeats_every_160_samples() -> None:
    trajectory = double_torsion()
    y = trajectory.y[:, 0]
    assert (trajectory.name, trajectory.columns) == ("double-torsion", ("phi2",))
    assert y.std() == pytest.approx(1)
    tiled = np.resize(y[440:600], 1400)
    assert np.sqrt(np.mean((tiled - y[600:]) ** 2)) == pytest.approx(0.068, abs=5e-4)


@pytest.mark.usefixtures("public_data")
@pytest.mark.parametrize("samples", [1, 9999])
def test_double_torsion_has_only_so_many_samples(samples: int) -> None:
    with pytest.raises(ValueError, match=f"samples must be from 2 to 9998: got {samples}"):
        double_torsion(samples)


def test_unknown_public_name() -> None:
    with pytest.raises(ValueError, match="'pendulum' is unknown: there are drill_string_data, "):
        fetch("pendulum")


@pytest.mark.usefixtures("tiny")
def test_a_changed_file_is_refused_and_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / TINY.path
    path.parent.mkdir()
    path.write_bytes(b"other")
    monkeypatch.setenv("SPLITBAND_DATA_DIR", str(tmp_path))
    with pytest.raises(ValueError, match="sha256") as caught:
        fetch("tiny")
    found = hashlib.sha256(b"other").hexdigest()
    assert all(word in str(caught.value) for word in (str(path), TINY.sha256, found))
    assert path.read_bytes() == b"other"
    path.write_bytes(CONTENT)
    assert fetch("tiny") == path


@pytest.mark.usefixtures("tiny")
def test_a_file_missing_from_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLITBAND_DATA_DIR", str(tmp_path))
    with pytest.raises(FileNotFoundError) as caught:
        fetch("tiny")
    assert str(tmp_path / TINY.path) in str(caught.value)
    assert f"SPLITBAND_DATA_DIR={tmp_path}" in str(caught.value)


class Server(http.server.ThreadingHTTPServer):
    """A loopback stand-in for the repository; it keeps the paths that it was asked for."""

    content = CONTENT

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.requested: list[str] = []


class Handler(http.server.BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        self.server.requested.append(self.path)
        self.send_response(200)
        self.send_header("Content-Length", str(len(self.server.content)))
        self.end_headers()
        self.wfile.write(self.server.content)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, tiny: None) -> Iterator[Server]:
    server = Server()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    monkeypatch.setattr(public, "_SOURCE", f"http://127.0.0.1:{server.server_port}/data")
    monkeypatch.setattr(pooch, "os_cache", lambda name: tmp_path / "cache" / name)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def files_below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_download_once_in_silence(
    server: Server, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    records: list[logging.LogRecord] = []

    def keep(record: logging.LogRecord) -> bool:
        records.append(record)
        return False

    logger = pooch.get_logger()
    level = logger.level
    logger.addFilter(keep)
    path = fetch("tiny")
    assert path == tmp_path / "cache" / "splitband" / TINY.path
    assert path.read_bytes() == CONTENT
    assert fetch("tiny") == path
    assert server.requested == ["/data/sub/tiny.txt"], "the second time it is in the cache"
    logger.removeFilter(keep)
    assert records == []
    assert logger.level == level, "other users of pooch keep their messages"
    assert capfd.readouterr() == ("", "")
    np.testing.assert_array_equal(read(path, sampling_time=1).y, [[1], [2], [3]])


@pytest.mark.usefixtures("tiny")
def test_a_download_of_other_content_leaves_nothing(server: Server, tmp_path: Path) -> None:
    server.content = b"1\n2\n"
    with pytest.raises(ValueError, match=r"^[^\n]*not the published file[^\n]*$") as caught:
        fetch("tiny")
    assert "SPLITBAND_DATA_DIR" in str(caught.value)
    assert files_below(tmp_path) == []


def test_no_connection(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(public, "_SOURCE", "http://127.0.0.1:1/data")
    with pytest.raises(OSError, match=r"^[^\n]*could not be downloaded[^\n]*$") as caught:
        fetch("tiny")
    assert type(caught.value) is OSError
    assert "set SPLITBAND_DATA_DIR" in str(caught.value)
    assert "check the connection" in str(caught.value)
    assert files_below(tmp_path) == []
    assert server.requested == []


def test_a_small_swing_has_the_period_of_a_pendulum(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crane, "DAMPING", 0.0)
    monkeypatch.setattr(crane, "DRAG", 0.0)
    speed, length = np.zeros(1500), 4.0
    speed[5:10] = 0.05
    load = crane._swinging(speed, np.full(1500, length))[50:]
    load = load - load.mean()
    power = np.abs(np.fft.rfft(load * np.hanning(len(load)), 2**18))
    frequency = np.fft.rfftfreq(2**18, crane.STEP)[np.argmax(power)]
    assert frequency == pytest.approx(np.sqrt(crane.GRAVITY / length) / (2 * np.pi), rel=1e-3)


def test_the_record_goes_by_its_seed_and_its_simulator_is_right_but_for_the_swing() -> None:
    record, again, other = (crane.overhead_crane(2000, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(record.y, again.y)
    assert np.abs(record.u - other.u).max() > 1
    assert np.std(record.y - record.y_true) == pytest.approx(0.02, rel=0.2)
    errors = record.y_true - record.y_sim
    assert np.abs(errors.mean()) < 0.1
    assert 0.5 < errors.std() < 0.25 * record.y_true.std()

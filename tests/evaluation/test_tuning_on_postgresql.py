"""Processes that share a study through a PostgreSQL server, one of the tests' own."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.evaluation.test_tuning import forks, in_a_process, tuned, untrained

__all__ = ["untrained"]
FOUND = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
"""Of Debian's package."""


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """The address of a server that listens at a socket; it runs as a user without rights."""
    if not FOUND:
        pytest.skip("PostgreSQL is not installed (Debian: apt-get install postgresql)")
    programs, folder = FOUND[-1].parent, Path(tempfile.mkdtemp(prefix="sb-pg-"))
    user = None
    if os.getuid() == 0:  # the server refuses to run as root
        user = pwd.getpwnam("nobody").pw_uid
        os.chown(folder, user, -1)
    data = folder / "data"
    options = f"-k {folder} -c listen_addresses= -c fsync=off -c max_connections=20"
    control = [f"{programs}/pg_ctl", "-D", f"{data}", "-w", "-s"]
    try:
        for command in (
            [f"{programs}/initdb", "-D", f"{data}", "-A", "trust", "-U", "tuner", "-N"],
            [*control, "-o", options, "-l", f"{folder}/log", "start"],
        ):
            subprocess.run(command, user=user, cwd=folder, check=True, timeout=120,
                           stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL)  # fmt: skip
        yield f"postgresql://tuner@/postgres?host={folder}"
    finally:
        subprocess.run([*control, "-m", "immediate", "stop"], user=user, cwd=folder, check=False)
        shutil.rmtree(folder)


@forks
@pytest.mark.usefixtures("untrained")
def test_two_processes_share_a_study(server: str) -> None:
    children = [in_a_process(lambda: tuned(8, server)) for _ in range(2)]
    assert [os.waitpid(child, 0)[1] for child in children] == [0, 0]
    found = tuned(8, server)
    assert len(found.attempts) == 8
    assert found.attempts[0].usual
    assert len(tuned(10, server).attempts) == 10

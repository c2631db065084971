"""Executes the blocks of one page: JSON of them on standard input, of their output on the other."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from typing import Any


def main() -> None:
    """Run each block in its turn; the first that fails ends the process."""
    # On one core the commands start no further processes, each of which would import torch again.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    variables: dict[str, Any] = {"__name__": "__main__"}
    outputs = []
    for number, block in enumerate(json.load(sys.stdin), start=1):
        if block["kind"] == "console":
            done = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", block["code"]],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode:
                sys.exit(f"{block['code']}\n{done.stdout}{done.stderr}")
            outputs.append(done.stdout)
        else:
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(compile(block["code"], f"<block {number}>", "exec"), variables)
            outputs.append(printed.getvalue())
    json.dump([output.strip("\n") for output in outputs], sys.stdout)


if __name__ == "__main__":
    main()

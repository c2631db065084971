"""Executes the blocks of one page: JSON of them on standard input, of their output on the other."""

from __future__ import annotations

import ast
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
            outputs.append({"output": done.stdout.strip("\n"), "html": ""})
        else:
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                value = _executed(block["code"], f"<block {number}>", variables)
            html = value._repr_html_() if hasattr(value, "_repr_html_") else ""
            outputs.append({"output": printed.getvalue().strip("\n"), "html": html})
    json.dump(outputs, sys.stdout)


def _executed(code: str, name: str, variables: dict[str, Any]) -> Any:
    """Run a block; return the value of its last line if that is an expression, as notebooks do."""
    tree = ast.parse(code, name)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, name, "exec"), variables)
    if not isinstance(last, ast.Expr):
        return None
    return eval(compile(ast.Expression(last.value), name, "eval"), variables)


if __name__ == "__main__":
    main()

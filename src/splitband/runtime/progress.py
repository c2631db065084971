"""Show how far a computation is, on a line that changes in place."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def in_place() -> bool:
    """Return whether what was printed can be changed: in a terminal, but not in a notebook.

    A notebook gives its commands (`!splitband`) a pseudo-terminal that only adds lines.
    """
    notebook = "JPY_PARENT_PID" in os.environ
    return sys.stdout.isatty() and os.environ.get("TERM") != "dumb" and not notebook


@contextmanager
def progress_line(said: str) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows a text in place of the one before, at first what is `said`.

    It shows nothing but in a terminal and in the cell of a notebook. In the end the line is gone.
    """
    shown = in_place() or "ipykernel" in sys.modules
    width = shutil.get_terminal_size().columns - 1

    def show(text: str, end: str = "") -> None:
        if shown:
            sys.stdout.write(f"\r{text[:width]:<{width}}{end}")
            sys.stdout.flush()

    show(said)
    try:
        yield show
    finally:
        show("", "\r")

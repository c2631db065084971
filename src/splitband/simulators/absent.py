"""Describe the simulator of a saved model until the user passes it again."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, NoReturn

import splitband
from splitband.runtime.errors import InputError
from splitband.runtime.options import saved
from splitband.simulators.base import Start, check_start

_SHOWN = 300
"""Most characters of a text from a file in messages. By eye."""


@saved
@dataclass(frozen=True)
class Absent:
    """Describe a simulator in words, without opening or running anything.

    Attributes
    ----------
    kind : Name of its class.
    file : Name of its file, without the folder; empty without a file.
    fingerprint : Result of the simulator's `fingerprint()` (or `digest()` if fitted), by which a
        different simulator is detected; None without one.
    fitted : Whether its parameters were fitted; other parameter values are then no difference.
    start : Its time at a record's first sample, 0 if it says none; None for recorded output, which
        has time stamps of its own.
    """

    kind: str
    file: str = ""
    fingerprint: str | None = None
    fitted: bool = False
    start: Start | None = None

    def __post_init__(self) -> None:
        """Check values that may come from a file."""
        texts = self.kind, self.file, self.fingerprint or ""
        if not all(isinstance(text, str) for text in texts):
            raise InputError("a simulator must be described by texts")
        if not self.kind.isidentifier() or PurePath(self.file).name != self.file:
            raise InputError(
                f"a simulator must have a class and the name of a file, got "
                f"{self.kind[:60]!r} and {self.file[:60]!r}"
            )
        vars(self)["start"] = check_start(self.start)

    @classmethod
    def of(cls, simulator: Any, fitted: bool = False) -> Absent:
        """Return the description of a simulator; a description is returned unchanged."""
        if isinstance(simulator, cls):
            return simulator
        file = PurePath(str(getattr(simulator, "path", ""))).name
        fingerprint = getattr(simulator, "fingerprint", lambda: None)()
        if fingerprint is not None and fitted and hasattr(simulator, "digest"):
            fingerprint = simulator.digest()
        said = None if fingerprint is None else str(fingerprint)
        begins = getattr(simulator, "start", None) or 0.0
        start = None if getattr(simulator, "own_times", False) else begins
        return cls(type(simulator).__name__, file, said, fitted, start)

    def simulate(self, time: object) -> NoReturn:
        """Raise ValueError; the message says which simulator to pass, and how."""
        ours = "sb." if self.kind in dir(splitband) else ""
        how = f"{ours}{self.kind}({json.dumps(str(self)) if self.file else '...'})"
        raise InputError(
            f"simulator must be given: this model was saved with the simulator {self}; pass it: "
            f"sb.load(folder, simulator={how})"
        )

    def check_start_of(self, given: Any) -> None:
        """Raise ValueError if `given` begins at another time than the described simulator."""
        other = Absent.of(given).start
        if self.start is not None and other is not None and self.start != other:
            raise InputError(
                f"simulator must have start={json.dumps(self.start)} (--simulator-start), with "
                f"which the model was saved, got start={json.dumps(other)}; fit the model again "
                "for another start"
            )

    def difference(self, given: Any) -> str:
        """Return a sentence if `given` is not the described simulator, else an empty string.

        Simulators without a fingerprint are not compared.
        """
        saved, other = self.fingerprint, Absent.of(given, self.fitted).fingerprint
        if saved is None or other is None or saved == other:
            return ""
        return (
            f"the simulator is another one than {self}, with which the model was saved: its "
            f"fingerprint is {_shown(other)}, not {_shown(saved)}"
        )

    def __str__(self) -> str:
        """Return the name of the simulator's file, or of its class."""
        return _shown(self.file) if self.file else f"of the kind {self.kind}"


def _shown(text: str) -> str:
    return " ".join(text.split())[:_SHOWN]

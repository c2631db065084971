"""Write checkpoints, from which an interrupted training resumes with exactly the same numbers.

A checkpoint is one safetensors file, which is always replaced as a whole and holds no code. A file
that is damaged, or was written by another training, is ignored.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from splitband.runtime.caching import key_of
from splitband.runtime.files import replacing

if TYPE_CHECKING:
    from torch import Tensor

MOST_OVERHEAD = 0.05
"""Share of the time that may go into checkpoints."""

State: TypeAlias = "dict[str, Tensor]"


def below(state: State, prefix: str) -> State:
    """Return the entries of a state whose names begin with a prefix, which is removed."""
    return {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}


class Checkpoint:
    """Store the state of one training in a file.

    `path`: of the file, in a folder that exists.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._next = 0.0

    def numbered(self, i: int) -> Checkpoint:
        """Return the checkpoint with this number, in the same folder."""
        return Checkpoint(self.path.with_name(f"{self.path.stem}-{i}{self.path.suffix}"))

    def load(self, key: str) -> State | None:
        """Return the state of the training with this `key`, if the file holds it."""
        import safetensors.torch  # noqa: PLC0415  there is a state to read where there is torch

        try:
            # Not mapped into memory: on Windows a mapped file cannot be replaced.
            content = self.path.read_bytes()
            state = safetensors.torch.load(content)
            header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
        except (OSError, ValueError, safetensors.SafetensorError):
            return None
        said = header.get("__metadata__") or {}
        whole = said.get("key") == key and said.get("sum") == _sum(state)
        return state if whole else None

    def offer(self, key: str, state: Callable[[], Mapping[str, Tensor]], last: bool) -> None:
        """Write the state if it is the last one, or if that keeps within `MOST_OVERHEAD`.

        If it cannot be written, for instance on a full disk, there is a warning, training goes on
        and the old file stays.
        """
        import safetensors.torch  # noqa: PLC0415  there is a state to write where there is torch

        began = time.monotonic()
        if began < self._next and not last:
            return
        tensors = {name: value.detach().cpu().contiguous() for name, value in state().items()}
        try:
            with replacing(self.path) as temporary:
                facts = {"key": key, "sum": _sum(tensors)}
                safetensors.torch.save_file(tensors, temporary, metadata=facts)
        except (OSError, safetensors.SafetensorError) as error:
            warnings.warn(f"no checkpoint could be written to {self.path}: {error}", stacklevel=2)
        took = time.monotonic() - began
        self._next = began + took / MOST_OVERHEAD


def _sum(state: Mapping[str, Tensor]) -> str:
    """Return a hash of the state, which detects damage."""
    return key_of(*(part for name in sorted(state) for part in (name, state[name])))

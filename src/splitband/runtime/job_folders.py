"""Provide folders for the files of jobs, also for jobs on machines that do not share the disk."""

from __future__ import annotations

import glob
import tempfile
import uuid
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from splitband.runtime.files import replacing

Files = dict[str, bytes]
"""The content of files, by name."""


@dataclass(frozen=True)
class JobFolder:
    """Represent a folder of this machine in which jobs keep files.

    A worker that sees the folder uses it. Any other one is sent the files of its job, works in a
    temporary folder, and sends back what has changed with the result.

    Attributes
    ----------
    folder : Path of the existing folder.
    mark : File by which a worker recognises the folder as shared; None if all workers share it.
    """

    folder: Path
    mark: str | None = None

    @classmethod
    @contextmanager
    def opened(cls, folder: Path, anywhere: bool) -> Iterator[JobFolder]:
        """Create the folder if need be; `anywhere` says whether workers may not see it."""
        folder.mkdir(parents=True, exist_ok=True)
        if not anywhere:
            yield cls(folder)
            return
        folder = folder.absolute()
        mark = folder / f".mark-{uuid.uuid4().hex}"
        mark.touch()
        try:
            yield cls(folder, mark.name)
        finally:
            mark.unlink(missing_ok=True)

    def files(self, prefix: str, within: str = "") -> Files:
        """Return the files to send to a worker: those with this name prefix in a folder within."""
        if self.mark is None:
            return {}
        found = (self.folder / within).glob(glob.escape(prefix) + "*")
        return {path.name: path.read_bytes() for path in found}

    @contextmanager
    def at_work(self, files: Mapping[str, bytes], within: str = "") -> Iterator[tuple[Path, Files]]:
        """Yield to a job the folder of its files, and the files to send back at the end."""
        changed: Files = {}
        if self.mark is None or (self.folder / self.mark).exists():
            folder = self.folder / within
            folder.mkdir(parents=True, exist_ok=True)
            yield folder, changed
            return
        with tempfile.TemporaryDirectory(prefix="splitband-") as name:
            folder = Path(name)
            for file, content in files.items():
                (folder / file).write_bytes(content)
            yield folder, changed
            for path in folder.iterdir():
                content = path.read_bytes()
                if files.get(path.name) != content:
                    changed[path.name] = content

    def keep(self, files: Mapping[str, bytes]) -> None:
        """Write what a job has sent back; where that is not possible, warn and go on."""
        for name, content in files.items():
            try:
                with replacing(self.folder / name) as temporary:
                    temporary.write_bytes(content)
            except OSError as error:
                warnings.warn(f"{self.folder / name} could not be written: {error}", stacklevel=2)

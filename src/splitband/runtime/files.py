"""Write files as a whole: readers never see a half-written file."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splitband.runtime.errors import InputError
from splitband.runtime.system import STANDARD, move


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`; rename it to `path` if the block succeeds.

    A pipe, a terminal or another device stays, and gets a copy of the content. Raises OSError,
    naming `path`, for a failure such as a full disk.
    """
    path = Path(path)
    if is_stream(path):
        with tempfile.TemporaryDirectory() as folder:
            copied = Path(folder, path.name)
            yield copied
            number = STANDARD.get(str(path))
            with path.open("wb") if number is None else os.fdopen(os.dup(number), "wb") as stream:
                stream.write(copied.read_bytes())
        return
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(8)}{path.suffix}")
    try:
        # A new file, with the usual permissions; an existing file, or a link, is refused.
        temporary.open("xb").close()
        try:
            yield temporary
            # Flush to the disk before renaming: a power cut then leaves no empty file. Windows
            # flushes only files that are open for writing.
            with temporary.open("r+b") as written:
                os.fsync(written.fileno())
            move(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        unnamed = error.filename is None or str(error.filename) == str(temporary)
        if error.errno is not None and unnamed:
            error.filename = str(path)
        raise


def is_stream(path: Path) -> bool:
    """Return whether a path names a pipe or a device, not to be replaced by a file."""
    return str(path) in STANDARD or (path.exists() and not (path.is_file() or path.is_dir()))


def sha256_of(path: str | Path) -> str:
    """Return the SHA-256 of a file's content."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def write_text(path: str | Path, text: str) -> None:
    """Write a text with the same bytes on all systems: UTF-8, newlines at ends of lines."""
    with replacing(path) as temporary:
        temporary.write_bytes(text.encode())


def write_json(path: str | Path, value: Any) -> None:
    """Write `value` as indented JSON, see `to_json`."""
    write_text(path, to_json(value))


def to_json(value: Any) -> str:
    """Return indented JSON; raises ValueError for NaN and infinity, TypeError for other objects."""
    return json.dumps(value, indent=2, allow_nan=False) + "\n"


def output_folder(path: str | Path, argument: str = "folder") -> Path:
    """Create the folder `path`, and check that it is writable, before long computations."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(
            f"{argument} must be a folder that can be written, got {path}: {reason}"
        ) from None
    return path

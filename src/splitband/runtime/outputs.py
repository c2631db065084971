"""Manage the folder of a result: one command at a time, and a whole result or none."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from filelock import BaseFileLock, FileLock, Timeout

from splitband.runtime.errors import InputError
from splitband.runtime.files import output_folder, write_json
from splitband.runtime.system import in_use, move

FACTS = "results.json"
"""File with the facts of a result and the list of its files; written last, when all exist."""
FORMAT = 2
"""Version of `FACTS`; results of 0.2 have none."""
TEST_PREDICTIONS = "predictions-test-{}.csv"
_TABLES = "predictions.csv", "forecast.csv", "table.csv"
_PICTURES = "rollouts.png", "forecast.png", "spectrum.png"
RESULT_FILES = (FACTS, *_TABLES, *_PICTURES, "report.html", "recommended.json")
"""Files of results. Of an earlier result, only these, predictions of test records and the model's
weights are removed."""
DESCRIPTION, WEIGHTS = "forecaster.json", "weights-{}.safetensors"
"""Files of a saved forecaster."""
MODEL_FOLDER = "model"
"""Folder of a result with the trained model of the recommended method."""
LOCK = ".splitband-lock"
_OPEN = "Open in another program; close it there and give the same command again"
"""Message for an irreplaceable file of an earlier result."""
_NEW, _EARLIER = ".splitband-new", ".splitband-earlier.json"


@contextmanager
def staged(folder: str | Path) -> Iterator[Path]:
    """Yield an empty folder for the files of a result; at the end they replace an earlier result.

    Nothing is replaced before all new files are on the disk. Other files of the earlier result are
    removed. While files are moved, the folder has no results.json.

    Raises OSError, naming the file in `folder`, if a file cannot be written; `folder` is then
    unchanged.
    """
    folder = output_folder(folder)
    new = folder / _NEW
    shutil.rmtree(new, ignore_errors=True)
    try:
        new.mkdir()
        yield new
        _replace(folder, new)
    except OSError as error:
        if error.filename is not None:
            path = Path(str(error.filename))
            within = path.is_relative_to(new)
            error.filename = str(folder / path.relative_to(new) if within else path)
        raise
    finally:
        shutil.rmtree(new, ignore_errors=True)


def write_facts(new: Path, facts: dict[str, Any]) -> None:
    """Write results.json into the folder from `staged`, after all other files."""
    names = sorted(path.name for path in new.iterdir() if path.is_file())
    write_json(new / FACTS, {"format": FORMAT} | facts | {"files": names})


def belongs_to_result(name: str) -> bool:
    """Return whether a file may belong to a result, by its name."""
    pattern = re.escape(TEST_PREDICTIONS).replace(r"\{\}", r"\d+")
    return name in RESULT_FILES or re.fullmatch(pattern, name) is not None


def files_of_result(folder: Path) -> set[str]:
    """Return the files of a folder's result, also after an interrupted replacement."""
    names: set[str] = set()
    for list_name in (FACTS, _EARLIER):
        # A missing or damaged file lists nothing.
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
            listed = json.loads((folder / list_name).read_text(encoding="utf-8"))["files"]
            names |= {name for name in listed if belongs_to_result(name)} | {FACTS}
    return {name for name in names if (folder / name).is_file()}


def unfinished(facts: Mapping[str, Any]) -> str:
    """Return the progress of an unfinished result in words; empty for a finished one."""
    return str(facts.get("unfinished") or ("interrupted" if facts.get("interrupted") else ""))


def finished_comparison(folder: Path) -> str | None:
    """Return the record of a folder's finished comparison; None without one."""
    try:
        facts = json.loads((folder / FACTS).read_text(encoding="utf-8"))
        done = facts["format"] == FORMAT and not unfinished(facts) and facts["recommended"]
        return str(facts["record"]["name"]) if done else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _replace(folder: Path, new: Path) -> None:
    """Move the new files over those of the earlier result, results.json last."""
    files = [path.relative_to(new) for path in new.rglob("*") if path.is_file()]
    names = {file.as_posix() for file in files}
    outdated = files_of_result(folder)
    for file in files:
        (folder / file.parent).mkdir(exist_ok=True)
        if file.name == DESCRIPTION:  # names of weights depend on their content
            weights = (folder / file.parent).glob(WEIGHTS.format("*"))
            outdated |= {path.relative_to(folder).as_posix() for path in weights}
    if (busy := in_use(folder / name for name in sorted(names | outdated))) is not None:
        raise PermissionError(errno.EACCES, _OPEN, str(busy))
    if (folder / FACTS).exists():
        move(folder / FACTS, folder / _EARLIER)  # it still lists what to remove
    # A model's description is moved after the weights, which it names.
    for name in sorted(names - {FACTS}, key=lambda name: (name.endswith(".json"), name)):
        move(new / name, folder / name)
    for name in outdated - names:
        (folder / name).unlink(missing_ok=True)
    if FACTS in names:
        move(new / FACTS, folder / FACTS)
    (folder / _EARLIER).unlink(missing_ok=True)


@contextmanager
def locked(folder: str | Path, argument: str = "folder") -> Iterator[None]:
    """Create a folder and lock it for this command; remove a new folder if still empty.

    The operating system releases the lock at any end of the process. File systems without locks
    give no protection.
    """
    folder = Path(folder)
    # Unlike `Path.exists`, `os.path.exists` raises no error, not even for too long names.
    created = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
    lock = FileLock(folder / LOCK)
    try:
        output_folder(folder, argument)
        _lock(lock, folder, argument)
        if (busy := in_use(folder / name for name in files_of_result(folder))) is not None:
            raise InputError(
                f"{argument} must not hold a result that another program has open, got {busy}: "
                "close it there"
            )
        yield
    finally:
        if lock.is_locked:
            lock.release()
            with contextlib.suppress(OSError):  # the next command may have opened it already
                (folder / LOCK).unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # a folder with results
            for path in created:
                path.rmdir()


def _lock(lock: BaseFileLock, folder: Path, argument: str) -> None:
    """Lock a folder, and write the owner into the lock file, if this call has created it."""
    path, new = folder / LOCK, not os.path.lexists(folder / LOCK)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        owner = ""
        with contextlib.suppress(OSError):
            owner = path.read_text(encoding="utf-8", errors="replace")[:200]
        raise InputError(
            f"{argument}: {folder} is in use by another splitband command"
            f"{f' ({owner})' if owner else ''}; wait for it or choose another folder"
        ) from None
    except (OSError, NotImplementedError):  # a file system without locks
        if path.is_symlink() or path.is_dir():
            raise InputError(
                f"{argument} must not hold a link or a folder named {path.name}, got {path}; "
                "remove it"
            ) from None
    if new and lock.is_locked:
        owner = f"process {os.getpid()}, started {datetime.now():%Y-%m-%d %H:%M}"
        with contextlib.suppress(OSError):  # on a full disk the file names no owner
            path.write_text(owner, encoding="utf-8")

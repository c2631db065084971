"""A table of random numbers, and the files that tests of reading begin with."""

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io

from splitband.records import (
    read,
)
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

STEP = 0.25

RNG = np.random.default_rng(7)

Y = RNG.standard_normal((40, 2))

U = RNG.standard_normal(40)

TIME = STEP * np.arange(40)

NAMES = ["time", "torque", "angle", "force"]

FRAME = pd.DataFrame(np.column_stack([TIME, Y, U]), columns=NAMES)


def text_file(folder: Path, text: str | bytes, name: str = "record.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def stamped(folder: Path, stamps: Sequence[object], name: str = "t") -> Path:
    """A CSV with the given stamps, as they are to be printed, and a channel y."""
    rows = "".join(f"{stamp},{row}\n" for row, stamp in enumerate(stamps))
    return text_file(folder, f"{name},y\n{rows}")


def message(path: Path, **options: Any) -> str:
    """The message of the ValueError that reading raises: one line that begins with the path."""
    with pytest.raises(ValueError, match=r"^[^\n]+$") as caught:
        read(path, **options)
    assert str(caught.value).startswith(f"{path}: ")
    assert isinstance(caught.value, InputError)
    return str(caught.value)


def iso(seconds: Sequence[float]) -> list[str]:
    return [(datetime(2024, 2, 29, 23, 59, 59) + timedelta(seconds=s)).isoformat() for s in seconds]


def write_npz(path: Path) -> None:
    columns: dict[str, Any] = {name: FRAME[name].to_numpy() for name in NAMES}
    np.savez(path, **columns)


def write_mat(path: Path) -> None:  # columns, as MATLAB has them
    scipy.io.savemat(path, {name: FRAME[[name]].to_numpy() for name in NAMES})


def saved(path: Path, **arrays: Any) -> Path:
    """Write arrays in the format of the suffix, compressed where it can be; text and NPY one."""
    array = next(iter(arrays.values()))
    match path.suffix:
        case ".npz":
            np.savez_compressed(path, **arrays)
        case ".mat":
            scipy.io.savemat(path, arrays, do_compression=True)
        case ".npy":
            np.save(path, array)
        case ".parquet":
            pd.DataFrame(array).rename(columns=str).to_parquet(path)
        case _:
            np.savetxt(path, array, delimiter=",")
    return path


WRITERS: dict[str, Callable[[Path], object]] = {
    "record.csv": lambda path: FRAME.to_csv(path, index=False),
    "index.csv": FRAME.to_csv,
    "semicolon.csv": lambda path: FRAME.to_csv(path, index=False, sep=";"),
    "comma.csv": lambda path: FRAME.to_csv(path, index=False, sep=";", decimal=","),
    "utf16.csv": lambda path: FRAME.to_csv(path, index=False, encoding="utf-16"),
    "windows.csv": lambda path: FRAME.to_csv(path, index=False, lineterminator="\r\n"),
    "record.tsv": lambda path: FRAME.to_csv(path, index=False, sep="\t"),
    "record.txt": lambda path: FRAME.to_csv(path, index=False, sep=" "),
    "record.log": lambda path: FRAME.to_csv(path, index=False, sep="\t"),
    "record.parquet": FRAME.to_parquet,
    "index.pq": lambda path: FRAME.set_index("time").to_parquet(path),
    "record.npz": write_npz,
    "record.mat": write_mat,
}

SAMPLES = 240


def signal(time: Array) -> Array:
    """Two tones; a simulator that is right says the same."""
    return np.asarray(
        np.sin(2 * np.pi * 0.3 * time) + 0.4 * np.sin(2 * np.pi * 0.7 * time + 1), dtype=np.float64
    )


def times(start: float = 0.0, step: float = 0.1, samples: int = SAMPLES) -> Array:
    return start + step * np.arange(samples, dtype=np.float64)


def write(path: Path, time: Any, **columns: Any) -> Path:
    stamps = time.round(7) if isinstance(time, np.ndarray) else time
    pd.DataFrame({"time": stamps, **columns}).to_csv(path, index=False)
    return path

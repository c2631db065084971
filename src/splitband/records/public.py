"""Fetch the public records of the paper: download once from a pinned commit, check the hash."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from splitband.records.reading import read
from splitband.records.record import Record
from splitband.runtime.errors import InputError, one_line


@dataclass(frozen=True)
class PublicFile:
    """Describe a public record; `size` is in bytes, `sampling_time` in seconds."""

    name: str
    path: str
    sha256: str
    size: int
    description: str
    licence: str
    citation: str
    sampling_time: float = 0.01


_VARIABLE = "SPLITBAND_DATA_DIR"
_SOURCE = (
    "https://raw.githubusercontent.com/boschresearch/hybrid-observer/"
    "b1d56108588de19694341727eb86ee6e2f402cbf/hybrid_observer/data"
)
_DRILLING = (
    "MIT, (c) 2021 Open Drilling Project",
    "Aarsnes, Shor: Torsional vibrations with bit off bottom: Modeling, characterization and "
    "field data validation. J. Petroleum Science and Engineering 163, 712-721, 2018",
)
_TORSION = (
    "CC BY 4.0",
    "Lisowski, Retiere, Garcia Moreno, Olejnik: Semiempirical identification of nonlinear dynamics "
    "of a two-degree-of-freedom real torsion pendulum with a nonuniform planar stick-slip friction "
    "and elastic barriers. Nonlinear Dynamics, 2020, doi:10.1007/s11071-020-05684-6",
)
_FILES = (
    PublicFile(
        "drill_string_data",
        "drill_string/drill_string_data.txt",
        "6a19b018457c00467c5c0536ba69f39e1e6849b4351dc293beba5958d2165e2e",
        228820,
        "measured surface motor torque of a drill string, N m, 23,814 samples",
        *_DRILLING,
    ),
    PublicFile(
        "drill_string_sim",
        "drill_string/drill_string_sim.txt",
        "366e2b2228cda043c50871ecbb5addec22b4d15f6eb7d13a7efbb64b95c30bf3",
        97277,
        "physics simulation of drill_string_data[:6001], N m",
        *_DRILLING,
    ),
    PublicFile(
        "double_torsion_phi2",
        "double_torsion/double_torsion_phi2.txt",
        "acaf86a238bc73ce4b37e969fe04490317e87695649bbc276956e6f3361ef73d",
        119770,
        "measured second angle of a double-torsion pendulum, unit undocumented, 9,998 samples",
        *_TORSION,
    ),
    PublicFile(
        "double_torsion_num_phi2",
        "double_torsion/double_torsion_num_phi2.txt",
        "34ff2804e98fb5214aba9001f0893cec34837970c67143973a9d0531349b2f2f",
        5231,
        "numerical simulation of double_torsion_phi2[:400]",
        *_TORSION,
    ),
)
PUBLIC: dict[str, PublicFile] = {file.name: file for file in _FILES}


def fetch(name: str) -> Path:
    """Return the path of a public record, after checking its SHA-256.

    The file is `PUBLIC[name].path` below the folder in the environment variable SPLITBAND_DATA_DIR.
    Without it, it is downloaded once into the user's cache from a pinned commit of
    github.com/boschresearch/hybrid-observer; `PUBLIC[name]` states its licence and citation.

    Raises ValueError if the name is unknown, or the content is not the published one (the file is
    left unchanged). Raises FileNotFoundError if the folder lacks the file. Raises OSError if the
    download fails.
    """
    if name not in PUBLIC:
        raise InputError(f"public record {name!r} is unknown: there are {', '.join(PUBLIC)}")
    record = PUBLIC[name]
    if not (folder := os.environ.get(_VARIABLE)):
        return _download(record)
    path = Path(folder) / record.path
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist: {_VARIABLE}={folder}")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if digest != record.sha256:
        raise InputError(
            f"{path} is not the published {name}: its sha256 must be {record.sha256}, "
            f"it is {digest}"
        )
    return path


def _download(record: PublicFile) -> Path:
    import pooch  # noqa: PLC0415 - slow to import, and seldom needed

    url, path = f"{_SOURCE}/{record.path}", pooch.os_cache("splitband") / record.path
    instead = f"set {_VARIABLE} to a folder that holds {record.path}"
    logger = pooch.get_logger()
    level = logger.level
    logger.setLevel("CRITICAL")
    try:
        return Path(pooch.retrieve(url, f"sha256:{record.sha256}", path.name, path.parent))
    except OSError as error:  # includes the errors of requests and urllib
        raise OSError(
            f"{record.name} could not be downloaded ({type(error).__name__} at {url}): check the "
            f"connection, or {instead}"
        ) from error
    except ValueError as error:
        raise InputError(
            f"{record.name} as downloaded from {url} is not the published file: {instead} "
            f"({one_line(error)})"
        ) from error
    finally:
        logger.setLevel(level)


def double_torsion(samples: int = 2000) -> Record:
    """Return the first samples of a measured double-torsion pendulum, (samples, 1).

    Normalised by their own mean and standard deviation (ddof 0); 100 Hz; repeats every 160
    samples. Source: Lisowski et al. 2020, doi:10.1007/s11071-020-05684-6, CC BY 4.0, as published
    in github.com/boschresearch/hybrid-observer. Raises what `fetch` does, and a ValueError unless
    2 <= samples <= 9998.
    """
    record = PUBLIC["double_torsion_phi2"]
    whole = read(fetch(record.name), sampling_time=record.sampling_time).y
    if not 2 <= samples <= len(whole):
        raise InputError(f"samples must be from 2 to {len(whole)}: got {samples}")
    y = whole[:samples]
    y = (y - y.mean()) / y.std()
    return Record(y, record.sampling_time, name="double-torsion", columns=("phi2",))


def drill_string() -> Record:
    """Return measured drill-string torque and its physics simulation, 4001 samples at 100 Hz.

    System (vi) of the paper: samples 2000 to 6000, both signals normalised by the mean and
    standard deviation (ddof 0) of the measured one, (4001, 1). Source: Aarsnes and Shor 2018,
    MIT, (c) 2021 Open Drilling Project, as published in github.com/boschresearch/hybrid-observer.
    Raises what `fetch` does.
    """
    step = PUBLIC["drill_string_data"].sampling_time
    y, y_sim = (
        read(fetch(name), sampling_time=step).y[2000:6001]
        for name in ("drill_string_data", "drill_string_sim")
    )
    y, y_sim = ((signal - y.mean()) / y.std() for signal in (y, y_sim))
    return Record(y, step, y_sim=y_sim, name="drill-string", columns=("torque",))

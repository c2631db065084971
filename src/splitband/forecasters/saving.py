"""Save forecasters to folders, whole or not at all, and load them.

A folder holds forecaster.json, which describes the forecaster and its parts, and one safetensors
file with all weights and arrays. The latter is named after its content, so that an interrupted
`save` leaves the previous pair intact. Loading runs no code from a file, and none that a file
names, see `forecasters.description`. Of a simulator that is not recorded output only a description
is saved (`simulators.absent`); `load` takes the simulator itself.
"""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
import safetensors.numpy

from splitband.forecasters import ensemble, names  # noqa: F401  what can be loaded is defined there
from splitband.forecasters.base import Forecaster
from splitband.forecasters.description import Classes, Tensors, described
from splitband.forecasters.simulation import simulations
from splitband.runtime import outputs
from splitband.runtime.files import replacing, to_json
from splitband.simulators import Simulator
from splitband.simulators.absent import Absent

FORMAT = 5
"""Version of the folder's format, which changes with the results of `to_dict`."""
FILE, WEIGHTS = outputs.DESCRIPTION, outputs.WEIGHTS
LARGEST_DESCRIPTION = 2**28
"""Largest size of a description in bytes: bounds the memory. By eye."""
_DIGITS = 16
"""Digits of the weights' SHA-256 in the name of their file: enough to be unique."""
_UNFIT = (
    RuntimeError, TypeError, LookupError, ValueError, AttributeError, ArithmeticError, MemoryError,
    AssertionError, safetensors.SafetensorError,
)  # fmt: skip
"""Errors that a forged or damaged description may raise."""
_AGAIN = "train it again, with `splitband fit` or fit(record), and save it"


def save(
    forecaster: Forecaster, folder: str | Path, facts: Mapping[str, Any] | None = None
) -> None:
    """Write a fitted forecaster to a folder, whole or not at all.

    Parameters
    ----------
    forecaster : Fitted. One of your own must consist of numbers, texts, arrays, dates, lists and
        dicts of these, and objects of the package.
    folder : Created if it does not exist.
    facts : Further entries of the JSON file.

    Raises
    ------
    ValueError
        For a forecaster that has not been fitted, or holds a value that cannot be saved.
    """
    forecaster.require_fitted()
    folder, tensors = Path(folder), dict[str, Any]()
    description = described(forecaster, tensors)
    content = safetensors.numpy.save(tensors)
    digest = hashlib.sha256(content).hexdigest()
    text = to_json(
        {**(facts or {}), "format": FORMAT, "weights_sha256": digest, "forecaster": description}
    )
    folder.mkdir(parents=True, exist_ok=True)
    weights = folder / WEIGHTS.format(digest[:_DIGITS])
    if not weights.is_file() or weights.read_bytes() != content:
        with replacing(weights) as new:
            new.write_bytes(content)
    try:
        with replacing(folder / FILE) as new:
            new.write_text(text, encoding="utf-8")
    finally:
        _remove_outdated(folder)


def packed(value: Any) -> bytes:
    """Return a value as the content of one file, for `unpacked`; equal values give equal bytes.

    Raises ValueError for a value that cannot be saved.
    """
    tensors: dict[str, Any] = {}
    said = to_json(described(value, tensors))
    return safetensors.numpy.save(tensors, {"value": said})


def unpacked(content: bytes) -> Any:
    """Return the value that `packed` described; raises ValueError for other content."""
    try:
        header = int.from_bytes(content[:8], "little")
        said = json.loads(content[8 : 8 + header])["__metadata__"]["value"]
        tensors = dict(safetensors.numpy.load(content))
        return Classes((Forecaster,), tensors).made(json.loads(said))
    except _UNFIT as error:
        raise ValueError(f"the file cannot be read: {error}") from None


def files(folder: Path) -> list[Path]:
    """Return the files of the forecaster that a folder holds, and those of interrupted saves."""
    pattern = re.compile(WEIGHTS.format(f"[0-9a-f]{{{_DIGITS}}}").replace(".", r"\."))
    found = [path for path in folder.glob(WEIGHTS.format("*")) if pattern.fullmatch(path.name)]
    return [folder / FILE, *found] if (folder / FILE).is_file() else found


def _remove_outdated(folder: Path) -> None:
    """Remove weight files that do not belong to the current description."""
    try:
        digest = str(_read_description(folder)["weights_sha256"])
    except (OSError, *_UNFIT):
        digest = ""
    for path in files(folder):
        if path.name not in (FILE, WEIGHTS.format(digest[:_DIGITS])):
            path.unlink(missing_ok=True)


def load(folder: str | Path, simulator: Simulator | None = None) -> Forecaster:
    """Read what `Forecaster.save` wrote.

    Parameters
    ----------
    folder : Of the forecaster.
    simulator : The one that it was fitted with, such as `sb.Fmu("rig.fmu")`, or a replacement. A
        forecaster that needs one loads without it, but cannot predict.

    Raises
    ------
    FileNotFoundError
        When a file is missing.
    ValueError
        When a file is damaged, of another format, or needs a class of your own whose module has
        not been imported; for a simulator that the forecaster does not need, or whose `start` is
        not that of the saved one.

    Warns
    -----
    UserWarning
        When the simulator differs from the one that the forecaster was saved with.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> model = sb.Periodic().fit(record)
    >>> model.save("model")
    >>> bool(np.allclose(sb.load("model").predict(20).y, model.predict(20).y))
    True
    """
    return load_with_facts(folder, simulator)[0]


def load_with_facts(
    folder: str | Path, simulator: Simulator | None = None
) -> tuple[Forecaster, dict[str, Any]]:
    """Return the forecaster as `load` does, and the facts that were saved with it."""
    folder = Path(folder)
    if not (folder / FILE).is_file():
        old = f"; its model.json is of version 0.1 or 0.2: {_AGAIN}"
        said = old if (folder / "model.json").is_file() else ""
        raise FileNotFoundError(f"no model in {folder}: {FILE} is missing{said}")
    try:
        facts = _read_description(folder)
    except _UNFIT as error:
        raise ValueError(f"{folder / FILE} is damaged: {error!r}") from None
    if facts.get("format") != FORMAT:
        raise ValueError(
            f"{folder / FILE} has format {facts.get('format')!r}, this version reads {FORMAT}; "
            + _AGAIN
        )
    tensors = _tensors(folder, facts)
    try:
        loaded = Classes((Forecaster,), tensors).made(facts["forecaster"])
        if not isinstance(loaded, Forecaster):
            raise ValueError(f"it is {type(loaded).__name__}")
        loaded.require_fitted()
    except KeyError as error:
        raise ValueError(f"{folder / FILE} holds no forecaster: {error} is missing") from None
    except _UNFIT as error:
        raise ValueError(f"{folder / FILE} holds no forecaster that can be read: {error}") from None
    if simulator is not None:
        _give(loaded, simulator)
    return loaded, facts


def _read_description(folder: Path) -> dict[str, Any]:
    size = (folder / FILE).stat().st_size
    if size > LARGEST_DESCRIPTION:
        raise ValueError(f"it is larger than {LARGEST_DESCRIPTION} bytes")
    return dict(json.loads((folder / FILE).read_text(encoding="utf-8")).items())


def _tensors(folder: Path, facts: Mapping[str, Any]) -> Tensors:
    """Return the weights and arrays that belong to a description."""
    digest = facts.get("weights_sha256")
    if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
        raise ValueError(f"{folder / FILE} is damaged: weights_sha256 must be a SHA-256")
    path = folder / WEIGHTS.format(digest[:_DIGITS])
    if not path.is_file():
        raise FileNotFoundError(f"no model in {folder}: {path.name} is missing")
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise ValueError(f"{path} is damaged: its checksum is not that of the model")
    try:
        return dict(safetensors.numpy.load(content))
    except _UNFIT as error:
        raise ValueError(f"{path} is damaged: {error}") from None


def _give(forecaster: Forecaster, simulator: Simulator) -> None:
    """Set the simulator of a forecaster, with a warning if it differs from the saved one.

    Raises ValueError if it begins at another time.
    """
    given = [*simulations(forecaster)]
    if not given:
        raise ValueError(f"simulator must be left out for {forecaster.name}, which asks for none")
    saved = [each.simulator for each in given if isinstance(each.simulator, Absent)]
    for each in saved:
        each.check_start_of(simulator)
    for said in dict.fromkeys(each.difference(simulator) for each in saved):
        if said:
            warnings.warn(said, stacklevel=4)
    for each in given:
        each.simulator = simulator

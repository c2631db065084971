"""Saving and loading models: weights in safetensors, everything else in JSON.

Loading builds only the classes named here or by the caller; no code comes out of a file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from splitband.filters import ComplementaryPair
from splitband.models import Filtered, Model, Recurrent, Residual, Split
from splitband.networks import GRU, EulerMLP, StateSpace
from splitband.runtime.files import replacing, to_json

FORMAT = 2
LARGEST_DESCRIPTION = 2**28
"""Bytes of a description."""
_SPARE = 2**20
"""Bytes that a weights file may have beside the weights."""
UNFIT = (
    RuntimeError, TypeError, LookupError, ValueError, AttributeError, ArithmeticError, MemoryError,
    safetensors.SafetensorError,
)  # fmt: skip
"""What a description that was forged or damaged may raise."""
_DESCRIPTION, _WEIGHTS, _PREVIOUS = (
    "model.json",
    "weights.safetensors",
    "weights-previous.safetensors",
)
FILES = _DESCRIPTION, _WEIGHTS
"""The files of a saved model."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 1_000_000


def _is_factor(value: Any) -> bool:
    return _is_count(value) and value >= 1


def _list_of(check: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: (
        isinstance(value, list) and 0 < len(value) <= 1000 and all(map(check, value))
    )


# What an argument may be, in words and as a check.
Kind: TypeAlias = tuple[str, Callable[[Any], bool]]
_COUNT: Kind = "a whole number up to 1,000,000", _is_count
_FACTORS: Kind = (
    "one or a list of whole numbers from 1",
    lambda v: _is_factor(v) or _list_of(_is_factor)(v),
)
_NUMBER: Kind = "a finite number", _is_number
_NUMBER_OR_NONE: Kind = "a finite number or null", lambda v: v is None or _is_number(v)
_NUMBERS: Kind = "a list of finite numbers", _list_of(_is_number)
_FLAG: Kind = "true or false", lambda v: isinstance(v, bool)
_WORD: Kind = "a word", lambda v: isinstance(v, str)
_PART: Kind = "a part with a type", lambda v: isinstance(v, dict) and isinstance(v.get("type"), str)
_PARTS: Kind = "a list of parts with a type", _list_of(_PART[1])

# The format: what each class is built from, by name. These are its constructor's arguments, and
# also its attributes.
_SCHEMA: dict[type, dict[str, Kind]] = {
    GRU: {"ny": _COUNT, "hidden_size": _COUNT, "nu": _COUNT},
    EulerMLP: {
        "ny": _COUNT, "warmup": _COUNT, "state_size": _COUNT, "hidden_size": _COUNT,
        "recognition_size": _COUNT, "step_size": _NUMBER, "nu": _COUNT,
    },
    StateSpace: {
        "states": _COUNT, "hidden": _COUNT, "ny": _COUNT, "nu": _COUNT, "layers": _COUNT,
        "encoded": _COUNT,
    },
    ComplementaryPair: {
        "b_low": _NUMBERS, "b_high": _NUMBERS, "a": _NUMBERS, "sampling_rate": _NUMBER,
        "cutoff": _NUMBER_OR_NONE, "zero_phase": _FLAG, "start": _WORD,
    },
    Recurrent: {"cell": _PART, "feedthrough": _FLAG},
    Split: {
        "networks": _PARTS, "pairs": _PARTS, "downsampling": _FACTORS, "filter_output": _FLAG,
        "conditioned": _FLAG, "feedthrough": _FLAG,
    },
    Filtered: {"cell": _PART, "pair": _PART, "conditioned": _FLAG, "feedthrough": _FLAG},
    Residual: {"cell": _PART, "conditioned": _FLAG, "feedthrough": _FLAG},
}  # fmt: skip
_ADDED_LATER = {"feedthrough": False}
"""Arguments that models saved by 0.1.0 do not have, and what they were."""


def save(model: Model, folder: str | Path, facts: Mapping[str, Any] | None = None) -> None:
    """Write `model.json` and `weights.safetensors` into `folder`.

    Whenever it is interrupted, the folder holds the model that was there before, or this one.

    Parameters
    ----------
    model : Built from the package's cells, or from cells that have `arguments`, a dict of the
        JSON values to build them again from.
    folder : Created if need be.
    facts : Anything else to keep, as JSON: sampling time, settings, names of columns.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    # Clone: safetensors refuses tensors that share memory.
    state = {name: value.cpu().contiguous().clone() for name, value in model.state_dict().items()}
    weights = safetensors.torch.save(state)
    description = {
        "format": FORMAT,
        "model": _describe(model),
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
        "facts": dict(facts or {}),
    }
    text = to_json(description)
    # Weights are replaced before the description, which holds the checksum that they must have.
    with replacing(folder / _DESCRIPTION) as new, replacing(folder / _WEIGHTS) as new_weights:
        new_weights.write_bytes(weights)
        new.write_text(text, encoding="utf-8")
        _keep_previous(folder)
    (folder / _PREVIOUS).unlink(missing_ok=True)


def remove(folder: Path) -> None:
    """Remove a model's files where there are any, the description first."""
    for name in (_DESCRIPTION, _WEIGHTS, _PREVIOUS):
        (folder / name).unlink(missing_ok=True)


def _keep_previous(folder: Path) -> None:
    """Copy the weights of the model that is there to where `load` finds them, too."""
    try:
        digest = json.loads((folder / _DESCRIPTION).read_text(encoding="utf-8"))["weights_sha256"]
        content = (folder / _WEIGHTS).read_bytes()
    except (OSError, ValueError, KeyError, TypeError):
        return  # there is no complete model to keep
    if hashlib.sha256(content).hexdigest() == digest:
        with replacing(folder / _PREVIOUS) as temporary:
            temporary.write_bytes(content)


def load(
    folder: str | Path, cells: Mapping[str, Callable[..., nn.Module]] | None = None
) -> tuple[Model, dict[str, Any]]:
    """Read what `save` wrote; return the model and the facts saved with it.

    Parameters
    ----------
    folder : Of the model.
    cells : How to build cells of your own: class name to constructor, called with `arguments`.

    Raises
    ------
    FileNotFoundError
        When a file is missing.
    ValueError
        When a file is damaged, of another format, or does not fit the other.
    """
    folder = Path(folder)
    for name in FILES:
        if not (folder / name).is_file():
            raise FileNotFoundError(f"no model in {folder}: {name} is missing")
    try:
        description = read_description(folder / _DESCRIPTION)
        version, spec, digest = (description[k] for k in ("format", "model", "weights_sha256"))
        facts = dict(description["facts"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{folder / _DESCRIPTION} is damaged: {error!r}") from None
    if version != FORMAT:
        raise ValueError(f"{folder / _DESCRIPTION} has format {version!r}; this is for {FORMAT}")
    known = {c.__name__: c for c in _SCHEMA} | dict(cells or {})
    try:
        # On the meta device only shapes are made, so that no file can fill the memory.
        with torch.device("meta"):
            expected = _model(spec, known).state_dict()
    except UNFIT as error:
        raise ValueError(f"{folder / _DESCRIPTION} describes no model: {error}") from None
    weights = _weights(_of_digest(folder, digest), digest, expected)
    try:
        model = _model(spec, known)
        tied = _tied(model)
        # `assign` keeps the precision that was saved.
        model.load_state_dict(weights, assign=True)
        for first, *others in tied:
            for name in others:
                owner, _, attribute = name.rpartition(".")
                setattr(model.get_submodule(owner), attribute, model.get_parameter(first))
    except UNFIT as error:
        raise ValueError(f"{folder / _DESCRIPTION} describes no model: {error}") from None
    return model, facts


def read_description(path: Path) -> Any:
    """Return what a JSON file holds; raises ValueError or RecursionError where that fails."""
    if path.stat().st_size > LARGEST_DESCRIPTION:
        raise ValueError(f"it is larger than {LARGEST_DESCRIPTION} bytes")
    return json.loads(path.read_text(encoding="utf-8"))


def facts_of(folder: Path) -> dict[str, Any]:
    """The facts that were saved with a model; raises OSError or ValueError where there is none."""
    text = (folder / _DESCRIPTION).read_text(encoding="utf-8")
    return dict(json.loads(text).get("facts") or {})


def _tied(model: Model) -> list[list[str]]:
    """Names of parameters that are one and the same, for each that has several."""
    names: dict[int, list[str]] = {}
    for name, parameter in model.named_parameters(remove_duplicate=False):
        names.setdefault(id(parameter), []).append(name)
    return [of_one for of_one in names.values() if len(of_one) > 1]


def _of_digest(folder: Path, digest: Any) -> Path:
    """The weights' file; the previous one where `save` was interrupted before it was done."""
    previous = folder / _PREVIOUS
    if previous.is_file():
        with previous.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() == digest:
                return previous
    return folder / _WEIGHTS


def _weights(path: Path, digest: Any, expected: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """What the file holds, if that is what the model needs."""
    size, most = path.stat().st_size, 8 * sum(t.numel() for t in expected.values()) + _SPARE
    if size > most:
        raise ValueError(f"{path} is not the model's: {size} bytes, this model has {most} at most")
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise ValueError(f"{path} is damaged: its checksum is not that of the model")
    try:
        weights = safetensors.torch.load(content)
    except UNFIT as error:
        raise ValueError(f"{path} is damaged: {error}") from None
    if not {"u_low", "u_high"} & weights.keys() and {"u_low", "u_high"} <= expected.keys():
        # Models of older versions hold no range of the inputs: it is taken to be unlimited.
        unknown = torch.full(tuple(expected["u_low"].shape), torch.inf, dtype=torch.float64)
        weights |= {"u_low": -unknown, "u_high": unknown}
    shapes, needed = ({k: tuple(t.shape) for k, t in of.items()} for of in (weights, expected))
    if shapes != needed:
        name = min(k for k in shapes | needed if shapes.get(k) != needed.get(k))
        raise ValueError(
            f"{path} is not the model's: {name} must be {needed.get(name)}, got {shapes.get(name)}"
        )
    for name, tensor in weights.items():
        floating = tensor.dtype in (torch.float32, torch.float64)
        wanted = expected[name].dtype
        if not (floating if wanted.is_floating_point else tensor.dtype == wanted):
            raise ValueError(f"{path} must hold float32 or float64: {name} is {tensor.dtype}")
    return weights


def describe(module: nn.Module) -> dict[str, Any]:
    """A model or a cell without its weights, as JSON; raises ValueError for an unknown one."""
    described: dict[str, Any] = _describe(module)
    return described


def build(spec: Any, classes: Mapping[str, Callable[..., Any]] | None = None) -> Any:
    """Return what `describe` was given, without weights: it is built on the meta device.

    `classes` are further ones by name.
    """
    with torch.device("meta"):
        return _build(spec, {c.__name__: c for c in _SCHEMA} | dict(classes or {}))


def _model(spec: Any, known: Mapping[str, Callable[..., Any]]) -> Model:
    model = _build(spec, known)
    if not isinstance(model, Model):
        raise ValueError(f"{type(model).__name__} is not a model")
    return model


def _describe(value: Any) -> Any:
    if isinstance(value, list | nn.ModuleList):
        return [_describe(item) for item in value]
    if type(value) in _SCHEMA:
        arguments = {name: getattr(value, name) for name in _SCHEMA[type(value)]}
    elif isinstance(value, nn.Module):
        arguments = getattr(value, "arguments", None)  # type: ignore[assignment]
        if not isinstance(arguments, dict):
            raise ValueError(
                f"{type(value).__name__} cannot be saved: give it `arguments`, a dict of the "
                f"values its constructor takes"
            )
    else:
        return value.tolist() if isinstance(value, np.ndarray) else value
    return {"type": type(value).__name__} | {k: _describe(v) for k, v in arguments.items()}


def _build(value: Any, known: Mapping[str, Callable[..., Any]]) -> Any:
    if isinstance(value, list):
        parts = [_build(item, known) for item in value]
        return parts if any(isinstance(item, dict) for item in value) else np.array(parts)
    if not isinstance(value, dict):
        return value
    arguments = {k: v for k, v in value.items() if k != "type"}
    if "type" not in value:
        return {k: _build(v, known) for k, v in arguments.items()}
    make = known.get(str(value["type"]))
    if make is None:
        raise ValueError(f"unknown type {value['type']!r}; pass its constructor in `cells`")
    if isinstance(make, type) and make in _SCHEMA:
        later = {k: v for k, v in _ADDED_LATER.items() if k in _SCHEMA[make]}
        arguments = later | arguments
        _check(make.__name__, arguments, _SCHEMA[make])
        return make(**{k: _build(v, known) for k, v in arguments.items()})
    own = {k: _build(v, known) for k, v in arguments.items()}
    try:
        return make(**own)
    except RuntimeError:  # a cell of the user's own may compute with values, which meta has not
        with torch.device("cpu"):
            return make(**own)


def _check(name: str, arguments: Mapping[str, Any], schema: Mapping[str, Kind]) -> None:
    if arguments.keys() != schema.keys():
        odd = min(arguments.keys() ^ schema.keys())
        raise ValueError(f"{name} must have {', '.join(schema)}; {odd!r} is missing or not known")
    for key, (words, fits) in schema.items():
        if not fits(arguments[key]):
            raise ValueError(f"{key} of {name} must be {words}, got {str(arguments[key])[:60]!r}")

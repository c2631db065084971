"""Saving and loading models: weights in safetensors, everything else in JSON.

Loading builds only the classes named here or by the caller; no code comes out of a file.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.torch
from torch import nn

from splitband.cells import GRU, EulerMLP
from splitband.files import replacing, to_json
from splitband.filters import ComplementaryPair
from splitband.models import Filtered, Model, Recurrent, Residual, Split

FORMAT = 2
_UNFIT = (
    RuntimeError, TypeError, KeyError, ValueError, AttributeError, safetensors.SafetensorError,
)  # fmt: skip
_DESCRIPTION, _WEIGHTS = "model.json", "weights.safetensors"

# What each class is built from: the arguments of its constructor, which are also its attributes.
_ARGUMENTS: dict[type, tuple[str, ...]] = {
    GRU: ("ny", "hidden_size", "nu"),
    EulerMLP: (
        "ny", "warmup", "state_size", "hidden_size", "recognition_size", "step_size", "nu",
    ),
    ComplementaryPair: (
        "b_low", "b_high", "a", "sampling_rate", "cutoff", "zero_phase", "start",
    ),
    Recurrent: ("cell",),
    Split: ("networks", "pairs", "downsampling", "filter_output", "conditioned"),
    Filtered: ("cell", "pair", "conditioned"),
    Residual: ("cell", "conditioned"),
}  # fmt: skip


def save(model: Model, folder: str | Path, facts: Mapping[str, Any] | None = None) -> None:
    """Write `model.json` and `weights.safetensors` into `folder`.

    Parameters
    ----------
    model : Built from the package's cells, or from cells that have `arguments`, a dict of the
        JSON values to build them again from.
    folder : Created if need be.
    facts : Anything else to keep, as JSON: sampling time, settings, names of columns.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    state = {name: value.contiguous().cpu() for name, value in model.state_dict().items()}
    weights = safetensors.torch.save(state)
    description = {
        "format": FORMAT,
        "model": _describe(model),
        "weights_sha256": hashlib.sha256(weights).hexdigest(),
        "facts": dict(facts or {}),
    }
    text = to_json(description)
    # Both are written before either takes the place of its predecessor.
    with replacing(folder / _DESCRIPTION) as new, replacing(folder / _WEIGHTS) as new_weights:
        new_weights.write_bytes(weights)
        new.write_text(text, encoding="utf-8")


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
    for name in (_DESCRIPTION, _WEIGHTS):
        if not (folder / name).is_file():
            raise FileNotFoundError(f"no model in {folder}: {name} is missing")
    try:
        description = json.loads((folder / _DESCRIPTION).read_text(encoding="utf-8"))
        version, spec, digest = (description[k] for k in ("format", "model", "weights_sha256"))
        facts = dict(description["facts"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{folder / _DESCRIPTION} is damaged: {error!r}") from None
    if version != FORMAT:
        raise ValueError(f"{folder / _DESCRIPTION} has format {version!r}; this is for {FORMAT}")
    weights = (folder / _WEIGHTS).read_bytes()
    if hashlib.sha256(weights).hexdigest() != digest:
        raise ValueError(f"{folder / _WEIGHTS} is damaged: its checksum is not that of the model")
    try:
        model = _build(spec, dict(cells or {}))
        if not isinstance(model, Model):
            raise ValueError(f"{type(model).__name__} is not a model")
        # `assign` keeps the precision that was saved.
        model.load_state_dict(safetensors.torch.load(weights), assign=True)
    except _UNFIT as error:
        raise ValueError(f"{folder / _DESCRIPTION} describes no model: {error}") from None
    return model, facts


def _describe(value: Any) -> Any:
    if isinstance(value, list | nn.ModuleList):
        return [_describe(item) for item in value]
    if type(value) in _ARGUMENTS:
        arguments = {name: getattr(value, name) for name in _ARGUMENTS[type(value)]}
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


def _build(value: Any, cells: dict[str, Callable[..., Any]]) -> Any:
    if isinstance(value, list):
        parts = [_build(item, cells) for item in value]
        return parts if any(isinstance(item, dict) for item in value) else np.array(parts)
    if not isinstance(value, dict):
        return value
    known = {c.__name__: c for c in _ARGUMENTS} | cells
    arguments = {k: _build(v, cells) for k, v in value.items() if k != "type"}
    if "type" not in value:
        return arguments
    if value["type"] not in known:
        raise ValueError(f"unknown type {value['type']!r}; pass its constructor in `cells`")
    return known[value["type"]](**arguments)

"""Saving forecasters whole, and loading them: JSON, and safetensors for the weights.

Loading builds only the classes named here or by the caller, and opens nothing that a description
names: of a simulator, other than recorded output, a description is saved (`simulators.absent`), and
the simulator itself is given to `load`.
"""

from __future__ import annotations

import json
import math
import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pandas as pd
import torch
from torch import nn

from splitband.baselines.harmonic import HarmonicRegression
from splitband.baselines.linear import Channel, OutputError
from splitband.baselines.modes import Modes
from splitband.baselines.periodic import PeriodicRegression
from splitband.baselines.seasonal import SeasonalNaive as LastPeriod
from splitband.baselines.states import States
from splitband.baselines.trend import Shape, Trend
from splitband.data import Record
from splitband.data.gaps import last_before
from splitband.filters.cutoff import Candidate, Choice
from splitband.forecasters import closed_form
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import Ensemble
from splitband.forecasters.fitted import FitReport, Fitted
from splitband.forecasters.hybrids import Filtered, Residual
from splitband.forecasters.intervals import HeldOut
from splitband.forecasters.network import Network
from splitband.forecasters.simulation import Calibrated, Simulation
from splitband.forecasters.single import Single
from splitband.forecasters.split import Split
from splitband.models import saving as models
from splitband.networks import GRU, EulerMLP, StateSpace
from splitband.runtime.arguments import whole
from splitband.runtime.files import write_json
from splitband.simulators import Recorded, Simulator
from splitband.simulators.absent import Absent
from splitband.simulators.calibration import Calibration
from splitband.training import Settings

FORMAT = 2
FILE = "forecaster.json"
PARTS = "parts-0", "parts-1"
"""Folders for what a forecaster is made of and has weights of its own: the members of an ensemble,
a network that holds the slow part of another one. The description names the one that counts, so
that an interrupted `save` leaves the parts of the forecaster that was there before."""
BASE, MEMBER = "base", "member-{}"
SHORT = 20_000
"""Samples of a training record with a simulator that is saved as a whole."""
_DTYPES = "float64", "float32", "int64", "int32", "bool"
_PLAIN = (
    Absent, Bands, Calibration, Candidate, Channel, Choice, FitReport, Fitted, HarmonicRegression,
    HeldOut, LastPeriod, Modes, OutputError, PeriodicRegression, Recorded, Settings, Shape, States,
    Record, Trend,
)  # fmt: skip
"""Classes that are built from their fields."""
_FORECASTERS = (
    Calibrated, Ensemble, Filtered, Residual, Simulation, Single, Split,
    closed_form.Harmonic, closed_form.Linear, closed_form.Mean, closed_form.Periodic,
    closed_form.Persistence, closed_form.SeasonalNaive,
)  # fmt: skip
# By themselves: a baseline and the forecaster made of it may have one name.
_BY_FIELDS: dict[str, Callable[..., Any]] = {
    **{each.__name__: each for each in _PLAIN},
    "Calibration": Calibration.from_fields,
}
_KNOWN = {each.__name__: each for each in (*_PLAIN, *_FORECASTERS, GRU, EulerMLP, StateSpace)}


def save(
    forecaster: Forecaster, folder: str | Path, facts: Mapping[str, Any] | None = None
) -> None:
    """Write a fitted forecaster to a folder, whole or not at all.

    Parameters
    ----------
    forecaster : Fitted. One of your own must consist of numbers, texts, arrays and what the package
        is made of.
    folder : Created if need be.
    facts : Anything else to keep, as JSON.

    Raises
    ------
    ValueError
        For a forecaster that has not been fitted, or holds what cannot be saved.
    """
    forecaster.require_fitted()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    description = {**(facts or {}), "format": FORMAT, "forecaster": _encode(forecaster)}
    place = _save_parts(forecaster, folder)
    if place is not None:
        description["parts"] = place
    if isinstance(forecaster, Network):
        assert forecaster.model is not None
        models.save(forecaster.model, folder, description)
        # `load` would prefer the description of what was there before.
        (folder / FILE).unlink(missing_ok=True)
    else:
        write_json(folder / FILE, description)
        models.remove(folder)
    for other in PARTS:
        if other != place:
            shutil.rmtree(folder / other, ignore_errors=True)


def load(
    folder: str | Path,
    simulator: Simulator | None = None,
    classes: Mapping[str, Callable[..., Any]] | None = None,
) -> Forecaster:
    """Read what `Forecaster.save` wrote.

    Parameters
    ----------
    folder : Of the forecaster.
    simulator : The one that it was fitted with, such as `sb.Fmu("rig.fmu")`, or another one in its
        place. Without it what needs a simulator is loaded, too, and says so when it is asked.
    classes : Forecasters and cells of your own, by the name of the class.

    Raises
    ------
    FileNotFoundError
        When a file is missing.
    ValueError
        When a file is damaged, of another format, or names a class that is not known; for a
        simulator where none is asked for.

    Warns
    -----
    UserWarning
        When the simulator is not the one that the forecaster was saved with.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> model = sb.Periodic().fit(record)
    >>> model.save("model")
    >>> bool(np.allclose(sb.load("model").predict(20).y, model.predict(20).y))
    True
    """
    return load_with_facts(folder, simulator, classes)[0]


def load_with_facts(
    folder: str | Path,
    simulator: Simulator | None = None,
    classes: Mapping[str, Callable[..., Any]] | None = None,
) -> tuple[Forecaster, dict[str, Any]]:
    """What `load` returns, and the facts that were saved with it."""
    loaded, facts = _loaded(Path(folder), classes or {})
    if simulator is not None:
        _give(loaded, simulator)
    return loaded, facts


def _give(forecaster: Forecaster, simulator: Simulator) -> None:
    """Have it run this simulator; warn of one that is not the one it was saved with."""
    simulations = [*_simulations(forecaster)]
    if not simulations:
        raise ValueError(f"simulator must be left out for {forecaster.name}, which asks for none")
    saved = [each.simulator for each in simulations if isinstance(each.simulator, Absent)]
    for said in dict.fromkeys(each.difference(simulator) for each in saved):
        if said:
            warnings.warn(said, stacklevel=4)
    for each in simulations:
        each.simulator = simulator


def _simulations(value: Any) -> Iterator[Simulation | Calibrated]:
    """The simulations that a forecaster is made of."""
    if isinstance(value, Simulation | Calibrated):
        yield value
    elif isinstance(value, Forecaster | list):
        for part in value if isinstance(value, list) else vars(value).values():
            yield from _simulations(part)


def _loaded(
    folder: Path, classes: Mapping[str, Callable[..., Any]]
) -> tuple[Forecaster, dict[str, Any]]:
    if (folder / FILE).is_file():
        try:
            facts = models.read_description(folder / FILE)
        except (ValueError, RecursionError, MemoryError) as error:
            raise ValueError(f"{folder / FILE} is damaged: {error}") from None
        model = None
    else:
        cells = {name: c for name, c in classes.items() if not _is_forecaster(c)}
        model, facts = models.load(folder, cells)
    try:
        if facts["format"] != FORMAT:
            raise ValueError(
                f"it has format {facts['format']!r}, this version reads {FORMAT}; train it again, "
                "with `splitband fit` or fit(record), and save it"
            )
        loaded = _decode(facts["forecaster"], {**_KNOWN, **classes})
        for each in _simulations(loaded):
            if each.fitted is not None:
                each.applied.check(each.fitted.record.ny)
    except KeyError as error:
        raise ValueError(
            f"{folder} holds no forecaster: {error} is missing; a model that an older version "
            "wrote without it must be trained again, with `splitband fit`"
        ) from None
    except models.UNFIT as error:
        raise ValueError(f"{folder} holds no forecaster that can be read: {error}") from None
    if not isinstance(loaded, Forecaster):
        raise ValueError(f"{folder} holds no forecaster, but {type(loaded).__name__}")
    if isinstance(loaded, Network):
        loaded.model = model
        _check_cells(loaded, folder)
    parts = folder / _place_of(facts)
    if isinstance(loaded, Filtered | Residual) and loaded.fitted_base is None:
        loaded.fitted_base = _loaded(parts / BASE, classes)[0]
    if isinstance(loaded, Ensemble):
        whole("count", getattr(loaded, "count", None))
        loaded.members = [
            _loaded(parts / MEMBER.format(i), classes)[0] for i in range(loaded.count)
        ]
    return loaded, facts


def _check_cells(network: Network, folder: Path) -> None:
    """Raise ValueError where its templates are not those of the weights that are there."""
    fitted, settings = network.fitted, network.trained_by
    if fitted is None or settings is None or network.model is None:
        return
    with torch.device("meta"):
        try:
            built = network.build(fitted.record, settings).state_dict()
        except (ValueError, AssertionError) as error:
            raise ValueError(f"{folder} holds no forecaster: {error!r}") from None
        except models.UNFIT:  # a cell of the user's own may compute with values
            return
    found = network.model.state_dict()
    if {k: v.shape for k, v in built.items()} != {k: v.shape for k, v in found.items()}:
        raise ValueError(f"{folder} holds no forecaster: its cells are not those of its weights")


def _save_parts(forecaster: Forecaster, folder: Path) -> str | None:
    """Save what a forecaster is made of into the free one of `PARTS`; None where it is whole."""
    parts: dict[str, Forecaster] = {}
    if isinstance(forecaster, Ensemble):
        parts = {MEMBER.format(i): member for i, member in enumerate(forecaster.members)}
    elif (base := _network_below(forecaster)) is not None:
        parts = {BASE: base}
    if not parts:
        return None
    place = PARTS[0] if _described(folder).get("parts") != PARTS[0] else PARTS[1]
    shutil.rmtree(folder / place, ignore_errors=True)
    for name, part in parts.items():
        save(part, folder / place / name)
    return place


def _described(folder: Path) -> dict[str, Any]:
    """What describes the forecaster that is there; empty for none that can be read."""
    try:
        if (folder / FILE).is_file():
            return dict(json.loads((folder / FILE).read_text(encoding="utf-8")))
        return models.facts_of(folder)
    except (OSError, ValueError, TypeError, RecursionError):
        return {}


def _place_of(facts: Mapping[str, Any]) -> str:
    """Return the name of the folder of the parts, which is one of `PARTS`."""
    place = facts.get("parts")
    return str(place) if place in PARTS else PARTS[0]


def _is_forecaster(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, Forecaster)


def _end(forecaster: Forecaster) -> Fitted:
    """What is remembered, with as much of the training record as a forecast from its end needs."""
    fitted = forecaster.require_fitted()
    record, warmup = fitted.record, forecaster.warmup
    measured = ~np.isnan(record.seen)
    first = min(int(np.flatnonzero(channel)[-1]) for channel in measured.T)
    if warmup:
        start = last_before(record.complete, warmup, len(record))
        first = min(first, (warmup if start is None else start) - warmup)
    first -= max(forecaster.delays, default=0)
    first = max(0, min(first, len(record) - 2))
    if _network_below(forecaster) is not None:
        first = 0  # it runs freely from the beginning of the record on
    elif "simulator" in forecaster.needs:
        # A calibrated delay or clock uses earlier output of the simulator, a seventh of it at most.
        first = 0 if len(record) <= SHORT else min(first, len(record) - len(record) // 5)
    end = replace(record[first:], beyond=None, u_beyond=None)
    # The run time is left out, so that the same fit is saved as the same file, byte by byte.
    report = replace(fitted.report, seconds=0.0)
    whole = fitted.whole and not fitted.others
    begin = fitted.begin + first
    return replace(fitted, record=end, begin=begin, others=(), report=report, whole=whole)


def _network_below(forecaster: Forecaster) -> Forecaster | None:
    """What holds the slow part of a network, where it has weights of its own."""
    if isinstance(forecaster, Ensemble):
        return _network_below(forecaster.members[0])
    base = getattr(forecaster, "fitted_base", None)
    return base if isinstance(base, Network) else None


def _apart(forecaster: Forecaster) -> set[str]:
    """Attributes that are not saved with the others."""
    left = {"fitted"}
    if isinstance(forecaster, Network):
        left |= {"model", "earlier"}
    fitted = forecaster.fitted is not None  # otherwise it has no weights, and is saved in place
    if fitted and not isinstance(forecaster, Ensemble) and _network_below(forecaster) is not None:
        left.add("fitted_base")
    return left | {"members"} if isinstance(forecaster, Ensemble) else left


def _encode(value: Any) -> Any:  # noqa: PLR0911  a line for each kind
    """As JSON; raises ValueError for what cannot be."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        flat = [None if math.isnan(v) else v for v in value.ravel().tolist()]
        return {"array": flat, "shape": list(value.shape), "dtype": str(value.dtype)}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, pd.Timestamp):
        return {"date": value.isoformat()}
    if isinstance(value, torch.device):
        return {"device": str(value)}
    if isinstance(value, Mapping):
        return {"mapping": {str(k): _encode(v) for k, v in value.items()}}
    if isinstance(value, Forecaster):
        state = {k: _encode(v) for k, v in vars(value).items() if k not in _apart(value)}
        fitted = None if value.fitted is None else _encode(_end(value))
        return {"class": type(value).__name__, "state": state | {"fitted": fitted}}
    if isinstance(value, nn.Module):
        return {"cell": models.describe(value)}
    if isinstance(value, _PLAIN):
        parts = {name: _encode(getattr(value, name)) for name in _names(value)}
        return {"class": type(value).__name__, "fields": parts}
    if isinstance(value, list | tuple | frozenset):
        return {type(value).__name__: [_encode(v) for v in value]}
    if callable(getattr(value, "simulate", None)):
        return _encode(Absent.of(value))
    raise ValueError(f"{type(value).__name__} cannot be saved with a forecaster")


def _names(plain: Any) -> list[str]:
    """Of the fields that it is built from."""
    named: tuple[str, ...] | None = getattr(plain, "_fields", None)
    return [*named] if named else [field.name for field in fields(plain) if field.init]


def _decode(  # noqa: PLR0911, PLR0912  a line for each kind
    value: Any, known: Mapping[str, Callable[..., Any]]
) -> Any:
    """What `_encode` was given."""

    def again(part: Any) -> Any:
        return _decode(part, known)

    if not isinstance(value, dict):
        return value
    if "array" in value:
        flat = [np.nan if v is None else v for v in value["array"]]
        if value["dtype"] not in _DTYPES:
            raise ValueError(f"an array must hold numbers, got {str(value['dtype'])[:60]!r}")
        return np.array(flat, dtype=value["dtype"]).reshape(value["shape"])
    for kind in (list, tuple, frozenset):
        if kind.__name__ in value:
            return kind(again(v) for v in value[kind.__name__])
    if "date" in value:
        return pd.Timestamp(value["date"])
    if "device" in value:
        return torch.device("cpu")  # where it was trained may not be there
    if "mapping" in value:
        return {k: again(v) for k, v in value["mapping"].items()}
    if "cell" in value:
        return models.build(value["cell"], {k: v for k, v in known.items() if not _is_plain(v)})
    name = value["class"]
    if name == "Fmu":  # as 0.2.0 saved it, with a path that is not opened any more
        settings = f"{value['outputs']} {sorted(value['start_values'].items())}"
        return Absent(name, Path(value["path"]).name, f"{value['sha256']} {settings}")
    if name not in known:
        raise ValueError(f"the class {name} is not known; give it to load as classes={{...}}")
    if "fields" in value:
        if name not in _BY_FIELDS:
            raise ValueError(f"{name} is not built from its fields")
        parts = {k: again(v) for k, v in value["fields"].items()}
        _check_numbers(_KNOWN[name], parts)
        return _BY_FIELDS[name](**parts)
    make = known[name]
    if not _is_forecaster(make):
        raise ValueError(f"{name} is no forecaster")
    forecaster: Any = object.__new__(make)  # type: ignore[arg-type]
    vars(forecaster).update({k: again(v) for k, v in value["state"].items()})
    if isinstance(forecaster, Network):
        forecaster.model = None
    if isinstance(forecaster, Ensemble):
        forecaster.members = []
    return forecaster


def _check_numbers(kind: type, parts: Mapping[str, Any]) -> None:
    """Raise ValueError for a part that must be a number and is none."""
    for name, wanted in get_type_hints(kind).items():
        part = parts.get(name, 0)
        if wanted is int:
            whole(name, part, None)
        elif wanted is float and (isinstance(part, bool) or not isinstance(part, int | float)):
            raise ValueError(f"{name} must be a number, got {str(part)[:60]!r}")


def _is_plain(value: Any) -> bool:
    return value in _PLAIN or _is_forecaster(value)

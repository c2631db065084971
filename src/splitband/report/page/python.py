"""A forecaster as the lines of Python that make it."""

from __future__ import annotations

import textwrap
from dataclasses import fields
from typing import Any

from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.closed_form import (
    Harmonic,
    Linear,
    Mean,
    Periodic,
    Persistence,
    SeasonalNaive,
)
from splitband.forecasters.ensemble import Ensemble
from splitband.forecasters.hybrids import Filtered, Residual
from splitband.forecasters.network import Network
from splitband.forecasters.simulation import Simulation
from splitband.forecasters.single import Single
from splitband.forecasters.split import Split
from splitband.networks import GRU, EulerMLP
from splitband.training import Settings

_CLOSED_FORMS = Harmonic, Linear, Mean, Periodic, Persistence, SeasonalNaive
_UNKNOWN = "..."
WIDTH = 88
"""Characters in a line of settings."""
OWN, BASE = "settings", "base_settings"
"""What the settings of a network are called, and those of one that holds its slow part."""
_INDENTED: Any = {"initial_indent": "    ", "subsequent_indent": "    "}


def making(forecaster: Forecaster) -> list[str]:
    """The lines that make it, the last of which assigns it to `model`.

    An ellipsis stands for what only its user can make: a simulator, a cell or a class of their own.
    """
    member = forecaster.member if isinstance(forecaster, Ensemble) else forecaster
    made = _made(member)
    if made == _UNKNOWN:
        return [f"model = ...  # {forecaster.name}"]
    if isinstance(forecaster, Ensemble):
        usual = forecaster.seeds == tuple(range(forecaster.count))
        made = f"sb.Ensemble({made}, {forecaster.count if usual else f'seeds={forecaster.seeds}'})"
    base = getattr(member, "base", None)
    return [*_settings(base, BASE), *_settings(member, OWN), f"model = {made}"]


def _settings(forecaster: Forecaster | None, name: str) -> list[str]:
    """The lines that assign a network's settings to a name."""
    if not isinstance(forecaster, Network) or forecaster.settings is None:
        return []
    changed = ", ".join(f"{k}={v}" for k, v in _changed(forecaster.settings).items())
    return [f"{name} = sb.Settings(", *textwrap.wrap(changed, WIDTH, **_INDENTED), ")"]


def _made(forecaster: Forecaster, settings: str = OWN) -> str:
    if isinstance(forecaster, _CLOSED_FORMS):
        return _call(type(forecaster).__name__)
    if isinstance(forecaster, Simulation):
        simulator = [] if forecaster.simulator is None else [_UNKNOWN]
        return _call("Simulation", *simulator, **_options(calibrated=forecaster.calibrated))
    if isinstance(forecaster, Single):
        return _call("Single", _cell(forecaster.cell), **_trained(forecaster, settings))
    if isinstance(forecaster, Split):
        cells = _cell(forecaster.low), _cell(forecaster.high)
        options = _options(
            filter_output=forecaster.filter_output, conditioned=forecaster.conditioned
        )
        return _call(
            "Split", *cells, *_bands(forecaster.bands), **options, **_trained(forecaster, settings)
        )
    if isinstance(forecaster, Filtered | Residual):
        base, calibrated = _made(forecaster.base, BASE), False
        if isinstance(forecaster.base, Simulation) and isinstance(forecaster.base.calibrated, bool):
            base = "None" if forecaster.base.simulator is None else _UNKNOWN
            calibrated = forecaster.base.calibrated
        bands = _bands(forecaster.bands) if isinstance(forecaster, Filtered) else []
        options = _options(calibrated=calibrated, conditioned=forecaster.conditioned)
        name, cell = type(forecaster).__name__, _cell(forecaster.cell)
        return _call(name, base, cell, *bands, **options, **_trained(forecaster, settings))
    return _UNKNOWN


def _cell(cell: Any) -> str:
    if type(cell) is GRU:
        return _call("GRU", str(cell.hidden_size))
    if type(cell) is EulerMLP:
        names = "state_size", "hidden_size", "recognition_size", "step_size"
        return _call("EulerMLP", **{name: repr(getattr(cell, name)) for name in names})
    return _UNKNOWN


def _bands(bands: Bands) -> list[str]:
    """As an argument; none where they are left open."""
    given = {k: repr(getattr(bands, k)) for k in ("cutoff", "order", "downsampling")}
    given = {name: value for name, value in given.items() if value != "None"}
    return [_call("Bands", **given)] if given else []


def _trained(network: Network, name: str) -> dict[str, str]:
    return {} if network.settings is None else {"settings": name}


def _changed(settings: Settings) -> dict[str, str]:
    """What differs from the defaults."""
    usual = Settings()
    values = {field.name: getattr(settings, field.name) for field in fields(Settings)}
    return {name: repr(v) for name, v in values.items() if v != getattr(usual, name)}


def _options(**options: Any) -> dict[str, str]:
    """Those that are not left as they are by default."""
    return {name: repr(value) for name, value in options.items() if value is not False}


def _call(name: str, *values: str, **named: str) -> str:
    return f"sb.{name}({', '.join([*values, *(f'{k}={v}' for k, v in named.items())])})"

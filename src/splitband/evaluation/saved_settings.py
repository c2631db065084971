"""Read and write the settings of a network as a JSON file that people can edit."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from splitband.data.names import described, same_names
from splitband.data.record import Record
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import TRAINED, Sizes, named
from splitband.forecasters.network import Network
from splitband.runtime.arguments import did_you_mean
from splitband.runtime.files import write_json
from splitband.training import Settings

FORMAT, VERSION = "splitband settings", 1
FILE = "settings.json"
_KINDS = {
    int: ("a whole number", (int,)),
    float: ("a number", (int, float)),
    bool: ("true or false", (bool,)),
}

Section = TypeVar("Section", Sizes, Settings, Bands)


@dataclass(frozen=True)
class SavedSettings:
    """Hold the method, the training settings, the bands and the sizes of one network.

    Attributes
    ----------
    method : Name of the network.
    settings : Training settings.
    bands : Bands of a method that filters; values that are None are chosen during the fit.
    sizes : Sizes of the cells.
    columns, inputs : Channels and inputs that a record must have; without `columns`, any record is
        accepted.
    """

    method: str
    settings: Settings
    bands: Bands = field(default_factory=Bands)
    sizes: Sizes = field(default_factory=Sizes)
    columns: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the name."""
        if self.method not in TRAINED:
            raise ValueError(
                f"method must name a network, got {self.method!r}"
                f"{did_you_mean([str(self.method)], TRAINED)}"
            )

    def forecaster(self) -> Network:
        """Return the unfitted network; a comparison trains it without a search for settings."""
        network = named(self.method, self.sizes).with_defaults(self.settings, self.bands).network
        assert network is not None
        network.tunable = False
        return network

    def for_record(self, record: Record) -> SavedSettings:
        """Return the same network for records with the channels and inputs of this one."""
        return replace(self, columns=record.columns, inputs=record.inputs)

    def check(self, record: Record) -> None:
        """Raise ValueError for a record with other channels or inputs; any order will do."""
        pairs = ((record.columns, self.columns), (record.inputs, self.inputs))
        if self.columns and not all(same_names(sorted(a), sorted(b)) for a, b in pairs):
            raise ValueError(
                f"the settings are for {described(self.columns, self.inputs)}, the record has "
                f"{described(record.columns, record.inputs)}; without columns and inputs in the "
                "file they are for any record"
            )

    def as_json(self) -> dict[str, Any]:
        """Return what `save` writes."""
        bands = asdict(self.bands)
        return {
            "format": FORMAT,
            "version": VERSION,
            "method": self.method,
            "sizes": asdict(self.sizes),
            "bands": {name: bands[name] for name in _names(Bands)},
            "training": asdict(self.settings),
        } | ({"columns": [*self.columns], "inputs": [*self.inputs]} if self.columns else {})

    def save(self, path: str | Path) -> None:
        """Write a JSON file."""
        write_json(path, self.as_json())

    @classmethod
    def of_forecaster(cls, forecaster: Forecaster) -> SavedSettings | None:
        """Return the settings of a network; None for forecasters that a file cannot describe.

        For a median over seeds, they are those of the first member.
        """
        network = forecaster.of_one_seed.network
        if network is None or network.settings is None or network.name not in TRAINED:
            return None
        bands = network.bands or Bands()
        sizes = _sizes(network)
        saved = cls(network.name, network.settings, replace(bands, choice=None), sizes)
        same = saved.forecaster().training_in_words() == network.training_in_words()
        return saved if same else None

    @classmethod
    def of(cls, facts: Any) -> SavedSettings:
        """Return settings from what `as_json` returns; ValueError names a wrong key."""
        _check_keys("", facts, {"format", "version", "method", "sizes", "bands", "training"})
        if (facts["format"], facts["version"]) != (FORMAT, VERSION):
            raise ValueError(
                f"format must be {FORMAT}, version {VERSION}, got {facts['format']}, version "
                f"{facts['version']}"
            )
        if not isinstance(facts["method"], str):
            raise ValueError(f"method must be a name, got {facts['method']!r}")
        return cls(
            facts["method"],
            _section("training", facts["training"], Settings),
            _section("bands", facts["bands"], Bands),
            _section("sizes", facts["sizes"], Sizes),
            _strings("columns", facts.get("columns", [])),
            _strings("inputs", facts.get("inputs", [])),
        )

    @classmethod
    def read(cls, path: str | Path) -> SavedSettings:
        """Read a settings file that was written by `save` or by hand.

        Raises
        ------
        FileNotFoundError
            Where there is no such file.
        ValueError
            For a file of another format, an unknown or missing key, or a value out of range; the
            message names file, key, rule and value.
        """
        try:
            facts = json.loads(Path(path).read_text(encoding="utf-8"), parse_constant=_refused)
            return cls.of(facts)
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise ValueError(f"settings must be a JSON file, got {path}: {error}") from None
        except ValueError as error:
            raise ValueError(f"settings {path}: {error}") from None


def _sizes(network: Network) -> Sizes:
    """Return the sizes of a network's cells; a single cell has the sum of a split model's two."""
    cells = [getattr(network, name) for name in network.cells]
    hidden = [getattr(cell, "hidden_size", 0) for cell in cells]
    if hasattr(cells[0], "step_size"):
        return Sizes(state_size=cells[0].state_size, step_size=cells[0].step_size)
    low, high = hidden if len(hidden) > 1 else (max(hidden[0] // 3, 1), 0)
    return Sizes(hidden_high=high or max(hidden[0] - low, 1), hidden_low=low)


def _refused(constant: str) -> float:
    raise ValueError(f"numbers must be finite, got {constant}")


def _names(section: type[Section]) -> list[str]:
    """Return the keys of a section, without `Bands.choice`, which is an explanation."""
    return [each.name for each in fields(section) if each.name != "choice"]


def _check_keys(where: str, given: Any, names: set[str]) -> None:
    if not isinstance(given, dict):
        raise ValueError(f"{where or 'the file'} must be an object, got {given!r}")
    dot = f"{where}." if where else ""
    optional = set() if where else {"columns", "inputs"}
    for key in given:
        if key not in names | optional:
            raise ValueError(
                f"{dot}{key} is unknown, the keys are {', '.join(sorted(names | optional))}"
            )
    for key in sorted(names - set(given)):
        raise ValueError(f"{dot}{key} must be given")


def _strings(name: str, given: Any) -> tuple[str, ...]:
    if not isinstance(given, list) or not all(isinstance(each, str) for each in given):
        raise ValueError(f"{name} must be a list of names, got {json.dumps(given)}")
    return tuple(given)


def _section(where: str, given: Any, section: type[Section]) -> Section:
    hints = get_type_hints(section)
    _check_keys(where, given, set(_names(section)))
    values = {name: _value(f"{where}.{name}", given[name], hints[name]) for name in given}
    try:
        return section(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _value(name: str, value: Any, hint: Any) -> Any:
    """Return a value as the type of its field; raises ValueError for another type."""
    if name.endswith("milestones"):
        return _milestones(name, value)
    allowed = getattr(hint, "__args__", (hint,))
    if value is None and type(None) in allowed:
        return None
    kind = next(each for each in _KINDS if each in allowed)
    words, types = _KINDS[kind]
    if not isinstance(value, types) or (isinstance(value, bool) and kind is not bool):
        none = " or null" if type(None) in allowed else ""
        raise ValueError(f"{name} must be {words}{none}, got {json.dumps(value)}")
    return float(value) if kind is float else value


def _milestones(name: str, value: Any) -> tuple[tuple[int, float], ...]:
    try:
        pairs = tuple((epoch, float(rate)) for epoch, rate in value)
        if all(type(epoch) is int for epoch, _ in pairs):
            return pairs
    except (TypeError, ValueError):
        pass
    raise ValueError(f"{name} must be a list of [epoch, rate], got {json.dumps(value)}")

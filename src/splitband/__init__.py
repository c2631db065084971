"""Learn dynamics models from measured records, their slow and fast parts by different means.

What the package hands out stands once, in `__init__.pyi`: a line there is all that a name needs. It
is loaded when it is used, as torch and pandas take seconds.
"""

from typing import Any

import lazy_loader

__version__ = "0.2.0"

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
GONE = {
    "Cluster": "compare(executor=...)",
    "Known": "ForecastContext",
    "Options": "plan",
    "Question": "BacktestSpec",
    "SavedSettings": "Plan",
    "Search": "compare(budget=..., rounds=...)",
    "Setup": "plan",
    "Work": "run(cores=..., executor=...)",
}
"""What to use in place of names of earlier versions."""


def __getattr__(name: str) -> Any:
    if name in GONE:
        raise AttributeError(f"splitband.{name} is gone: use splitband.{GONE[name]}", name=name)
    return _load(name)

"""Define the simulators of the named records."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from splitband.records.named import RECORDS, UNFORCED_START, unforced_van_der_pol
from splitband.simulators.base import Recorded, Simulator
from splitband.simulators.functions import Ode


def exported_simulator(name: str) -> Simulator:
    """Return the simulator's output in a named record, in the record's units."""
    record = RECORDS[name].make()
    assert record.y_sim is not None
    return Recorded(record.y_sim, record.sampling_time, record.start, f"simulator of {name}")


SIMULATORS: dict[str, Callable[[], Simulator]] = {
    "van-der-pol": partial(Ode, unforced_van_der_pol, UNFORCED_START, tolerances=(1e-10, 1e-13)),
    **{name: partial(exported_simulator, name) for name in ("drill-string", "overhead-crane")},
}

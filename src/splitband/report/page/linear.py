"""Plot how the order of a linear model was chosen, and its frequency response with errors."""

from __future__ import annotations

import numpy as np

from splitband.baselines.linear import LinearModel
from splitband.data import Record
from splitband.forecasters.base import Forecaster
from splitband.report.numbers import number
from splitband.report.page.charts import SMALL, Axis, Chart
from splitband.report.page.parts import Method, Plot, Section
from splitband.runtime.arrays import Array

LEVEL = 1.96
"""Half width of a 95 % interval in standard errors, of a normal distribution."""
_STYLE = Method("linear model")
"""Always shown: no switch of the page has this name."""


def section(linear: Forecaster, model: LinearModel) -> Section:
    """Return the section of a fitted forecaster that is a linear model."""
    orders, responses = _orders(model), _responses(linear.require_fitted().record, model)
    text = [linear.describe() + "."]
    if orders:
        text.append(
            "Singular values are the correlations of the past with the future of the outputs: a "
            "state for each that stands out. The order is the smallest whose held-out simulation "
            "error is at most one standard error above the least."
        )
    if responses:
        text.append("Shaded: the 95 % interval of the gain, by its standard error.")
    return Section("linear", "Linear model: order and frequency response", text,
                   plots=[*orders, *responses], folded=True)  # fmt: skip


def _orders(model: LinearModel) -> list[Plot]:
    """Return plots over the order; none of outputs with different delays, modelled one by one."""
    most = min(max(model.orders, default=2 * model.order), len(model.values))
    error = 100 * model.held_out
    curves = {
        "Singular values": ("singular value", np.arange(1.0, most + 1), model.values[:most]),
        "Held-out simulation error": (
            "RMSE (% of the deviation)",
            np.array(model.orders, float),
            error,
        ),
    }
    return [
        _over_order(title, label, orders, values, model.order)
        for title, (label, orders, values) in curves.items()
        if len(orders) > 1
    ]


def _over_order(title: str, label: str, orders: Array, values: Array, chosen: int) -> Plot:
    shown = np.maximum(values, 1e-9 * values.max())
    chart = Chart(Axis.over(orders, "order"), label, _around(shown), SMALL, log=True)
    chart.line(shown, "c0", title, line_width=1.5)
    chart.mark(chosen)
    pairs = zip(orders, shown, strict=True)
    said = ", ".join(f"{int(order)}: {number(float(value))}" for order, value in pairs)
    says = (
        f"Line plot of the {label} by order, with a logarithmic axis; {chosen} is chosen, dashed. "
        f"{said}."
    )
    return chart.plot(f"{title}; dashed: the order {chosen}", says, small=True)


def _responses(record: Record, model: LinearModel) -> list[Plot]:
    """Return a plot of the gain over frequency for each input and output."""
    found = model.accuracy
    if found is None:
        return []
    axis = Axis.over_frequency(found.angles / (2 * np.pi * record.sampling_time), "Hz")
    plots = []
    for i, name in enumerate(record.inputs):
        for j, column in enumerate(record.columns):
            gain, error = found.response[:, j, i], LEVEL * found.response_errors[:, j, i]
            title = f"Gain, {name} to {column}"
            if not (np.isfinite(gain) & (gain > 0)).all():
                continue
            low, high = _around(gain)
            chart = Chart(axis, "gain", (low, high), SMALL, log=True)
            if np.isfinite(error).all():
                chart.band(np.maximum(gain - error, 0.1 * low), gain + error, _STYLE)
            chart.method(gain, _STYLE, line_width=1.5)
            least, most = (number(float(100 * f(error / gain))) for f in (np.min, np.max))
            says = (
                f"{title}: line plot over frequency in Hz, both axes logarithmic, from "
                f"{number(float(gain[0]))} to {number(float(gain[-1]))}; the 95 % interval is "
                f"± {least} to {most} % of the gain."
            )
            plots.append(chart.plot(title, says, small=True))
    return plots


def _around(values: Array) -> tuple[float, float]:
    """Return limits of a logarithmic axis."""
    return 0.7 * float(values.min()), 1.5 * float(values.max())

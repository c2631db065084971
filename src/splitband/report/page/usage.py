"""How to use the recommended method, in lines of Python."""

from __future__ import annotations

import ast
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace

from splitband.data import Record
from splitband.forecasters.base import Forecaster
from splitband.report.page.parts import Code, Section

WIDTH = 88
"""Characters in a line of Python."""


@dataclass(frozen=True)
class Usage:
    """What only the caller knows of how a comparison was asked for.

    Attributes
    ----------
    commands : To use the recommended method from a shell, each with what it does.
    reading : The line of Python that reads the record; empty: it was made in a program.
    asked : The command that made the page.
    more : The Python expressions that read the further records it was trained on.
    """

    commands: Sequence[tuple[str, str]] = ()
    reading: str = ""
    asked: str = ""
    more: Sequence[str] = ()


def section(
    forecaster: Forecaster, record: Record, usage: Usage, steps: int, others: bool = False
) -> Section:
    """Return the lines of Python that fit it to all of a record.

    `others` says whether it was trained on further records, too.
    """
    if others and not usage.more:
        usage = replace(usage, more=["..."])
    code = Code("Fit it to the whole record, and predict", python(forecaster, record, usage, steps))
    return Section("use", "In Python", code=[code])


def python(forecaster: Forecaster, record: Record, usage: Usage, steps: int) -> str:
    """Fit it to the whole record, predict, save."""
    lines = ["import splitband as sb", ""]
    lines.append(usage.reading or "record = ...  # the one of this page, an sb.Record")
    if record.y_sim is not None and usage.reading:
        lines.append(
            "# dataclasses.replace(record, y_sim=...) puts the simulator's output beside it"
        )
    if usage.more:
        lines += ["more = [", *(f"    {each}," for each in usage.more), "]"]
    known = ", u=inputs_to_come" if record.nu else ""
    if "simulator" in forecaster.needs:
        known += ", y_sim=simulated"
    lines += [
        *_making(forecaster),
        "model.fit(record, *more)" if usage.more else "model.fit(record)",
        f"prediction = model.predict({steps}{known}, level=0.9)",
        "prediction.to_frame()  # values and interval, with their times",
        'model.save("model")',
        f'sb.load("model").predict({steps}, history=later_record{known})',
    ]
    return "\n".join(lines)


def _making(forecaster: Forecaster) -> list[str]:
    """The lines that make the forecaster, broken where Python allows it."""
    line = f"model = {forecaster!r}"
    lines = textwrap.wrap(
        line, WIDTH, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
    )
    try:
        ast.parse("\n".join(lines))
    except SyntaxError:  # broken within a text
        return [line]
    return lines

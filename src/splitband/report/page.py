"""A comparison as one HTML file to look at and send on: it loads nothing from elsewhere."""

from __future__ import annotations

import base64
import html
import io
from pathlib import Path

from matplotlib.figure import Figure

from splitband.evaluation.api import Comparison
from splitband.filters.spectrum import periodogram
from splitband.report import pictures
from splitband.report.results import environment
from splitband.runtime.files import replacing

_STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .7rem; border-bottom: 1px solid #8884; text-align: right; }
th:first-child, td:last-child { text-align: left; }
tr.recommended { font-weight: 600; }
figure { margin: 2rem 0; } img { max-width: 100%; background: white; }
.wide { overflow-x: auto; }
"""


def write(comparison: Comparison, path: str | Path) -> None:
    """Write the page, whole or not at all: summary, table, pictures, settings and versions."""
    record, setup, trial = comparison.record, comparison.setup, comparison.require_trial()
    best = comparison.recommended
    spectrum = periodogram(record[: setup.train].y, record.sampling_rate)
    drawn = [
        ("Free runs from the start, and forecasts with their intervals", comparison.plot()),
        ("Errors over time", pictures.errors(comparison)),
        ("Spectrum of the training samples, and the cut-off",
         pictures.spectrum(record, spectrum, setup.bands.cutoff, setup.bands.choice)),
    ]  # fmt: skip
    if any(runs[0].from_start.components for runs in comparison.runs.values()):
        drawn.append(("What the models of several parts add up", pictures.components(comparison)))
    title = html.escape(f"splitband: {record.name or 'a record'}")
    versions = environment()["versions"]
    parts = [
        f"<h1>{title}</h1>",
        f"<p>Recommended: <strong>{html.escape(best)}</strong>, for its forecast of the last "
        f"quarter of the {setup.train} training samples (RMSE {trial.errors[best]:.3g}) and for "
        f"how little its forecast of what follows changed after that ({trial.change(best):.3g}). "
        f"RMSE are in the record's unit.</p>",
        _table(comparison),
        *(_figure(caption, figure) for caption, figure in drawn),
        "<h2>Settings</h2>",
        f"<p>{html.escape(str(setup.settings))}</p>",
        f"<p>{html.escape(setup.bands.choice.reason if setup.bands.choice else '')}</p>",
        f"<p>{html.escape(', '.join(f'{name} {v}' for name, v in versions.items()))}</p>",
    ]
    text = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>'
        f"<body><main>{''.join(parts)}</main></body></html>\n"
    )
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _table(comparison: Comparison) -> str:
    """The table of the comparison, the recommended row in bold."""
    table = comparison.table.drop(columns="recommended")
    head = "".join(f'<th scope="col">{html.escape(name)}</th>' for name in table.columns)
    rows = []
    for name, row in table.iterrows():
        cells = "".join(f"<td>{html.escape(_cell(value))}</td>" for value in row)
        mark = ' class="recommended"' if name == comparison.recommended else ""
        rows.append(f'<tr{mark}><th scope="row">{html.escape(str(name))}</th>{cells}</tr>')
    return (
        f'<div class="wide"><table><thead><tr><th scope="col">method</th>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if value != value else f"{value:.3g}"  # noqa: PLR0124  NaN: nothing to show
    return str(value)


def _figure(caption: str, figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    data = base64.b64encode(buffer.getvalue()).decode()
    text = html.escape(caption)
    return (
        f'<figure><figcaption>{text}</figcaption><img alt="{text}" '
        f'src="data:image/png;base64,{data}"></figure>'
    )

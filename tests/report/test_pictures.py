"""`.plot()`: panels, titles, and names that matplotlib must not read as formulas."""

from __future__ import annotations

import io

from tests.report import comparisons


def test_every_prediction_has_a_panel_with_its_fit() -> None:
    """A row for each of four methods, the recommended one first, and a column for each output."""
    found = comparisons.everything()
    figure = found.plot()
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert len(titles) == 4 * 2
    shown = found.table["forecast fit %, angle (rad)"][found.recommended]
    assert titles[0].endswith(f": fit {shown:.1f} %")
    assert str(figure.get_suptitle()).endswith(": simulation after the training part")
    figure.savefig(io.BytesIO(), format="png", dpi=20)


def test_a_prediction_has_its_interval() -> None:
    found = comparisons.compared(comparisons.record(), ("mean",)).predictions["mean"]
    (ax,) = found.plot().axes
    legend = ax.get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["prediction", "90 % interval"]

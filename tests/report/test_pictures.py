"""`.plot()`: panels, titles, and names that matplotlib must not read as formulas."""

from __future__ import annotations

import io

from tests.report import comparisons


def test_every_prediction_has_a_panel_with_its_fit() -> None:
    """Two outputs: the forecast and a test record large, three other methods small."""
    found = comparisons.everything()
    figure = found.plot()
    titles = [ax.get_title(loc="left") for ax in figure.axes if ax.get_title(loc="left")]
    large = [title for title in titles if "\n" not in title]
    forecast, test = "simulation after the training part", "simulation of the test record later"
    assert [title.split(":")[0] for title in large] == [forecast] * 2 + [test] * 2
    shown = found.table["forecast fit %, angle (rad)"][found.recommended]
    assert f"fit {shown:.1f} %, RMSE" in large[0]
    assert len(titles) == 4 + 3 * 2
    figure.savefig(io.BytesIO(), format="png", dpi=20)


def test_a_prediction_has_its_interval() -> None:
    found = comparisons.compared(comparisons.record(), ("mean",)).predictions["mean"]
    (ax,) = found.plot().axes
    legend = ax.get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["prediction", "90 % interval"]

"""Draw the figures of these pages: `python docs/theory/figures.py`.

They are made of the package's own filters and systems and of the result files, and are committed,
so that a viewer of the repository shows them too.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import splitband as sb
from splitband.metrics import cumulative_rmse
from splitband.records.named import double_mass_spring, van_der_pol

HERE = Path(__file__).resolve().parent
RESULTS = HERE.parent / "results"
TRAIN = 600
"""Samples of system (v) that are trained on."""

Array = npt.NDArray[np.float64]


def _panels(count: int, height: float = 3.0, **options: Any) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(9, height), layout="constrained")
    return figure, [*np.ravel(figure.subplots(1, count, **options))]


def pair() -> Figure:
    """How far one-way pairs are from adding up."""
    figure, (axes,) = _panels(1)
    freqs = np.geomspace(1e-3, 10, 400)
    for order in (1, 2, 3):
        one_way = sb.ComplementaryPair.butterworth(0.25, 20, order=order, zero_phase=False)
        wrong = abs(np.sum(one_way.response(freqs), axis=0) - 1)
        # The first order's is zero and lies below that of the perfect pair.
        style: dict[str, Any] = {"lw": 5, "alpha": 0.5} if order == 1 else {}
        axes.semilogx(freqs, wrong, label=f"Butterworth pair, order {order}", **style)
    two = sb.ComplementaryPair.butterworth(0.25, 20, order=2)
    perfect = sb.ComplementaryPair.perfect(two.b_low, two.a, 20).response(freqs)
    wrong = abs(np.sum(perfect, axis=0) - 1)
    axes.semilogx(freqs, wrong, "k--", lw=1, label="perfect pair, order 2")
    axes.set(ylabel="|L + H - 1|, one way", xlabel="frequency (Hz)")
    axes.axvline(0.25, color="0.7", lw=1, zorder=0)
    axes.legend()
    return figure


def bands() -> Figure:
    """Gains of a pair; the two bands of system (i), and the samples of the slower network."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    gains, axes = figure.subplots(1, 2, width_ratios=(1, 1.7))
    record = double_mass_spring(samples=1000)
    assert record.y_true is not None
    y = record.y_true[:, 0]
    split = sb.ComplementaryPair.butterworth(record.sampling_rate * 0.02, record.sampling_rate)
    freqs = np.geomspace(1e-3, 5, 400)
    low, high = split.response(freqs)
    gains.semilogx(freqs, low, label="low-pass L")
    gains.semilogx(freqs, high, label="high-pass H")
    gains.semilogx(freqs, low + high, "k--", lw=1, label="L + H")
    gains.set(ylim=(0, 1.1), xlabel="frequency (Hz)", ylabel="gain")
    low, high = split.split(y)
    shown = slice(100, 300)
    axes.plot(record.time[shown], y[shown], "k", lw=1, label="record y")
    axes.plot(record.time[shown], low[shown], label="low band L(y)")
    kept = slice(100, 300, 5)
    axes.plot(record.time[kept], low[kept], "C0o", ms=4, label="every fifth sample")
    axes.plot(record.time[shown], high[shown], "C1", lw=1, label="high band H(y)")
    axes.set(xlabel="time (s)")
    for each, columns in ((gains, 2), (axes, 4)):
        each.legend(ncols=columns, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    return figure


def drift() -> Figure:
    """Errors up to a time of free runs on system (v), by the committed runs."""
    figure, (axes,) = _panels(1)
    record = van_der_pol()
    assert record.y_sim is not None
    warmup = len(record) - len(_run("v/gru/seed0")["from_start"][0])
    time, truth = record.time[warmup:], record.truth[warmup:, 0]
    for seed in range(5):
        y = np.asarray(_run(f"v/gru/seed{seed}")["from_start"][0])
        label = "GRU alone, five seeds" if seed == 0 else None
        axes.plot(time, cumulative_rmse(truth, y), "C3", lw=1, label=label)
    y_sim = record.y_sim[warmup:, 0]
    axes.plot(time, cumulative_rmse(truth, y_sim), "C0", lw=2, label="simulator")
    axes.axvline(record.time[TRAIN], color="0.5", ls=":", label="end of the training samples")
    axes.set(xlabel="time (s)", ylabel="RMSE up to then", ylim=(0, None))
    axes.legend()
    return figure


def _run(name: str) -> dict[str, Any]:
    run: dict[str, Any] = json.loads((RESULTS / "runs" / f"{name}.json").read_text("utf-8"))
    return run


def calibration() -> Figure:
    """System (v)'s simulator at the beginning and the end of the record, before and after."""
    figure, panels = _panels(2, sharey=True)
    record = van_der_pol()
    assert record.y_sim is not None
    fitted = sb.Calibrated().fit(record[:TRAIN])
    calibrated = fitted.on(record).y_sim
    assert calibrated is not None
    titles = ("at the beginning", "at the end")
    for axes, begin, title in zip(panels, (0, 1700), titles, strict=True):
        shown = slice(begin, begin + 300)
        axes.plot(record.time[shown], record.y[shown, 0], "k", lw=1.2, label="record")
        axes.plot(record.time[shown], record.y_sim[shown, 0], "C0--", label="simulator")
        axes.plot(record.time[shown], calibrated[shown, 0], "C2", label="calibrated")
        axes.set(title=title, xlabel="time (s)")
    panels[0].set_ylabel("y")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def trap() -> Figure:
    """What each training segment of (v) rewards: adding nothing, or being exactly right."""
    figure, panels = _panels(2, sharey=True)
    segments = json.loads((RESULTS / "segments/segments.json").read_text("utf-8"))
    at = np.arange(len(segments))
    for axes, prefix, title in zip(
        panels, ("", "calibrated "), ("unmodified simulator", "simulator calibrated"), strict=True
    ):
        for shift, name in ((-0.2, "nothing learned"), (0.2, "exactly right")):
            heights = [of[prefix + name] for of in segments.values()]
            axes.bar(at + shift, heights, 0.4, label=name)
        axes.set_xticks(at, [*segments], rotation=20)
        axes.set(title=title, xlabel="samples that are trained on")
    panels[0].set(ylabel="training loss (RMSE)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def growth() -> Figure:
    """Half-widths of intervals by the exponent of the horizon."""
    figure, (axes,) = _panels(1)
    horizon = np.arange(1, 301)
    for exponent, name in ((0.0, "0: no growth"), (0.5, "0.5: a random walk"), (1.0, "1: a drift")):
        axes.plot(horizon, horizon**exponent, label=name)
    axes.set(xlabel="horizon (samples)", ylabel="half-width, over the first one")
    axes.set(ylim=(0, 40))
    axes.legend(title="exponent")
    return figure


def timeline() -> Figure:
    """What the parts of a record, and of a test record, are used for."""
    figure, (axes,) = _panels(1, 3.4)
    last = "simulated, compared"
    rows: dict[str, list[tuple[float, float, str, str]]] = {
        "choice\n(a trial model)": [(0, 45, "fitted", "C0"), (45, 60, "held out", "C1")],
        "result\n(the final model)": [(0, 60, "training part", "C0"), (60, 100, last, "C2")],
        "a test record": [(0, 8, "", "0.6"), (8, 70, last, "C2")],
    }
    for height, parts in zip((2, 1, 0), rows.values(), strict=True):
        for begin, end, text, colour in parts:
            axes.barh(height, end - begin, 0.5, begin, color=colour, alpha=0.45, ec="0.3")
            axes.text((begin + end) / 2, height, text, ha="center", va="center")
        at = parts[0][1]
        axes.plot([at, at], [height - 0.33, height + 0.33], "k", lw=2)
        axes.text(at, height + 0.36, "origin", ha="center", va="bottom", fontsize=9)
        axes.plot([at - 8, at], [height - 0.31] * 2, "0.3", lw=4, solid_capstyle="butt")
        axes.text(at - 4, height - 0.38, "warm-up", ha="center", va="top", fontsize=9)
    axes.set(yticks=(2, 1, 0), yticklabels=rows, ylim=(-0.6, 2.7), xlim=(-1, 101))
    axes.set(xticks=[], xlabel="time")
    axes.spines[["left"]].set_visible(False)
    axes.tick_params(left=False)
    return figure


def scheme() -> Figure:
    """Both methods of the paper, as boxes: what is filtered, what is trained, what is added."""
    figure, (left, right) = _panels(2, height=4.6)
    train, add, signal = "#d7e6f7", "#e8e8e8", "white"
    _boxes(
        left,
        "Split: two networks",
        {
            "y": (0.5, 0.92, "training record y (Eq. 10, training)", signal),
            "L": (0.22, 0.74, "low-pass L", add),
            "H": (0.78, 0.74, "high-pass H", add),
            "d": (0.22, 0.56, "every k-th sample, $d_k$", add),
            "slow": (0.22, 0.38, "slow network\ntrained on $d_k$(L(y))", train),
            "fast": (0.78, 0.38, "fast network\ntrained on H(y)", train),
            "u": (0.22, 0.20, "interpolated, $u_k$", add),
            "sum": (0.5, 0.04, "sum: the prediction (Eq. 11, prediction)", signal),
        },
        ["y-L", "y-H", "L-d", "d-slow", "H-fast", "slow-u", "u-sum", "fast-sum"],
    )
    _boxes(
        right,
        "Hybrid: simulator and network",
        {
            "sim": (0.22, 0.83, "simulator\n(black box)", signal),
            "net": (0.78, 0.83, "network\ntrained through H", train),
            "L": (0.22, 0.56, "low-pass L", add),
            "H": (0.78, 0.56, "high-pass H", add),
            "sum": (0.5, 0.30, "sum: the prediction", signal),
            "y": (0.5, 0.04, "RMSE to the record y (Eq. 12, hybrid loss)", add),
        },
        ["sim-L", "net-H", "L-sum", "H-sum", "sum-y"],
    )
    return figure


def _boxes(
    axes: Axes, title: str, boxes: dict[str, tuple[float, float, str, str]], arrows: list[str]
) -> None:
    axes.set(title=title, xlim=(-0.05, 1.05), ylim=(-0.06, 1.0))
    axes.axis("off")
    middle: dict[str, Any] = {"ha": "center", "va": "center"}
    box = {"boxstyle": "round,pad=0.4", "ec": "0.4"}
    drawn = {
        name: axes.text(x, y, text, fontsize=9, bbox={**box, "fc": colour}, **middle)
        for name, (x, y, text, colour) in boxes.items()
    }
    for arrow in arrows:
        begin, end = arrow.split("-")
        ends = {"patchA": drawn[begin].get_bbox_patch(), "patchB": drawn[end].get_bbox_patch()}
        style = {"arrowstyle": "->", "color": "0.4", "shrinkA": 4, "shrinkB": 4, **ends}
        axes.annotate("", xy=boxes[end][:2], xytext=boxes[begin][:2], zorder=0, arrowprops=style)


FIGURES: tuple[Callable[[], Figure], ...] = (
    *(pair, bands, drift, calibration, trap, growth, timeline, scheme),
)


def main() -> None:
    """Write each figure beside this file."""
    mpl.rcParams.update({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False})
    for draw in FIGURES:
        draw().savefig(HERE / f"{draw.__name__}.png", dpi=140)


if __name__ == "__main__":
    main()

"""Simulated decays over the measured one (Fig. 2 to 4 of the paper)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from modalcam.report.compared import ModelDecay, model_colour, model_label, model_name
from modalcam.report.decimate import min_max
from modalcam.report.figures.axes import dots, few_ticks, trace
from modalcam.report.format import percent
from modalcam.report.palette import COLUMNS, MEASURED, figure_style, new_figure
from modalcam.report.svg import FigureView, figure_view
from modalcam.report.text import channel_label, figure_label

FloatArray = NDArray[np.float64]

_CYCLES = 4.0


def simulated_figure(
    figure_id: str, models: tuple[ModelDecay, ...], *, channel: str, unit: str, frequency_hz: float
) -> FigureView | None:
    """One row a model: the whole decay, and a few cycles late in it; None where no model was simulated."""
    rows = [model for model in models if np.isfinite(model.simulated).any() and model.time_s.size > 1]
    if not rows:
        return None
    with figure_style(figure_id):
        figure = new_figure(0.45 + 1.75 * len(rows))
        grid = figure.subplots(len(rows), 2, squeeze=False, sharey="row", width_ratios=(3, 1))
        for (whole, late), model in zip(grid, rows, strict=True):
            _decay(whole, model, COLUMNS * 2 // 3)
            end = float(model.time_s[-1])
            begin = max(float(model.time_s[0]), model.time_s[0] + 0.6 * (end - model.time_s[0]))
            span = min(_CYCLES / frequency_hz, end - begin)
            inside = (model.time_s >= begin) & (model.time_s <= begin + span)
            _late(late, model, inside)
            whole.set_title(
                f"{model_label(model.model)} (misses by {percent(model.nrmse)} of the measured rms)"
            )
            late.set_title("late, close up", fontweight="normal")
            few_ticks(whole, x=8)
            few_ticks(late, x=3)
        for axes in grid[-1]:
            axes.set_xlabel("time (s)")
        figure.supylabel(f"displacement of {channel_label(channel)} ({figure_label(unit)})", fontsize=8.5)
        grid[0, 0].legend(loc="upper right", ncols=3, borderaxespad=0.0)
        names = " and ".join(model_name(model.model) for model in rows)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Simulated decay over the measured one",
            alt=f"Measured displacement of {channel} against time with the decay simulated with {names}.",
            caption="Grey is measured, colour is simulated from the state fitted at the start, the pale band its 90 % "
            "interval from the posterior. Where the coloured decay dies away sooner than the grey one, the model "
            "damps this mode too much. The panels on the right show whether it keeps in step.",
        )


def _decay(axes: Axes, model: ModelDecay, columns: int) -> None:
    colour = model_colour(model.model)
    trace(axes, model.time_s, model.measured, MEASURED, columns=columns, width=0.9, label="measured")
    _band(axes, model, slice(None), columns)
    trace(
        axes, model.time_s, model.simulated, colour, columns=columns, width=0.7, alpha=0.8, label="simulated"
    )
    axes.set_xlim(model.time_s[0], model.time_s[-1])


def _late(axes: Axes, model: ModelDecay, inside: NDArray[np.bool_]) -> None:
    t = model.time_s[inside]
    dots(axes, t, model.measured[inside], MEASURED, 2.2)
    _band(axes, model, inside, COLUMNS)
    trace(axes, t, model.simulated[inside], model_colour(model.model), width=1.2)


def _band(axes: Axes, model: ModelDecay, part: slice | NDArray[np.bool_], columns: int) -> None:
    if model.low is None or model.high is None:
        return
    t = model.time_s[part]
    low_t, low = min_max(t, model.low[part], columns)
    if low_t.size == t.size:
        axes.fill_between(t, low, model.high[part], color=model_colour(model.model), alpha=0.25, linewidth=0)

"""Simulated decays over the measured one (Fig. 2 to 4 of the paper)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from modalcam.report.derived.model_decays import ModelDecay, model_colour, model_label, model_name
from modalcam.report.figures.axes import dots, few_ticks, trace
from modalcam.report.style.format import percent
from modalcam.report.style.palette import COLUMNS, MEASURED, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from modalcam.report.style.text import channel_label, figure_label
from tracker.arrays import FloatArray

_CYCLES = 4.0
# of the outline of a band
_BAND_POINTS = 120


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
            _decay(whole, model, COLUMNS // 2)
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
            caption="Grey is measured, colour is simulated from the state fitted at the start. Where the coloured "
            "decay dies away sooner than the grey one, the model damps this mode too much. The panels on the right "
            "show whether it keeps in step: the dark band is the 90 % interval of the curve from the posterior, the "
            "pale one that of the samples, noise included.",
        )


def _decay(axes: Axes, model: ModelDecay, columns: int) -> None:
    colour = model_colour(model.model)
    trace(axes, model.time_s, model.measured, MEASURED, columns=columns, width=0.9, label="measured")
    trace(
        axes, model.time_s, model.simulated, colour, columns=columns, width=0.7, alpha=0.8, label="simulated"
    )
    axes.set_xlim(model.time_s[0], model.time_s[-1])


def _late(axes: Axes, model: ModelDecay, inside: NDArray[np.bool_]) -> None:
    t = model.time_s[inside]
    dots(axes, t, model.measured[inside], MEASURED, 2.2)
    every = slice(None, None, max(1, t.size // _BAND_POINTS))
    _fill(axes, t[every], model.sample_low[inside][every], model.sample_high[inside][every], model, 0.12)
    if model.low is not None and model.high is not None:
        _fill(axes, t[every], model.low[inside][every], model.high[inside][every], model, 0.35)
    trace(axes, t, model.simulated[inside], model_colour(model.model), width=1.0, columns=COLUMNS // 3)


def _fill(
    axes: Axes, t: FloatArray, low: FloatArray, high: FloatArray, model: ModelDecay, alpha: float
) -> None:
    good = np.isfinite(low) & np.isfinite(high)
    if np.count_nonzero(good) > 1:
        axes.fill_between(
            t[good], low[good], high[good], color=model_colour(model.model), alpha=alpha, linewidth=0
        )

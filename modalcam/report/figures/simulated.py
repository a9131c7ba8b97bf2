"""Simulated decays over the measured one (Fig. 2 to 4 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from modalcam.report.figures.base import FigureKind, RecordingSubject
from modalcam.report.signals import drawn_decays
from modalcam.report.style import (
    COLUMNS,
    MEASURED,
    channel_label,
    dots,
    few_ticks,
    figure_label,
    percent,
    share_time,
    trace,
)
from sim.comparison import DecayComparison, ModelDecay
from sim.damping import DAMPING_MODELS
from tracker import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CYCLES = 4.0
# Points of the outline of a band.
_BAND_POINTS = 120


@dataclass(frozen=True)
class SimulatedShown:
    """Simulated decays of a comparison in one of its channels; `models` are those that are drawn."""

    comparison: DecayComparison
    models: tuple[ModelDecay, ...]
    channel: int


def simulated_shown(comparison: DecayComparison, channel: str) -> SimulatedShown | None:
    """Decays of `comparison` to draw in a channel; None where no model was simulated."""
    models = tuple(d for d in drawn_decays(comparison) if np.isfinite(d.simulated).any())
    if not models or comparison.time_s.size < 2:
        return None
    if channel in comparison.channels:
        index = comparison.channels.index(channel)
    else:
        # The one that moves most.
        index = int(np.argmax(np.std(np.nan_to_num(comparison.measured), axis=0)))
    return SimulatedShown(comparison, models, index)


def _shows(subject: RecordingSubject) -> SimulatedShown | None:
    target, comparison = subject.target(), subject.recording.comparison
    if target is None or not isinstance(comparison, DecayComparison):
        return None
    return simulated_shown(comparison, target.found.series.channels[target.channel])


def _draw(figure: Figure, shown: SimulatedShown) -> None:
    comparison, k, count = shown.comparison, shown.channel, len(shown.models)
    time_s = comparison.time_s
    measured = np.where(comparison.used[:, k], comparison.measured[:, k], np.nan)
    late_s = float(time_s[0] + 0.6 * (time_s[-1] - time_s[0]))
    late = (time_s >= late_s) & (time_s <= late_s + _CYCLES / comparison.frequency_hz)
    figure.set_figheight(0.45 + 1.75 * count)
    grid = figure.subplots(count, 2, squeeze=False, sharey="row", width_ratios=(3, 1))
    for (left, right), decay in zip(grid, shown.models, strict=True):
        model, simulated = DAMPING_MODELS[decay.model], decay.simulated[:, k]
        colour = model.colour
        # Wide and pale below: seen also where the simulation agrees.
        trace(left, time_s, measured, MEASURED, columns=COLUMNS // 2, width=3.0, alpha=0.5, label="measured")
        trace(left, time_s, simulated, colour, columns=COLUMNS // 2, width=0.8, label="simulated")
        left.set_xlim(time_s[0], time_s[-1])
        left.set_title(f"{model.label} (nrmse {percent(decay.nrmse)})")
        few_ticks(left)
        dots(right, time_s[late], measured[late], MEASURED, 2.8)
        low, high = decay.predictive_band
        _band(right, time_s, low[:, k], high[:, k], late, colour, 0.12)
        if decay.band_low is not None and decay.band_high is not None:
            _band(right, time_s, decay.band_low[:, k], decay.band_high[:, k], late, colour, 0.35)
        trace(right, time_s[late], simulated[late], colour, width=1.0, columns=COLUMNS // 3)
        right.set_title("late decay, detail", fontweight="normal")
        few_ticks(right, x=3)
    for column in grid.T:
        share_time(column)
        column[-1].set_xlabel("time (s)")
    label = f"displacement of {channel_label(comparison.channels[k])} ({figure_label(comparison.unit)})"
    figure.supylabel(label, fontsize=8.5, x=0.008)
    grid[0, 0].legend(ncols=3)


def _band(
    axes: Axes,
    time_s: FloatArray,
    low: FloatArray,
    high: FloatArray,
    inside: NDArray[np.bool_],
    colour: str,
    alpha: float,
) -> None:
    picks = np.flatnonzero(inside)[:: max(1, np.count_nonzero(inside) // _BAND_POINTS)]
    picks = picks[np.isfinite(low[picks]) & np.isfinite(high[picks])]
    if picks.size > 1:
        axes.fill_between(time_s[picks], low[picks], high[picks], color=colour, alpha=alpha, linewidth=0)


SIMULATED = FigureKind("simulated", "recording", _shows, _draw, essential=True)

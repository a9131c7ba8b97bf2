"""Spectrum of the decay before the fit, and of the residual."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from modalcam.report.derived.signals import amplitude_spectrum, highest, residual
from modalcam.report.figures.base import FigureKind, RecordingSubject, Target
from modalcam.report.style.axes import few_ticks, log_y
from modalcam.report.style.palette import FIT, INK, MEASURED
from modalcam.report.style.safe_text import figure_label

_COLUMNS = 400


def _draw(figure: Figure, shown: Target) -> bool:
    found, _, channel = shown
    series = found.series
    # The fit replaces missing samples: a gap in a decaying record would spread its line over the whole axis.
    shown_values = np.where(found.used[:, channel], series.values[:, channel], found.fitted[:, channel])
    known = np.isfinite(shown_values)
    frequency, before = amplitude_spectrum(series.time_s, shown_values)
    shown_values[known] = np.nan_to_num(residual(found)[known, channel])
    _, after = amplitude_spectrum(series.time_s, shown_values)
    if frequency.size < 2 or not np.any(before > 0.0):
        return False
    floor = float(np.max(before)) * 1e-9
    axes = figure.subplots()
    for density, colour, width, label in (
        (before, MEASURED, 0.8, "measured, after the onset"),
        (after, INK, 0.9, "residual of the fit"),
    ):
        f, d = highest(frequency, np.maximum(density, floor), _COLUMNS)
        axes.plot(f, d, color=colour, linewidth=width, label=label)
    for k, mode in enumerate(found.modes):
        label = "_" if k else "identified modes"
        axes.axvline(mode.frequency_hz, color=FIT, linewidth=0.8, linestyle=(0, (3, 2)), label=label)
    few_ticks(axes, x=7)
    log_y(axes)
    axes.set(
        xlabel="frequency (Hz)",
        ylabel=f"density ({figure_label(series.unit)}/√Hz)",
        xlim=(0.0, frequency[-1]),
    )
    axes.legend()
    return True


SPECTRUM = FigureKind("spectrum", "recording", RecordingSubject.target, _draw)

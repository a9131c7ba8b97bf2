"""Spectrum of the decay before the fit, and of the residual."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from modalcam.report.derived.signals import amplitude_spectrum, highest, residual
from modalcam.report.figures.axes import few_ticks, log_y
from modalcam.report.figures.base import FigureKind, RecordingSubject, Target
from modalcam.report.style.palette import FIT, INK, MEASURED
from modalcam.report.style.text import figure_label

_COLUMNS = 400


def _draw(figure: Figure, shown: Target) -> bool:
    found, _, channel = shown
    series = found.series
    # The fit replaces missing samples: a gap in a decaying record would spread its line over the whole axis.
    whole = np.where(found.used[:, channel], series.values[:, channel], found.fitted[:, channel])
    frequency, before = amplitude_spectrum(series.time_s, whole)
    left = np.where(np.isfinite(whole), np.nan_to_num(residual(found)[:, channel]), np.nan)
    _, after = amplitude_spectrum(series.time_s, left)
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
    axes.set_xlim(0.0, frequency[-1])
    few_ticks(axes, x=10)
    log_y(axes)
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"density ({figure_label(series.unit)}/√Hz)")
    axes.legend(loc="upper right", borderaxespad=0.2)
    return True


SPECTRUM = FigureKind(
    key="spectrum",
    place="recording",
    title="Spectrum before and after the fit",
    shows=RecordingSubject.target,
    draw=_draw,
    alt=lambda shown: (
        f"Spectral density of channel {shown.channel_name} against frequency, of the measured decay and "
        "of the residual, with the identified modes marked."
    ),
    caption="The residual should be flat and free of lines. A line at an identified mode means that its decay is not "
    "purely exponential; a line elsewhere is a mode or a disturbance that was not modelled. The fitted value replaces "
    "each missing sample.",
)

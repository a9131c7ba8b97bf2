"""Spectrum of the decay and of what the fit leaves of it."""

from __future__ import annotations

import numpy as np

from modal_id.results import Identification
from modalcam.report.derived.signals import amplitude_spectrum, highest, residual, shown_channel
from modalcam.report.figures.axes import few_ticks, log_y
from modalcam.report.style.palette import FIT, INK, MEASURED, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from modalcam.report.style.text import figure_label

_COLUMNS = 400


def spectrum_figure(figure_id: str, found: Identification) -> FigureView | None:
    """Densities before and after the fit, modes marked; None where too few samples are left."""
    channel, series = shown_channel(found), found.series
    used = found.used[:, channel]
    # A gap in a ringing record would spread the line over the whole axis; the fit stands in for what is missing.
    whole = np.where(used, series.values[:, channel], found.fitted[:, channel])
    frequency, before = amplitude_spectrum(series.time_s, whole)
    left = np.where(np.isfinite(whole), np.nan_to_num(residual(found)[:, channel]), np.nan)
    _, after = amplitude_spectrum(series.time_s, left)
    if frequency.size < 2 or not np.any(before > 0.0):
        return None
    floor = float(np.max(before)) * 1e-9
    with figure_style(figure_id):
        figure = new_figure(2.5)
        axes = figure.subplots()
        for density, colour, width, label in (
            (before, MEASURED, 0.8, "measured, after the onset"),
            (after, INK, 0.9, "residual of the fit"),
        ):
            f, d = highest(frequency, np.maximum(density, floor), _COLUMNS)
            axes.plot(f, d, color=colour, linewidth=width, label=label)
        for mode in found.modes:
            axes.axvline(mode.frequency_hz, color=FIT, linewidth=0.8, linestyle=(0, (3, 2)))
        axes.plot([], [], color=FIT, linewidth=0.8, linestyle=(0, (3, 2)), label="identified modes")
        axes.set_xlim(0.0, frequency[-1])
        few_ticks(axes, x=10)
        log_y(axes)
        axes.set_xlabel("frequency (Hz)")
        axes.set_ylabel(f"density ({figure_label(series.unit)}/√Hz)")
        axes.legend(loc="upper right", borderaxespad=0.2)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Spectrum before and after the fit",
            alt=f"Spectral density of channel {series.channels[channel]} against frequency, of the measured decay and "
            "of the residual, with the identified modes marked.",
            caption="The residual should be flat and without lines. A line left at an identified mode means that its "
            "decay is not a pure exponential; a line elsewhere is a mode or a disturbance that was "
            "not modelled. Missing samples count as fitted.",
        )

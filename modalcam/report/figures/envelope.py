"""Amplitude against time on a logarithmic axis: a constant damping ratio is a straight line."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from modal_id.results import Identification, IdentifiedMode
from modalcam.report.derived.signals import measured_envelope, shown_channel, shown_mode
from modalcam.report.figures.axes import dots, few_ticks, log_y
from modalcam.report.style.palette import ALERT, FIT, MEASURED, MUTED, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from modalcam.report.style.text import figure_label
from tracker.arrays import FloatArray


def envelope_figure(figure_id: str, found: Identification) -> FigureView | None:
    """Envelope of the mode shown, in the channel that moves most; None where there is nothing to draw."""
    mode = shown_mode(found)
    if mode is None:
        return None
    channel = shown_channel(found)
    time_s, amplitude = measured_envelope(found, mode, channel)
    positive = amplitude > 0.0
    time_s, amplitude = time_s[positive], amplitude[positive]
    start_size = float(np.abs(mode.shape[channel]))
    if time_s.size < 3 or start_size == 0.0:
        return None
    start = found.onset.fit_from_s
    axis_s = np.linspace(start, float(time_s[-1]), 80)
    line = start_size * np.exp(-mode.damping_ratio * mode.omega_n_rad_s * (axis_s - start))
    noise = float(found.residual_sd[channel])
    with figure_style(figure_id):
        figure = new_figure(2.5)
        axes = figure.subplots()
        dots(axes, time_s, amplitude, MEASURED, 2.4, label="measured")
        axes.plot(
            axis_s, line, color=FIT, linewidth=1.4, label=f"fitted, ζ = {100.0 * mode.damping_ratio:.3g} %"
        )
        _bent_line(mode, axis_s, start, start_size, axes)
        if np.isfinite(noise) and noise > 0.0:
            axes.axhline(
                noise, color=MUTED, linewidth=0.9, linestyle=(0, (1, 2)), label="noise of one frame (1 sd)"
            )
        few_ticks(axes, x=10)
        log_y(axes)
        axes.set_xlabel("time (s)")
        axes.set_ylabel(f"amplitude ({figure_label(found.series.unit)})")
        figure.legend(loc="outside upper right", ncols=4, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Envelope",
            alt="Amplitude of the mode against time on a logarithmic axis in channel "
            f"{found.series.channels[channel]}, "
            "measured as dots and fitted as a line.",
            caption="On this axis one constant damping ratio is a straight line. Dots that bend away from it while "
            "still well above the noise show damping that depends on amplitude (or on the time base).",
        )


def _bent_line(mode: IdentifiedMode, axis_s: FloatArray, start: float, size: float, axes: Axes) -> None:
    dependence = mode.amplitude_dependence
    if dependence is None or not dependence.significant or dependence.zeta0 == 0.0:
        return
    # a' = -(zeta0 + zeta1 a) omega a, solved in closed form with a(0) = 1.
    decay = np.exp(-dependence.zeta0 * mode.omega_n_rad_s * (axis_s - start))
    ratio = dependence.zeta1 / dependence.zeta0
    relative = decay / (1.0 + ratio * (1.0 - decay))
    if np.all(relative > 0.0):
        axes.plot(
            axis_s,
            size * relative,
            color=ALERT,
            linewidth=1.2,
            linestyle="--",
            label="ζ depends on amplitude",
        )

"""Amplitude against time on a logarithmic axis, where a constant damping ratio is a straight line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from modal_id import IdentifiedMode
from modalcam.report.figures.base import FigureKind, RecordingSubject, Target
from modalcam.report.signals import measured_envelope
from modalcam.report.style import (
    ALERT,
    FIT,
    MEASURED,
    MUTED,
    dots,
    few_ticks,
    figure_label,
    legend_above,
    log_y,
    percent,
)
from tracker import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def _draw(figure: Figure, shown: Target) -> bool:
    found, mode, channel = shown
    time_s, amplitude = measured_envelope(found, mode, channel)
    positive = amplitude > 0.0
    initial = float(np.abs(mode.shape[channel]))
    if np.count_nonzero(positive) < 3 or initial == 0.0:
        return False
    axes = figure.subplots()
    dots(axes, time_s[positive], amplitude[positive], MEASURED, 3.4, label="measured")
    since_s = np.linspace(0.0, float(time_s[positive][-1]) - found.onset.fit_from_s, 80)
    axis_s = found.onset.fit_from_s + since_s
    fitted = initial * np.exp(-mode.damping_ratio * mode.omega_n_rad_s * since_s)
    label = f"fitted, ζ = {percent(mode.damping_ratio, 3)}"
    axes.plot(axis_s, fitted, color=FIT, linewidth=1.1, label=label)
    curved = _dependent_amplitude(mode, since_s, channel)
    if curved is not None:
        axes.plot(axis_s, curved, "--", color=ALERT, linewidth=1.2, label="ζ depends on amplitude")
    few_ticks(axes, x=7)
    drawn = np.concatenate((amplitude[positive], fitted))
    _vertical(axes, float(drawn.min()), float(drawn.max()), float(found.residual_sd[channel]))
    axes.set(xlabel="time (s)", ylabel=f"amplitude ({figure_label(found.series.unit)})")
    legend_above(figure, columns=4)
    return True


def _vertical(axes: Axes, low: float, high: float, noise_sd: float) -> None:
    """Axis and noise of one frame; of the data alone where they take less than half of the range above the noise."""
    from matplotlib.ticker import MaxNLocator, NullLocator  # noqa: PLC0415 - only to draw

    if noise_sd > 0.0 and high / low > np.sqrt(high / noise_sd):
        label = "noise of one frame (1 sd)"
        axes.axhline(noise_sd, color=MUTED, linewidth=0.9, linestyle=(0, (1, 2)), label=label)
        log_y(axes)
        return
    log_y(axes, (1.0,) if high > 30.0 * low else (1.0, 2.0, 3.0, 5.0, 7.0))
    if high < 4.0 * low:
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.yaxis.set_minor_locator(NullLocator())
    margin = max((high / low) ** 0.08, 1.01)
    axes.set_ylim(low / margin, high * margin)


def _dependent_amplitude(mode: IdentifiedMode, since_s: FloatArray, channel: int) -> FloatArray | None:
    """Amplitude of a channel by the curve, or by ``zeta0 + zeta1 a``; None unless the dependence is significant."""
    fit = mode.amplitude_dependence
    if fit is None or not fit.significant or (fit.curve is None and fit.zeta0 == 0.0):
        return None
    initial = float(np.abs(mode.shape[channel]))
    if fit.curve is not None:
        amplitude = fit.curve.decay(since_s) * initial / float(np.nanmax(np.abs(mode.shape)))
    else:
        # Solution of a' = -(zeta0 + zeta1 a) omega a with a(0) = 1.
        exponent = fit.zeta0 * mode.omega_n_rad_s * since_s
        with np.errstate(all="ignore"):
            amplitude = initial * np.exp(-exponent) / (1.0 - fit.zeta1 / fit.zeta0 * np.expm1(-exponent))
    return amplitude if np.all(amplitude > 0.0) else None


ENVELOPE = FigureKind("envelope", "recording", RecordingSubject.target, _draw)

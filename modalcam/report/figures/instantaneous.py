"""Damping ratio and frequency against amplitude, window by window, with the fitted amplitude dependence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from modalcam.report.figures.base import FigureKind, RecordingSubject, Target
from modalcam.report.signals import instantaneous
from modalcam.report.style import ALERT, FIT, MEASURED, Style, few_ticks, figure_label, legend_above
from tracker import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def _draw(figure: Figure, shown: Target) -> bool:
    found, mode, channel = shown
    seen = instantaneous(found, mode, channel)
    if seen.amplitude.size < 3:
        return False
    f, initial = mode.frequency_hz, float(np.abs(mode.shape[channel]))
    left, right = figure.subplots(1, 2)
    low, high = mode.damping_interval()
    zeta, zeta_sd = 100.0 * seen.damping_ratio, 100.0 * seen.damping_ratio_sd
    _panel(left, seen.amplitude, zeta, zeta_sd, (100.0 * low, 100.0 * high))
    low, high = mode.frequency_interval_hz()
    _panel(right, seen.amplitude, seen.frequency_hz - f, seen.frequency_sd_hz, (low - f, high - f))
    axis = np.linspace(0.0, max(initial, float(np.max(seen.amplitude))), 60)
    fit = mode.amplitude_dependence
    if fit is not None and fit.significant:
        curve = fit.curve
        if curve is not None:
            a = curve.amplitude * initial / float(np.nanmax(np.abs(mode.shape)))
            _law(left, a, 100.0 * curve.damping_ratio, 100.0 * curve.damping_ratio_sd)
            _law(right, a, curve.frequency_hz - f, curve.frequency_sd_hz)
        else:
            a = axis / initial
            zeta_sd, f_sd = (
                np.hypot(fit.zeta0_sd, fit.zeta1_sd * a),
                np.hypot(fit.f0_sd_hz, fit.f2_sd_hz * a**2),
            )
            _law(left, axis, 100.0 * (fit.zeta0 + fit.zeta1 * a), 100.0 * zeta_sd)
            _law(right, axis, fit.f0_hz + fit.f2_hz * a**2 - f, f_sd)
    left.set_ylabel("damping ratio ζ (%)")
    right.set_ylabel("frequency − fitted (Hz)")
    for axes in (left, right):
        axes.set(xlabel=f"amplitude ({figure_label(found.series.unit)})", xlim=(0.0, axis[-1]))
        few_ticks(axes, x=6)
    legend_above(figure, left.get_legend_handles_labels(), columns=3)
    return True


def _panel(axes: Axes, amplitude: Any, value: Any, sd: Any, band: tuple[float, float]) -> None:
    axes.axhspan(*band, color=FIT, alpha=0.25, linewidth=0.0, label="fitted constant, 90 %")
    style: Style = {"fmt": "o", "markersize": 2.6, "linewidth": 0.8, "color": MEASURED}
    axes.errorbar(amplitude, value, sd, label="windows of the record", **style)


def _law(axes: Axes, axis: FloatArray, value: FloatArray, sd: FloatArray) -> None:
    axes.plot(axis, value, "--", color=ALERT, linewidth=1.2, label="fitted amplitude dependence, 90 %")
    axes.fill_between(axis, value - 1.645 * sd, value + 1.645 * sd, color=ALERT, alpha=0.15, linewidth=0.0)


INSTANTANEOUS = FigureKind("instantaneous", "recording", RecordingSubject.decaying, _draw)

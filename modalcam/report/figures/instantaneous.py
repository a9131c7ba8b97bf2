"""Frequency and damping ratio against amplitude, window by window, over the fitted law."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from modal_id.results import Identification, IdentifiedMode
from modalcam.report.derived.signals import instantaneous, shown_channel, shown_mode
from modalcam.report.figures.axes import few_ticks
from modalcam.report.style.palette import ALERT, FIT, MEASURED, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from modalcam.report.style.text import figure_label
from tracker.arrays import FloatArray


def instantaneous_figure(figure_id: str, found: Identification) -> FigureView | None:
    """Windows of the record over the constant with its 90 % interval and the law; None with fewer than three."""
    mode = shown_mode(found)
    if mode is None:
        return None
    channel = shown_channel(found)
    seen = instantaneous(found, mode, channel)
    if seen.amplitude.size < 3:
        return None
    size = float(np.abs(mode.shape[channel]))
    axis = np.linspace(0.0, max(size, float(np.max(seen.amplitude))), 60)
    with figure_style(figure_id):
        figure = new_figure(2.5)
        left, right = figure.subplots(1, 2)
        (low_f, high_f), (low_z, high_z) = mode.frequency_interval_hz(), mode.damping_interval()
        _panel(
            left,
            seen.amplitude,
            100.0 * seen.damping_ratio,
            100.0 * seen.damping_ratio_sd,
            (100.0 * low_z, 100.0 * high_z),
        )
        _panel(
            right,
            seen.amplitude,
            seen.frequency_hz - mode.frequency_hz,
            seen.frequency_sd_hz,
            (low_f - mode.frequency_hz, high_f - mode.frequency_hz),
        )
        _law(left, right, mode, axis, size)
        left.set_ylabel("damping ratio ζ (%)")
        right.set_ylabel("frequency − fitted (Hz)")
        for axes in (left, right):
            axes.set_xlabel(f"amplitude ({figure_label(found.series.unit)})")
            axes.set_xlim(0.0, axis[-1])
            few_ticks(axes, x=6)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=3, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Damping ratio and frequency against amplitude",
            alt=f"Damping ratio and frequency of windows of channel {found.series.channels[channel]} against their "
            "amplitude, with one standard deviation, over the band of the fitted constants.",
            caption="Each dot is a straight line through log amplitude and phase of one part of the decay, with one "
            "standard deviation; time runs from right to left. Dots that drift off the band with the amplitude mean "
            "that a constant does not hold.",
        )


def _panel(
    axes: Axes, amplitude: FloatArray, value: FloatArray, sd: FloatArray, band: tuple[float, float]
) -> None:
    axes.axhspan(*band, color=FIT, alpha=0.25, linewidth=0.0, label="fitted constant, 90 %")
    axes.errorbar(
        amplitude,
        value,
        sd,
        fmt="o",
        markersize=2.6,
        linewidth=0.8,
        color=MEASURED,
        label="windows of the record",
    )


def _law(left: Axes, right: Axes, mode: IdentifiedMode, axis: FloatArray, size: float) -> None:
    bent = mode.amplitude_dependence
    if bent is None or not bent.significant:
        return
    a = axis / size
    for axes, value, sd in (
        (left, 100.0 * (bent.zeta0 + bent.zeta1 * a), 100.0 * np.hypot(bent.zeta0_sd, bent.zeta1_sd * a)),
        (
            right,
            bent.f0_hz + bent.f2_hz * a**2 - mode.frequency_hz,
            np.hypot(bent.f0_sd_hz, bent.f2_sd_hz * a**2),
        ),
    ):
        axes.plot(axis, value, color=ALERT, linewidth=1.2, linestyle="--", label="fitted law, 90 %")
        axes.fill_between(
            axis, value - 1.645 * sd, value + 1.645 * sd, color=ALERT, alpha=0.15, linewidth=0.0
        )

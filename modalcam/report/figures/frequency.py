"""Against frequency: spectra of a decay, its residual and an ambient record, response to an input, stabilisation.

The stabilisation diagram shows, over their model orders, the poles of a method that knows nothing of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modal_id import Identification
from modal_id.solve import frequency_hz
from modalcam.report.figures.base import FigureKind, RecordingSubject, Target
from modalcam.report.signals import highest, residual, shown_channel, spectral_density, stability_of
from modalcam.report.style import (
    FAINT,
    FIT,
    INK,
    MEASURED,
    dots,
    few_ticks,
    figure_label,
    legend_above,
    log_y,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 400
# Frequencies shown, relative to the highest mode.
_ABOVE = 1.3


def _draw_spectrum(figure: Figure, shown: Target) -> bool:
    found, _, channel = shown
    series = found.series
    # The fit replaces missing samples: a gap in a decaying record would spread its line over the whole axis.
    shown_values = np.where(found.used[:, channel], series.values[:, channel], found.fitted[:, channel])
    known = np.isfinite(shown_values)
    frequency, before = spectral_density(series.time_s, shown_values)
    shown_values[known] = np.nan_to_num(residual(found)[known, channel])
    _, after = spectral_density(series.time_s, shown_values)
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
    _mark_modes(axes, found)
    few_ticks(axes, x=7)
    log_y(axes)
    axes.set(
        xlabel="frequency (Hz)",
        ylabel=f"density ({figure_label(series.unit)}/√Hz)",
        xlim=(0.0, frequency[-1]),
    )
    axes.legend()
    return True


def _draw_stability(figure: Figure, shown: Target) -> bool:
    found = shown.found
    diagram = stability_of(found)
    if diagram is None:
        return False
    masks = [diagram.stable(index) for index in range(len(diagram.orders))]
    hz = np.concatenate([frequency_hz(poles) for poles in diagram.poles])
    order = np.repeat(np.array(diagram.orders, dtype=float), [poles.size for poles in diagram.poles])
    stable = np.concatenate(masks)
    axes = figure.subplots()
    _mark_modes(axes, found)
    dots(axes, hz[~stable], order[~stable], FAINT, 2.4, label="new in this order")
    dots(axes, hz[stable], order[stable], MEASURED, 3.2, label="stable")
    few_ticks(axes, x=7)
    highest_hz = max(mode.frequency_hz for mode in found.modes)
    axes.set(xlabel="frequency (Hz)", ylabel="model order", xlim=(0.0, _ABOVE * highest_hz))
    axes.set_ylim(0.0, diagram.orders[-1] + 2.0)
    legend_above(figure, axes.get_legend_handles_labels(), columns=3)
    return True


def _mark_modes(axes: Axes, found: Identification) -> None:
    for k, mode in enumerate(found.fitted_modes):
        label = "_" if k else "identified modes"
        axes.axvline(mode.frequency_hz, color=FIT, linewidth=0.8, linestyle=(0, (3, 2)), label=label)


SPECTRUM = FigureKind("spectrum", "recording", RecordingSubject.decaying, _draw_spectrum)
STABILITY = FigureKind("stability", "recording", RecordingSubject.target, _draw_stability, height_in=2.2)


def _ambient(subject: RecordingSubject) -> Identification | None:
    found = subject.recording.identified
    return found if found is not None and found.ambient is not None else None


def _draw_ambient(figure: Figure, shown: Identification) -> None:
    record = shown.ambient
    if record is None:
        return
    axes = figure.subplots()
    for k, values in enumerate(record.singular_values.T):
        label = "singular values" if k == 0 else "_"
        axes.plot(
            record.frequency_hz,
            np.sqrt(np.maximum(values, 1e-12)),
            color=MEASURED if k == 0 else FAINT,
            linewidth=0.8,
            label=label,
        )
    for k, band in enumerate(record.bands):
        axes.axvspan(
            band.low_hz, band.high_hz, color=FIT, alpha=0.10, linewidth=0.0, label="_" if k else "bands"
        )
        label = "_" if k else "fitted spectrum"
        axes.plot(band.frequency_hz, np.sqrt(band.fitted), color=INK, linewidth=1.0, label=label)
    _mark_modes(axes, shown)
    few_ticks(axes, x=7)
    log_y(axes)
    highest_hz = max([band.high_hz for band in record.bands], default=record.frequency_hz[-1])
    axes.set(
        xlabel="frequency (Hz)",
        ylabel="density / noise",
        xlim=(0.0, min(1.3 * highest_hz, record.frequency_hz[-1])),
    )
    legend_above(figure, axes.get_legend_handles_labels(), columns=4)


AMBIENT = FigureKind("ambient", "recording", _ambient, _draw_ambient, essential=True)


@dataclass(frozen=True)
class Tuning:
    """What is drawn."""

    #: [1] standard deviation of the estimate without modes over its modulus up to which it is drawn
    #: statistics: Above it, the modulus is hardly told from 0.
    most_relative_sd: float = 0.5
    #: [1] factor of the axis beyond the response of the modes
    #: convention: A third of a decade.
    margin: float = 2.0


TUNING = Tuning()


def _response(subject: RecordingSubject) -> Identification | None:
    found = subject.recording.identified
    return found if found is not None and found.response is not None else None


def _draw_response(figure: Figure, shown: Identification) -> None:
    response = shown.response
    if response is None:
        return
    out = response.channels.index(shown.series.channels[shown_channel(shown)])
    hz = response.frequency_hz
    axes, below = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.0))
    size, model = np.abs(response.local[:, out]), np.abs(response.model[:, out])
    known = response.local_sd[:, out] < TUNING.most_relative_sd * size
    axes.plot(hz[known], size[known], ".", color=MEASURED, markersize=1.5, label="without modes")
    axes.fill_between(
        hz,
        response.magnitude_q05[:, out],
        response.magnitude_q95[:, out],
        color=FIT,
        alpha=0.25,
        linewidth=0.0,
        label="90 % band",
    )
    axes.plot(hz, model, color=INK, linewidth=0.9, label="fitted modes")
    _mark_modes(axes, shown)
    log_y(axes)
    below.plot(hz, response.coherence[:, out], color=MEASURED, linewidth=0.7)
    few_ticks(below, x=7, y=3)
    unit = "" if response.unit == "1" else f" ({response.unit})"
    axes.set(ylabel=f"response{unit}", ylim=(np.min(model) / TUNING.margin, np.max(model) * TUNING.margin))
    highest_hz = max((mode.frequency_hz for mode in shown.modes), default=float(hz[-1]))
    below.set(
        xlabel="frequency (Hz)",
        ylabel="coherence",
        ylim=(0.0, 1.05),
        xlim=(0.0, min(2.0 * highest_hz, float(hz[-1]))),
    )
    legend_above(figure, axes.get_legend_handles_labels(), columns=4)


RESPONSE = FigureKind("response", "recording", _response, _draw_response, height_in=3.4, essential=True)

"""Against frequency: spectra of the decay and of the residual, and the stabilisation diagram of the decay.

The diagram shows, over their model orders, the poles of a method that knows nothing of the fit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from modal_id import Identification
from modal_id.solve import frequency_hz
from modalcam.report.figures.base import FigureKind, RecordingSubject, Target
from modalcam.report.signals import highest, residual, spectral_density, stability_of
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
    for k, mode in enumerate(found.modes):
        label = "_" if k else "identified modes"
        axes.axvline(mode.frequency_hz, color=FIT, linewidth=0.8, linestyle=(0, (3, 2)), label=label)


SPECTRUM = FigureKind("spectrum", "recording", RecordingSubject.decaying, _draw_spectrum)
STABILITY = FigureKind("stability", "recording", RecordingSubject.target, _draw_stability, height_in=2.2)

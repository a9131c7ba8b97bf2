"""Singular values of the spectrum of an ambient record, with its bands and the fitted modal spectra."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from modal_id import Identification
from modalcam.report.figures.base import FigureKind, RecordingSubject
from modalcam.report.style import FAINT, FIT, INK, MEASURED, few_ticks, legend_above, log_y

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _shows(subject: RecordingSubject) -> Identification | None:
    found = subject.recording.identified
    return found if found is not None and found.ambient is not None else None


def _draw(figure: Figure, shown: Identification) -> None:
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
    for k, mode in enumerate(shown.modes):
        axes.axvline(
            mode.frequency_hz,
            color=FIT,
            linewidth=0.8,
            linestyle=(0, (3, 2)),
            label="_" if k else "identified modes",
        )
    few_ticks(axes, x=7)
    log_y(axes)
    highest_hz = max([band.high_hz for band in record.bands], default=record.frequency_hz[-1])
    axes.set(
        xlabel="frequency (Hz)",
        ylabel="density / noise",
        xlim=(0.0, min(1.3 * highest_hz, record.frequency_hz[-1])),
    )
    legend_above(figure, axes.get_legend_handles_labels(), columns=4)


AMBIENT = FigureKind("ambient", "recording", _shows, _draw, essential=True)

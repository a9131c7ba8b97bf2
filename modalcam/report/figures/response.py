"""Frequency response to a measured input: the fitted modes with their band, the estimate without modes, coherence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modal_id import Identification
from modalcam.report.figures.base import FigureKind, RecordingSubject
from modalcam.report.signals import shown_channel
from modalcam.report.style import FIT, INK, MEASURED, few_ticks, legend_above, log_y

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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


def _shows(subject: RecordingSubject) -> Identification | None:
    found = subject.recording.identified
    return found if found is not None and found.response is not None else None


def _draw(figure: Figure, shown: Identification) -> None:
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
    for k, mode in enumerate(shown.modes):
        label = "_" if k else "identified modes"
        axes.axvline(mode.frequency_hz, color=FIT, linewidth=0.8, linestyle=(0, (3, 2)), label=label)
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


RESPONSE = FigureKind("response", "recording", _shows, _draw, height_in=3.4, essential=True)

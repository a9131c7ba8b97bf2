"""A few cycles at the start of the fit and late in the decay: samples over the fitted motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from modal_id import Identification
from modalcam.report.figures.base import FigureKind, RecordingSubject, Target
from modalcam.report.signals import mode_motion
from modalcam.report.style import FIT, MEASURED, dots, few_ticks, figure_label, legend_above, quantity, trace
from tracker import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CYCLES = 4.0


def _draw(figure: Figure, shown: Target) -> bool:
    found, mode, channel = shown
    series = found.series
    used = np.flatnonzero(found.used[:, channel])
    if used.size < 2:
        return False
    span = _CYCLES / mode.frequency_hz
    start, end = found.onset.fit_from_s, float(series.time_s[used[-1]])
    late = max(start, min(start + 0.6 * (end - start), end - span))
    panels = ((start, "At the start of the fit"), (late, "Late in the decay"))
    for axes, (begin, title) in zip(figure.subplots(1, 2), panels, strict=True):
        inside = (series.time_s >= begin) & (series.time_s <= begin + span)
        t, y = series.time_s[inside], series.values[inside, channel]
        dots(axes, t, y, MEASURED, 3.2 if t.size < 150 else 2.0, label="measured")
        fine = np.linspace(begin, begin + span, 160)
        trace(axes, fine, _fine_fit(found, channel, fine), FIT, width=1.2, label="fitted")
        few_ticks(axes, x=5)
        axes.set(title=title, xlabel="time (s)")
        axes.margins(y=0.08)
    figure.axes[0].set_ylabel(f"{quantity(series.unit)} ({figure_label(series.unit)})")
    legend_above(figure, figure.axes[1].get_legend_handles_labels(), columns=2)
    return True


def _fine_fit(found: Identification, channel: int, time_s: FloatArray) -> FloatArray:
    """The fitted motion between the samples: the modes evaluated, the slow remainder interpolated."""
    start, good = found.onset.fit_from_s, np.flatnonzero(np.isfinite(found.fitted[:, channel]))
    around = np.searchsorted(found.series.time_s[good], time_s[[0, -1]])
    good = good[max(int(around[0]) - 1, 0) : int(around[1]) + 1]
    sample_s = found.series.time_s[good]
    rest = found.fitted[good, channel] - sum(mode_motion(m, sample_s - start, channel) for m in found.modes)
    motion = np.asarray(sum(mode_motion(m, time_s - start, channel) for m in found.modes), dtype=np.float64)
    return motion + np.interp(time_s, sample_s, rest) if good.size else motion


CLOSE_UP = FigureKind("close", "recording", RecordingSubject.target, _draw)

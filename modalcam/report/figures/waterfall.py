"""Displacement of a line over distance from the clamp and time: v(s, t)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from modalcam.report.figures.base import FigureKind, RecordingSubject
from modalcam.report.style import few_ticks, figure_label, significant
from tracker import FloatArray, MarkerTracks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Cycles in each panel, and most instants that are drawn of them.
_CYCLES = 6.0
_MOST_COLUMNS = 160
# Each panel has the scale of this quantile of its displacements, so that single outliers do not hide the motion.
_LARGEST = 0.998


class _Panel(NamedTuple):
    title: str
    time_s: FloatArray
    values: FloatArray


class _Shown(NamedTuple):
    unit: str
    position_mm: FloatArray
    panels: tuple[_Panel, ...]


def _shows(subject: RecordingSubject) -> _Shown | None:
    target, tracks = subject.target(), subject.recording.tracks
    if target is None or not isinstance(tracks, MarkerTracks) or tracks.kind != "line":
        return None
    found, mode, _ = target
    series = found.series
    known = np.isfinite(series.positions_mm) & found.channels_used
    if np.count_nonzero(known) < 2:
        return None
    span_s = _CYCLES / mode.frequency_hz
    last_s = float(series.time_s[found.decay_rows][-1])
    begins = (found.onset.fit_from_s, max(found.onset.fit_from_s, last_s - span_s))
    moved = series.values - found.baseline
    panels = []
    for title, begin_s in zip(("At the start of the fit", "At the end of the decay"), begins, strict=True):
        rows = np.flatnonzero((series.time_s >= begin_s) & (series.time_s <= begin_s + span_s))
        rows = rows[:: max(1, rows.size // _MOST_COLUMNS)]
        panels.append(_Panel(title, series.time_s[rows], moved[rows][:, known]))
    return _Shown(series.unit, series.positions_mm[known], tuple(panels))


def _draw(figure: Figure, shown: _Shown) -> bool:
    if any(panel.time_s.size < 2 or not np.isfinite(panel.values).any() for panel in shown.panels):
        return False
    for axes, panel in zip(figure.subplots(1, len(shown.panels)), shown.panels, strict=True):
        # The scale is in the title: a colour bar would need as much room as a panel.
        largest = float(np.nanquantile(np.abs(panel.values), _LARGEST)) or 1.0
        _map(axes, panel, shown.position_mm, largest)
        axes.set_title(f"{panel.title}, ±{significant(largest, 2)} {figure_label(shown.unit)}")
        axes.set(xlabel="time (s)", ylabel="distance from the clamp (mm)")
        axes.grid(visible=False)
        few_ticks(axes, x=5)
    return True


def _map(axes: Axes, panel: _Panel, position_mm: FloatArray, largest: float) -> None:
    step_s, step_mm = (float(np.median(np.diff(at))) for at in (panel.time_s, position_mm))
    axes.imshow(
        panel.values.T,
        aspect="auto",
        origin="lower",
        interpolation="nearest",
        cmap="RdBu_r",
        vmin=-largest,
        vmax=largest,
        extent=(
            float(panel.time_s[0]) - 0.5 * step_s,
            float(panel.time_s[-1]) + 0.5 * step_s,
            float(position_mm[0]) - 0.5 * step_mm,
            float(position_mm[-1]) + 0.5 * step_mm,
        ),
    )


WATERFALL = FigureKind("waterfall", "recording", _shows, _draw, height_in=3.0)

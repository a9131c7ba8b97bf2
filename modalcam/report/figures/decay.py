"""Displacement of the markers over the whole recording, with onset, fit and residual."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from modal_id import Identification
from modalcam.report.figures.base import FigureKind, RecordingSubject
from modalcam.report.signals import residual
from modalcam.report.style import (
    COLUMNS,
    FIT,
    INK,
    MEASURED,
    channel_label,
    few_ticks,
    figure_label,
    onset_line,
    quantity,
    share_time,
    trace,
)
from tracker import DisplacementSeries

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class _Shown(NamedTuple):
    series: DisplacementSeries
    found: Identification | None
    rows: tuple[int, ...]


def _shows(subject: RecordingSubject) -> _Shown | None:
    found = subject.recording.identified
    series = subject.recording.series if found is None else found.series
    if series is None or series.time_s.size < 2 or not series.channels:
        return None
    return _Shown(series, found, chosen_channels(series, subject.strips))


def chosen_channels(series: DisplacementSeries, most: int) -> tuple[int, ...]:
    """Up to `most` channels, evenly spread over those that hold any value (over all if none does)."""
    with_data = np.flatnonzero(np.isfinite(series.values).any(axis=0))
    candidates = with_data if with_data.size else np.arange(len(series.channels))
    picks = np.unique(np.linspace(0, candidates.size - 1, min(most, candidates.size)).round().astype(int))
    return tuple(int(c) for c in candidates[picks])


def _draw(figure: Figure, shown: _Shown) -> None:
    series, found, rows = shown
    count = len(rows) + (found is not None)
    figure.set_figheight(0.55 + max(0.62 * count, 1.7))
    all_axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    columns = COLUMNS if len(rows) <= 3 else COLUMNS // 2
    for axes, channel in zip(all_axes, rows, strict=False):
        values = series.values[:, channel]
        baseline = 0.0 if found is None else found.baseline[:, channel]
        offset = np.nanmean(values) if np.isfinite(values).any() else 0.0
        centre = np.nanmean(baseline) if np.isfinite(baseline).any() else offset
        trace(axes, series.time_s, values - centre, MEASURED, columns=columns)
        if found is not None:
            fitted = found.fitted[:, channel] - centre
            trace(axes, series.time_s, fitted, FIT, width=0.6, columns=columns, alpha=0.75)
        position = series.positions_mm[channel]
        where = f", {position:.4g} mm from the clamp" if np.isfinite(position) else ""
        title = f"{channel_label(series.channels[channel])}{where}"
        _finish(axes, title, series, found, label=axes is all_axes[0])
    if found is not None:
        left = residual(found)
        for channel in rows:
            trace(all_axes[-1], series.time_s, left[:, channel], INK, width=0.5, columns=columns, alpha=0.5)
        _finish(all_axes[-1], "residual of these channels: measured − fitted", series, found)
    share_time(all_axes)
    all_axes[-1].set(xlabel="time (s)", xlim=series.time_s[[0, -1]])
    figure.supylabel(f"{quantity(series.unit)} ({figure_label(series.unit)})", fontsize=8.5, x=0.008)


def _finish(
    axes: Axes, title: str, series: DisplacementSeries, found: Identification | None, *, label: bool = False
) -> None:
    # Titles stand on the side where the label of the onset is not.
    middle_s = 0.5 * (series.time_s[0] + series.time_s[-1])
    right = found is not None and found.onset.time_s < middle_s
    if found is not None:
        onset_line(axes, found.onset.time_s, label=label)
    axes.set_title(title, fontweight="normal", pad=2, loc="right" if right else "left")
    few_ticks(axes, x=7, y=3)


DECAY = FigureKind("decay", "recording", _shows, _draw, essential=True)

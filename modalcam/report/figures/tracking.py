"""Stated standard deviations of positions against the scatter of the series, by marker and over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from modalcam.report.figures.base import FigureKind, RecordingSubject
from modalcam.report.signals import TrackingQuality, tracking_quality
from modalcam.report.style import (
    ALERT,
    FIT,
    GENERIC,
    INK,
    MUTED,
    Style,
    few_ticks,
    figure_label,
    legend_above,
    log_y,
)
from tracker import MarkerTracks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# More names than this do not fit below the axis; the markers are numbered instead.
_NAMES = 10
# A logarithmic axis has enough labels only where the values differ by more than this.
_DECADES = 30.0


class _Shown(NamedTuple):
    markers: tuple[str, ...]
    quality: TrackingQuality


def _shows(subject: RecordingSubject) -> _Shown | None:
    tracks = subject.recording.tracks
    if not isinstance(tracks, MarkerTracks):
        return None
    quality = tracking_quality(tracks)
    return None if quality is None else _Shown(tracks.markers, quality)


def _draw(figure: Figure, shown: _Shown) -> None:
    left, right = figure.subplots(1, 2)
    _by_marker(left, shown.quality, shown.markers)
    _over_time(right, shown.quality)
    legend_above(figure, columns=4)


def _by_marker(axes: Axes, quality: TrackingQuality, names: tuple[str, ...]) -> None:
    tick = np.arange(len(names), dtype=np.float64)
    for c, (symbol, colour, name) in enumerate((("o", GENERIC, "x"), ("s", FIT, "y"))):
        at = tick + (c - 0.5) * 0.36
        label = "stated sd" if c == 0 else "_"
        axes.hlines(quality.stated_px[c], at - 0.16, at + 0.16, color=INK, linewidth=1.6, label=label)
        style: Style = {"color": colour, "markersize": 4, "markeredgewidth": 0, "label": f"scatter of {name}"}
        axes.plot(at, quality.scatter_px[c], symbol, **style)
    shown_px = np.concatenate([quality.stated_px.ravel(), quality.scatter_px.ravel()])
    shown_px = shown_px[np.isfinite(shown_px) & (shown_px > 0.0)]
    if shown_px.size and shown_px.max() > _DECADES * shown_px.min():
        log_y(axes)
    else:
        few_ticks(axes)
        axes.set_ylim(0.0, 1.1 * float(shown_px.max()) if shown_px.size else 1.0)
    axes.set_xlim(-0.6, len(names) - 0.4)
    if len(names) <= _NAMES:
        axes.set_xticks(tick, [figure_label(name, limit=8) for name in names])
    else:
        numbered = np.unique(np.linspace(0, len(names) - 1, 8).astype(int))
        axes.set_xticks(numbered, [str(k + 1) for k in numbered])
    axes.grid(visible=False, axis="x")
    axes.set(xlabel="marker", ylabel="px")


def _over_time(axes: Axes, quality: TrackingQuality) -> None:
    axes.axhline(1.0, color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    style: Style = {"color": ALERT, "markersize": 2.5, "markeredgewidth": 0, "linewidth": 0.8}
    axes.plot(quality.bin_time_s, quality.ratio, "o-", **style)
    few_ticks(axes)
    top = max(1.5, 1.1 * float(np.nanmax(quality.ratio)))
    axes.set(xlabel="time (s)", ylabel="residual / stated sd (rms)", ylim=(0.0, top))


TRACKING = FigureKind("tracking", "tracking", _shows, _draw, height_in=2.6)

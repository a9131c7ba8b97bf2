"""Stated standard deviations of positions against the scatter of the series, by marker and over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from modalcam.report.derived.tracking_quality import TrackingQuality, tracking_quality
from modalcam.report.figures.axes import few_ticks, log_y
from modalcam.report.style.palette import ALERT, FIT, GENERIC, INK, MUTED, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from modalcam.report.style.text import figure_label
from tracker.results import MarkerTracks

# With more markers than this their names do not fit under the axis: their numbers stand there.
_NAMES = 10
# A logarithmic axis has labels enough only where values differ by more.
_DECADES = 30.0


def tracking_figure(figure_id: str, tracks: MarkerTracks) -> FigureView | None:
    """Tracking quality in two panels; None where the series are too short to tell."""
    quality = tracking_quality(tracks)
    if quality is None:
        return None
    with figure_style(figure_id):
        figure = new_figure(2.6)
        left, right = figure.subplots(1, 2)
        _by_marker(left, quality, tracks.markers)
        _over_time(right, quality)
        figure.legend(loc="outside upper right", ncols=4, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Tracking residual",
            alt="Left: stated standard deviation and measured scatter of x and y for each of "
            f"{len(tracks.markers)} markers. Right: residual over stated standard deviation against time.",
            caption="The scatter is what a sample's neighbours in time do not predict of it. Where the stated sd is "
            "honest, the symbols lie on their bars and the line on the right stays near one; above one "
            "the sd is too small, below one it allows for errors that are slower than a few frames.",
        )


def _by_marker(axes: Axes, quality: TrackingQuality, names: tuple[str, ...]) -> None:
    place = np.arange(len(names), dtype=np.float64)
    for c, (symbol, colour, label) in enumerate((("o", GENERIC, "x"), ("s", FIT, "y"))):
        at = place + (c - 0.5) * 0.36
        bars = quality.stated_px[c]
        axes.hlines(
            bars, at - 0.16, at + 0.16, color=INK, linewidth=1.6, label="stated sd" if c == 0 else "_"
        )
        axes.plot(
            at,
            quality.scatter_px[c],
            symbol,
            color=colour,
            markersize=4,
            markeredgewidth=0,
            label=f"scatter of {label}",
        )
    shown_px = np.concatenate([quality.stated_px.ravel(), quality.scatter_px.ravel()])
    shown_px = shown_px[np.isfinite(shown_px) & (shown_px > 0.0)]
    if shown_px.size and shown_px.max() > _DECADES * shown_px.min():
        log_y(axes)
    else:
        few_ticks(axes)
        axes.set_ylim(0.0, 1.1 * float(shown_px.max()) if shown_px.size else 1.0)
    axes.set_xlim(-0.6, len(names) - 0.4)
    if len(names) <= _NAMES:
        axes.set_xticks(place, [figure_label(name, limit=8) for name in names])
    else:
        shown = np.unique(np.linspace(0, len(names) - 1, 8).astype(int))
        axes.set_xticks(shown, [str(k + 1) for k in shown])
    axes.grid(visible=False, axis="x")
    axes.set_xlabel("marker")
    axes.set_ylabel("px")


def _over_time(axes: Axes, quality: TrackingQuality) -> None:
    axes.axhline(1.0, color=MUTED, linewidth=0.9, linestyle=(0, (2, 2)))
    axes.plot(
        quality.bin_time_s, quality.ratio, "o-", color=ALERT, markersize=2.5, markeredgewidth=0, linewidth=0.8
    )
    few_ticks(axes)
    axes.set_ylim(0.0, max(1.5, 1.1 * float(np.nanmax(quality.ratio))))
    axes.set_xlabel("time (s)")
    axes.set_ylabel("residual / stated sd (rms)")

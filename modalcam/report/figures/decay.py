"""Displacement of the markers with onset, fit and residual; a few cycles close up."""

from __future__ import annotations

import numpy as np

from modal_id.results import Identification
from modalcam.report.derived.signals import mode_motion, residual, shown_channel, shown_mode
from modalcam.report.figures.axes import dots, few_ticks, onset_line, trace
from modalcam.report.style.palette import COLUMNS, FIT, INK, MEASURED, figure_style, new_figure
from modalcam.report.style.svg import FigureView, figure_view
from modalcam.report.style.text import channel_label, figure_label
from tracker.arrays import FloatArray
from tracker.results import DisplacementSeries

MOST_STRIPS = 8
_CYCLES = 4.0


def displacement_figure(
    figure_id: str, series: DisplacementSeries, found: Identification | None, *, strips: int = MOST_STRIPS
) -> FigureView:
    """Strips of up to `strips` channels, measured and fitted, over one of all residuals."""
    rows = chosen_channels(series, strips)
    count = len(rows) + (found is not None)
    with figure_style(figure_id):
        figure = new_figure(0.55 + max(0.62 * count, 1.7))
        side = _title_side(series, found)
        all_axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
        columns = COLUMNS if len(rows) <= 3 else COLUMNS // 2
        for axes, channel in zip(all_axes, rows, strict=False):
            values = series.values[:, channel]
            baseline = 0.0 if found is None else found.baseline[:, channel]
            offset = np.nanmean(values) if np.isfinite(values).any() else 0.0
            centre = np.nanmean(baseline) if np.isfinite(baseline).any() else offset
            trace(axes, series.time_s, values - centre, MEASURED, columns=columns)
            if found is not None:
                trace(
                    axes,
                    series.time_s,
                    found.fitted[:, channel] - centre,
                    FIT,
                    width=0.6,
                    columns=columns,
                    alpha=0.75,
                )
                onset_line(axes, found.onset.time_s, label=axes is all_axes[0])
            axes.set_title(_channel_title(series, channel), fontweight="normal", pad=2, loc=side)
            few_ticks(axes, x=10, y=3)
        if found is not None:
            last = all_axes[-1]
            left = residual(found)
            for channel in rows:
                trace(last, series.time_s, left[:, channel], INK, width=0.5, columns=columns, alpha=0.5)
            onset_line(last, found.onset.time_s)
            last.set_title(
                "residual of these channels: measured − fitted", fontweight="normal", pad=2, loc=side
            )
            few_ticks(last, x=10, y=3)
        all_axes[-1].set_xlabel("time (s)")
        all_axes[-1].set_xlim(series.time_s[0], series.time_s[-1])
        figure.supylabel(f"displacement ({figure_label(series.unit)})", fontsize=8.5)
        caption, alt = _displacement_words(series, found, len(rows))
        return figure_view(
            figure,
            figure_id=figure_id,
            title="Displacement of the markers" if found is None else "Displacement, fit and residual",
            alt=alt,
            caption=caption,
        )


def close_up_figure(figure_id: str, found: Identification) -> FigureView | None:
    """A few cycles at the start of the fit and late in it; None where no mode was found."""
    mode = shown_mode(found)
    if mode is None:
        return None
    channel, series = shown_channel(found), found.series
    span = _CYCLES / mode.frequency_hz
    used = np.flatnonzero(found.used[:, channel])
    if used.size < 2:
        return None
    start, end = found.onset.fit_from_s, float(series.time_s[used[-1]])
    late = max(start, min(start + 0.6 * (end - start), end - span))
    with figure_style(figure_id):
        figure = new_figure(2.5)
        for axes, begin, name in zip(
            figure.subplots(1, 2),
            (start, late),
            ("At the start of the fit", "Late in the decay"),
            strict=True,
        ):
            inside = (series.time_s >= begin) & (series.time_s <= begin + span)
            t, y = series.time_s[inside], series.values[inside, channel]
            dots(axes, t, y, MEASURED, _dot_size(t.size), label="measured")
            fine = np.linspace(begin, begin + span, 160)
            trace(axes, fine, _fine_fit(found, channel, fine), FIT, width=1.2, label="fitted")
            few_ticks(axes, x=5)
            axes.set_title(name)
            axes.set_xlabel("time (s)")
            axes.margins(y=0.08)
        figure.axes[0].set_ylabel(f"displacement ({figure_label(series.unit)})")
        handles, labels = figure.axes[1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=2, borderaxespad=0.0)
        return figure_view(
            figure,
            figure_id=figure_id,
            title="A few cycles close up",
            alt=f"Samples of channel {series.channels[channel]} as dots and the fitted motion as a line, over "
            f"{_CYCLES:.0f} cycles at the start of the fit and late in the decay.",
            caption="The dots are single frames of the marker that moves most. The line should pass through them "
            "without a lag: a phase that drifts between the two panels means a wrong frequency, or one that changes "
            "with amplitude.",
        )


def chosen_channels(series: DisplacementSeries, most: int) -> tuple[int, ...]:
    """Up to `most` channels, evenly spread over those that hold any value (over all where none does)."""
    with_data = np.flatnonzero(np.isfinite(series.values).any(axis=0))
    candidates = with_data if with_data.size else np.arange(len(series.channels))
    picks = np.unique(np.linspace(0, candidates.size - 1, min(most, candidates.size)).round().astype(int))
    return tuple(int(c) for c in candidates[picks])


def _fine_fit(found: Identification, channel: int, time_s: FloatArray) -> FloatArray:
    """The fitted motion between the samples: the modes as they are, the slow remainder interpolated."""
    own_s, start = found.series.time_s, found.onset.fit_from_s
    rest = found.fitted[:, channel] - sum(mode_motion(m, own_s - start, channel) for m in found.modes)
    good = np.isfinite(rest)
    motion = np.asarray(sum(mode_motion(m, time_s - start, channel) for m in found.modes), dtype=np.float64)
    return motion + np.interp(time_s, own_s[good], rest[good]) if good.any() else motion


def _title_side(series: DisplacementSeries, found: Identification | None) -> str:
    """Where titles of strips stand clear of the word at the onset."""
    if found is None:
        return "left"
    middle = 0.5 * (series.time_s[0] + series.time_s[-1])
    return "right" if found.onset.time_s < middle else "left"


def _channel_title(series: DisplacementSeries, channel: int) -> str:
    position = series.positions_mm[channel]
    where = f", {position:g} mm from the clamp" if np.isfinite(position) else ""
    return f"{channel_label(series.channels[channel])}{where}"


def _displacement_words(
    series: DisplacementSeries, found: Identification | None, strips: int
) -> tuple[str, str]:
    total = len(series.channels)
    some = f" {strips} of {total} channels are drawn." if strips < total else ""
    if found is None:
        return (
            "Look for steady shaking followed by a free decay, and for gaps where a marker was lost." + some,
            f"Displacement of {strips} channels against time.",
        )
    return (
        "Grey is measured, green is Eq. 1 as fitted (with the slow baseline) from just after the onset on. "
        "The residual at the bottom should look like noise of one size: a residual that rings or "
        "decays along with the motion means that the model leaves something out." + some,
        (
            f"Measured and fitted displacement of {strips} channels against time, the onset of the "
            "free decay marked at "
            f"{found.onset.time_s:.4g} s, and below them the residual."
        ),
    )


def _dot_size(samples: int) -> float:
    return 3.2 if samples < 150 else 2.0

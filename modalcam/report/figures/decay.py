"""Figures of the decay against time: the whole recording, a close-up of a few cycles, and the envelope.

Those of the first screen show the recordings with the widest and the narrowest interval of the damping ratio.

The axis of amplitude is logarithmic, where a constant damping ratio is a straight line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from modal_id import Identification, IdentifiedMode
from modal_id.data import spikes
from modalcam.pipeline import RunResult
from modalcam.report.figures.base import FigureKind, RecordingSubject, Target
from modalcam.report.signals import measured_envelope, mode_motion, residual, widest_and_narrowest
from modalcam.report.style import (
    ALERT,
    COLUMNS,
    FIT,
    INK,
    MEASURED,
    MUTED,
    channel_label,
    dots,
    few_ticks,
    figure_label,
    legend_above,
    log_y,
    onset_line,
    percent,
    quantity,
    share_time,
    trace,
    with_sd,
)
from tracker import DisplacementSeries, FloatArray

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
    if found is not None and found.ambient is not None:
        # Nothing is fitted in time.
        found = None
    count = len(rows) + (found is not None)
    figure.set_figheight(0.55 + max(0.62 * count, 1.7))
    all_axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    columns = COLUMNS if len(rows) <= 3 else COLUMNS // 2
    for axes, channel in zip(all_axes, rows, strict=False):
        _motion(axes, series, found, channel, columns)
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


def _motion(
    axes: Axes, series: DisplacementSeries, found: Identification | None, channel: int, columns: int
) -> None:
    values = series.values[:, channel]
    baseline = 0.0 if found is None else found.baseline[:, channel]
    offset = np.nanmean(values) if np.isfinite(values).any() else 0.0
    centre = np.nanmean(baseline) if np.isfinite(baseline).any() else offset
    trace(axes, series.time_s, values - centre, MEASURED, columns=columns, label="measured")
    if found is not None:
        fitted = found.fitted[:, channel] - centre
        trace(axes, series.time_s, fitted, FIT, width=0.6, columns=columns, alpha=0.75, label="fitted")
        # outliers may be a hundred times as large as the motion
        kept = (values - centre)[~spikes(values) & (~found.decay_rows | found.used[:, channel])]
        if found.channels_used[channel] and np.isfinite(kept).any():
            low, high = np.nanmin(kept), np.nanmax(kept)
            axes.set_ylim(low - 0.06 * (high - low), high + 0.06 * (high - low))


def _finish(
    axes: Axes, title: str, series: DisplacementSeries, found: Identification | None, *, label: bool = False
) -> None:
    # Titles stand on the side where the label of the onset is not.
    middle_s = 0.5 * (series.time_s[0] + series.time_s[-1])
    right = found is not None and found.has_decay and found.onset.time_s < middle_s
    if found is not None and found.has_decay:
        onset_line(axes, found.onset.time_s, label=label)
    axes.set_title(title, fontweight="normal", pad=2, loc="right" if right else "left")
    few_ticks(axes, x=7, y=3)


DECAY = FigureKind("decay", "recording", _shows, _draw, essential=True)


_CYCLES = 4.0
# Of the first screen, beside the table of modes; letters there are as large as those of the text.
_WIDTH_IN = 4.0


def _draw_close_up(figure: Figure, shown: Target) -> bool:
    found, mode, channel = shown
    series = found.series
    if np.count_nonzero(found.used[:, channel]) < 2:
        return False
    span = _CYCLES / mode.frequency_hz
    panels = ((found.onset.fit_from_s, "At the start of the fit"), (_late(shown, span), "Late in the decay"))
    for axes, (begin, title) in zip(figure.subplots(1, 2), panels, strict=True):
        _cycles(axes, shown, begin, span)
        few_ticks(axes, x=5)
        axes.set(title=title, xlabel="time (s)")
    figure.axes[0].set_ylabel(f"{quantity(series.unit)} ({figure_label(series.unit)})")
    legend_above(figure, figure.axes[1].get_legend_handles_labels(), columns=2)
    return True


def _late(shown: Target, span_s: float) -> float:
    """Where `span_s` begin late in the decay: at six tenths of it, or when half of its visible part is over."""
    found, mode, channel = shown
    start = found.onset.fit_from_s
    end = float(found.series.time_s[np.flatnonzero(found.used[:, channel])[-1]])
    # until the mode is as large as three standard deviations of the noise
    times = max(
        float(np.abs(mode.shape[channel])) / max(3.0 * float(found.residual_sd[channel]), 1e-300), 1.0
    )
    visible_s = np.log(times) / (mode.damping_ratio * mode.omega_n_rad_s)
    return float(max(start, min(start + min(0.6 * (end - start), 0.5 * visible_s), end - span_s)))


def _cycles(axes: Axes, shown: Target, begin_s: float, span_s: float) -> None:
    """Samples and fit over a few cycles."""
    found, _, channel = shown
    series = found.series
    inside = np.flatnonzero((series.time_s >= begin_s) & (series.time_s <= begin_s + span_s))
    # More dots than that lie on each other.
    inside = inside[:: max(1, inside.size // 400)]
    t, y = series.time_s[inside], series.values[inside, channel]
    dots(axes, t, y, MEASURED, 3.2 if t.size < 150 else 2.0, label="measured")
    fine = np.linspace(begin_s, begin_s + span_s, 160)
    trace(axes, fine, _fine_fit(found, channel, fine), FIT, width=1.2, label="fitted")
    axes.margins(y=0.08)


def _fine_fit(found: Identification, channel: int, time_s: FloatArray) -> FloatArray:
    """The fitted motion between the samples: the modes evaluated, the slow remainder interpolated."""
    start, good = found.onset.fit_from_s, np.flatnonzero(np.isfinite(found.fitted[:, channel]))
    around = np.searchsorted(found.series.time_s[good], time_s[[0, -1]])
    good = good[max(int(around[0]) - 1, 0) : int(around[1]) + 1]
    sample_s = found.series.time_s[good]
    fine, coarse = (
        np.asarray(sum(mode_motion(m, t - start, channel) for m in found.fitted_modes), dtype=np.float64)
        for t in (time_s, sample_s)
    )
    rest = found.fitted[good, channel] - coarse
    return fine + np.interp(time_s, sample_s, rest) if good.size else fine


class _Extreme(NamedTuple):
    recording: str
    target: Target


def _shows_extremes(result: RunResult) -> tuple[_Extreme, ...] | None:
    found = [(r.name, RecordingSubject(r).decaying()) for r in widest_and_narrowest(result)]
    return tuple(_Extreme(name, target) for name, target in found if target) or None


def _draw_extremes(figure: Figure, shown: tuple[_Extreme, ...]) -> None:
    figure.set_figheight(0.7 + 1.45 * len(shown))
    rows = figure.subplots(len(shown), 2, squeeze=False, width_ratios=(3, 2))
    for (whole, late), (name, target) in zip(rows, shown, strict=True):
        found, mode, channel = target
        series = found.series
        _motion(whole, series, found, channel, COLUMNS // 4)
        onset_line(whole, found.onset.time_s)
        whole.set(
            xlim=series.time_s[[0, -1]],
            ylabel=f"{channel_label(series.channels[channel])} ({figure_label(series.unit)})",
        )
        value = with_sd(100.0 * mode.damping_ratio, 100.0 * mode.damping_ratio_sd)
        number = f"mode {mode.number}, " if mode.number else ""
        whole.set_title(f"{figure_label(name)}: {number}ζ = {value} %", loc="left")
        span = _CYCLES / mode.frequency_hz
        if np.count_nonzero(found.used[:, channel]) > 1:
            _cycles(late, target, _late(target, span), span)
        few_ticks(whole, x=6, y=4)
        few_ticks(late, x=3, y=4)
    for axes in rows[-1]:
        axes.set_xlabel("time (s)")


EXTREMES = FigureKind(
    "extremes", "overview", _shows_extremes, _draw_extremes, width_in=_WIDTH_IN, essential=True
)
CLOSE_UP = FigureKind("close", "recording", RecordingSubject.decaying, _draw_close_up)


def _draw_envelope(figure: Figure, shown: Target) -> bool:
    found, mode, channel = shown
    time_s, amplitude = measured_envelope(found, mode, channel)
    positive = amplitude > 0.0
    initial = float(np.abs(mode.shape[channel]))
    if np.count_nonzero(positive) < 3 or initial == 0.0:
        return False
    axes = figure.subplots()
    dots(axes, time_s[positive], amplitude[positive], MEASURED, 3.4, label="measured")
    since_s = np.linspace(0.0, float(time_s[positive][-1]) - found.onset.fit_from_s, 80)
    axis_s = found.onset.fit_from_s + since_s
    fitted = initial * np.exp(-mode.damping_ratio * mode.omega_n_rad_s * since_s)
    label = f"fitted, ζ = {percent(mode.damping_ratio, 3)}"
    axes.plot(axis_s, fitted, color=FIT, linewidth=1.1, label=label)
    curved = _dependent_amplitude(mode, since_s, channel)
    if curved is not None:
        axes.plot(axis_s, curved, "--", color=ALERT, linewidth=1.2, label="ζ depends on amplitude")
    few_ticks(axes, x=7)
    drawn = np.concatenate((amplitude[positive], fitted))
    _vertical(axes, float(drawn.min()), float(drawn.max()), float(found.residual_sd[channel]))
    axes.set(xlabel="time (s)", ylabel=f"amplitude ({figure_label(found.series.unit)})")
    legend_above(figure, columns=4)
    return True


def _vertical(axes: Axes, low: float, high: float, noise_sd: float) -> None:
    """Axis and noise of one frame; of the data alone where they take less than half of the range above the noise."""
    from matplotlib.ticker import MaxNLocator, NullLocator  # noqa: PLC0415 - only to draw

    if noise_sd > 0.0 and high / low > np.sqrt(high / noise_sd):
        label = "noise of one frame (1 sd)"
        axes.axhline(noise_sd, color=MUTED, linewidth=0.9, linestyle=(0, (1, 2)), label=label)
        log_y(axes)
        return
    log_y(axes, (1.0,) if high > 30.0 * low else (1.0, 2.0, 3.0, 5.0, 7.0))
    if high < 4.0 * low:
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.yaxis.set_minor_locator(NullLocator())
    margin = max((high / low) ** 0.08, 1.01)
    axes.set_ylim(low / margin, high * margin)


def _dependent_amplitude(mode: IdentifiedMode, since_s: FloatArray, channel: int) -> FloatArray | None:
    """Amplitude of a channel by the curve, or by ``zeta0 + zeta1 a``; None unless the dependence is significant."""
    fit = mode.amplitude_dependence
    if fit is None or not fit.significant or (fit.curve is None and fit.zeta0 == 0.0):
        return None
    initial = float(np.abs(mode.shape[channel]))
    if fit.curve is not None:
        amplitude = fit.curve.decay(since_s) * initial / float(np.nanmax(np.abs(mode.shape)))
    else:
        # Solution of a' = -(zeta0 + zeta1 a) omega a with a(0) = 1.
        exponent = fit.zeta0 * mode.omega_n_rad_s * since_s
        with np.errstate(all="ignore"):
            amplitude = initial * np.exp(-exponent) / (1.0 - fit.zeta1 / fit.zeta0 * np.expm1(-exponent))
    return amplitude if np.all(amplitude > 0.0) else None


ENVELOPE = FigureKind("envelope", "recording", RecordingSubject.decaying, _draw_envelope)

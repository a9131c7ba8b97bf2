"""Usable channels and rows of a displacement series, and why others are left out: pauses, clipping, repeated rows.

Rows repeat the row before them exactly, or as a video codec reproduces them. Where each sample is held, rows between
carry nothing: all aliases up to half the rate of the rows fit equally well. Without these rows, half the rate of the
samples is the limit, and the lowest alias the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d
from scipy.special import ndtri

from modal_id.data.samples import MIN_SAMPLES, FitData, interpolation, runs, spikes
from modal_id.sentences import Note, Reason, Refusal
from tracker import BoolArray, DisplacementSeries, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Channels and rows that can be used, samples that are repeated or held."""

    #: [1] largest difference of a repetition from the row before, over a typical second difference
    #: convention: That is the noise where the motion is slow.
    small_bend: float = 0.15
    #: [1] step over the noise of a sample above which there is no repetition
    #: physics: At rest, all steps are noise.
    small_noise: float = 0.3
    #: [samples] rows on either side with which a repetition is compared
    #: physics: Motion and noise change during a decay.
    around: int = 100
    #: [1] probability, over the record, that motion and noise look like a repetition
    #: statistics: One record in a thousand.
    false_alarm: float = 1e-3
    #: [1] resolution over a typical step above which samples are often equal
    coarse: float = 0.01
    #: [1] resolution over a typical step below which no two samples are equal
    fine: float = 1e-4
    #: [1] steps over the largest nearby below which a motion stalls
    #: statistics: White noise does so in a quarter of this share of its rows.
    stalled: float = 0.05
    #: [samples] rows on either side among which the largest step is taken
    nearby: int = 9
    #: [1] share of stalled rows above which they are not due to chance
    stalled_share: float = 0.2
    #: [1] share of the distances between changes that must be a multiple of the usual distance
    #: convention: A clock that is no whole multiple has two distances, equal samples of a coarse converter any.
    even: float = 0.9
    #: [1] length of a pause in steps over the number of samples from which it is an error of the time stamps
    long_pause: float = 10.0
    #: [1] number of mean steps whose median gives the sampling rate at a sample
    #: convention: Gaps do not count in the median.
    rate_steps: int = 33
    #: [steps] number of steps in each mean
    #: convention: They even out rounded time stamps.
    averaged: int = 4
    #: [1] ratio of two rates below which they count as one rate with jitter or missing samples
    #: physics: A missing sample doubles a step.
    same_rate: float = 1.9
    #: [1] share of steps or duration, the larger of both, below which a stretch does not count as another rate
    least_share: float = 0.05
    #: [samples] shortest clipped run
    min_run: int = 4
    #: [1] length of a clipped run over that of a sine within one step of its peak
    clipped_factor: float = 4.0
    #: [1] share of finite samples below which a channel is left out
    min_finite: float = 0.3
    #: [1] range of a channel over the stated sd below which it is rounding
    #: physics: The range of noise with this sd is above three times the sd.
    rounding: float = 0.01
    #: [1] largest number of channels, or of rates, named in a note
    most_names: int = 8


TUNING = Tuning()

# Relative difference below which two values are equal: half the digits.
_EQUAL = float(np.sqrt(np.finfo(float).eps))
# Probability that a Gaussian step is below a small share of the median step, over that share.
_BELOW_MEDIAN = float(np.sqrt(2.0 / np.pi) * ndtri(0.75))


def repeated_rows(values: FloatArray) -> BoolArray:
    """Mask of the rows that repeat the one before them in every channel; shape (n,).

    Steps and second differences within a run of such rows are compared with those around it. At a turning point of slow
    motion the second differences are as large as anywhere, so that it is no repetition. Where the motion stalls in many
    rows, these are repetitions, too. Samples of a coarse converter are often equal: where its resolution is not much
    finer than the steps, nothing is a repetition. Nor is anything where no three successive rows of a channel have a
    value.

    Parameters
    ----------
    values : array, shape (n, k)
        NaN where missing: a row with a missing value neither repeats nor is repeated.
    """
    n = values.shape[0]
    repeated = np.zeros(n, dtype=bool)
    steps, bends = np.abs(np.diff(values, axis=0)), np.abs(np.diff(values, 2, axis=0))
    finite = np.all(np.isfinite(steps), axis=1)
    if np.count_nonzero(finite) < MIN_SAMPLES - 1 or not np.all(np.any(np.isfinite(bends), axis=0)):
        return repeated
    typical = _typical(steps[finite])
    noise = np.array([interpolation(column[np.isfinite(column)])[2] for column in values.T])
    small = np.minimum(TUNING.small_bend * np.nanmedian(bends, axis=0), TUNING.small_noise * noise)
    least = small / np.maximum(typical, 1e-300)
    resolution = _resolution(values)
    if np.any(typical <= 0.0) or np.any(resolution > TUNING.coarse * typical):
        return repeated
    # A row without a value is no repetition.
    step = np.max(np.where(finite[:, None], steps, np.inf) / typical, axis=1)
    bend = np.max(np.where(np.isfinite(bends), bends, np.inf) / typical, axis=1)
    if np.all(resolution < TUNING.fine * typical):
        repeated[1:] = step == 0.0
    for start, end in runs(step < np.min(least)):
        # Rows start + 1 to end repeat row start.
        places = 1.0 if end == step.size else float(n)
        if (end - start) * np.log(2.0 * TUNING.around + 1.0) < np.log(places / TUNING.false_alarm):
            # Too few to be significant whatever their size.
            continue
        around = np.r_[max(start - TUNING.around, 0) : start, end : min(end + TUNING.around, step.size)]
        log_p = _log_chance(step[start:end], step[around])
        if end - start > 1:
            around = around[around < bend.size]
            log_p = max(log_p, _log_chance(bend[start : end - 1], bend[around]))
        if log_p < np.log(TUNING.false_alarm / places):
            repeated[start + 1 : end + 1] = True
    steps = np.diff(values, axis=0) / typical
    if np.mean(_stalls(steps)) > TUNING.stalled_share:
        # beside a spike, all other steps are small
        off = np.stack([spikes(column) for column in values.T], axis=1)
        stalls = _stalls(np.diff(np.where(off, np.nan, values), axis=0) / typical)
        repeated |= stalls & (np.mean(stalls) > TUNING.stalled_share)
    return repeated


def _typical(steps: FloatArray) -> FloatArray:
    """Median step of each channel, without repetitions, which may be most rows; shape (k,)."""
    moving = np.where(steps > TUNING.stalled * np.sqrt(np.mean(steps**2, axis=0)), steps, np.nan)
    if not np.all(np.any(steps > 0.0, axis=0)):
        return np.zeros(steps.shape[1])
    return np.asarray(np.nanmedian(moving, axis=0))


def _stalls(steps: FloatArray) -> BoolArray:
    """Mask of the rows at which the motion stalls, shape (n,): a display or a camera holds each image for several rows.

    No smooth motion stops for a few rows and goes on in the same direction; at a turning point it reverses.
    """
    stalled = np.zeros(steps.shape[0] + 1, dtype=bool)
    size = np.max(np.where(np.isfinite(steps), np.abs(steps), np.inf), axis=1)
    largest = maximum_filter1d(np.where(np.isfinite(size), size, 0.0), 2 * TUNING.nearby + 1)
    for start, end in runs(size < TUNING.stalled * largest):
        if start > 0 and end < size.size and float(steps[start - 1] @ steps[end]) > 0.0:
            stalled[start + 1 : end + 1] = True
    return stalled


def _log_chance(values: FloatArray, around: FloatArray) -> float:
    """Logarithm of the probability that values as small as these occur, judged by those around them."""
    around = around[np.isfinite(around)]
    if around.size < MIN_SAMPLES:
        return 0.0
    rank = (1.0 + np.searchsorted(np.sort(around), values, side="right")) / (around.size + 1.0)
    share = _BELOW_MEDIAN * values / max(float(np.median(around)), 1e-300)
    return float(np.sum(np.log(np.minimum(np.maximum(rank, share), 1.0))))


def _resolution(values: FloatArray) -> FloatArray:
    """Smallest difference between two values of each channel that differ by more than rounding."""
    smallest = np.full(values.shape[1], np.inf)
    for channel, column in enumerate(values.T):
        apart = np.diff(np.unique(column[np.isfinite(column)]))
        smallest[channel] = np.min(apart[apart > _EQUAL * np.nanmax(np.abs(column))], initial=np.inf)
    return smallest


def sampled_rows(series: DisplacementSeries) -> tuple[NDArray[np.intp], int] | None:
    """Rows that carry a sample, and their distance in rows; None where every row may."""
    seen = np.flatnonzero(np.any(np.isfinite(series.values), axis=1))
    if seen.size < MIN_SAMPLES:
        return None
    values = series.values[seen]
    values = values[:, np.any(np.isfinite(values), axis=0)]
    repeated = repeated_rows(values)
    repeated[1:] |= np.all((values[1:] == values[:-1]) | np.isnan(values[1:]), axis=1)
    rows = seen[~repeated]
    if rows.size < MIN_SAMPLES:
        return None
    lengths = np.diff(rows)
    held = int(np.median(lengths))
    # A sample equal to the one before lies a multiple later.
    return (rows, held) if held > 1 and float(np.mean(lengths % held == 0)) > TUNING.even else None


def of_rows(series: DisplacementSeries, rows: NDArray[np.intp]) -> DisplacementSeries:
    """The series with these rows only, without its measured input, which has no fewer rows."""
    base, base_sd = (None if x is None else x[rows] for x in (series.base, series.base_sd))
    return replace(
        series,
        time_s=series.time_s[rows],
        values=series.values[rows],
        sd=series.sd[rows],
        base=base,
        base_sd=base_sd,
        known_input=None,
    )


def longest_without_pause(time_s: FloatArray) -> tuple[int, int, str] | None:
    """First row and end of the stretch of most rows, and a sentence; None where there is no such pause.

    A pause of ten times as many steps as there are samples leaves the phases on its sides unrelated, and memory for
    baseline and spectrum would grow with the pause.
    """
    if time_s.size < 2:
        return None
    step_s = np.diff(time_s)
    pauses = np.flatnonzero(step_s > TUNING.long_pause * time_s.size * np.median(step_s))
    if not pauses.size:
        return None
    edges = np.concatenate([[0], pauses + 1, [time_s.size]])
    longest = int(np.argmax(np.diff(edges)))
    first, end = int(edges[longest]), int(edges[longest + 1])
    note = Note.PAUSE(gap_s=np.max(step_s), count=end - first, start_s=time_s[first], end_s=time_s[end - 1])
    return first, end, note


def longest_at_one_rate(time_s: FloatArray) -> tuple[int, int, str] | None:
    """First row and end of the longest stretch at the rate of most samples, and a sentence; None where one rate is all.

    A motion above the Nyquist frequency of a slower stretch is an alias there and itself elsewhere: no one mode fits
    both.
    """
    if time_s.size < 2 * TUNING.rate_steps:
        return None
    mean_s = uniform_filter1d(np.diff(time_s), TUNING.averaged, mode="nearest")
    step_s = np.maximum(median_filter(mean_s, TUNING.rate_steps, mode="nearest"), 1e-300)
    alike = np.abs(np.log(step_s / np.median(step_s))) < np.log(TUNING.same_rate)
    for begin, end in runs(~alike):
        share = max((end - begin) / step_s.size, (time_s[end] - time_s[begin]) / (time_s[-1] - time_s[0]))
        alike[begin:end] = share < TUNING.least_share
    if np.all(alike):
        return None
    stretches = sorted([*runs(alike), *runs(~alike)], key=lambda run: int(run[0]))
    first, last = max(runs(alike), key=lambda run: int(run[1] - run[0]))
    rates = [
        Note.RATE(rate_hz=1.0 / float(np.median(step_s[begin:end])), start_s=time_s[begin])
        for begin, end in stretches[: TUNING.most_names]
    ] + ["…"] * (len(stretches) > TUNING.most_names)
    # A step lies between two rows.
    note = Note.RATES(rates=", ".join(rates), start_s=time_s[first], end_s=time_s[last])
    return int(first), int(last) + 1, note


def last_saturated_row(values: FloatArray, least_step: FloatArray | None = None) -> int | None:
    """Row of the last sample that belongs to a clipped peak of any channel, or None.

    A peak is clipped when many neighbouring samples share the channel's largest or smallest value (within 0.2 % of the
    range above or below the median, on several peaks). Quantised slow signals also repeat their largest value: the run
    must be longer than the quantisation explains.

    Parameters
    ----------
    values : array, shape (n, k)
        NaN where missing.
    least_step : array, shape (k,), or None
        Steps of a channel that are smaller are none; 0 or NaN where unknown.
    """
    least = np.zeros(values.shape[1]) if least_step is None else np.nan_to_num(least_step)
    rows = [
        row
        for column, step in zip(values.T, least, strict=True)
        for row in (_last_run(column, step), _last_run(-column, step))
        if row is not None
    ]
    return max(rows) if rows else None


def _last_run(column: FloatArray, least_step: float) -> int | None:
    good = np.flatnonzero(np.isfinite(column))
    if good.size < 4 * TUNING.min_run:
        return None
    x = column[good]
    top, middle = float(np.max(x)), float(np.median(x))
    if top <= middle:
        return None
    tolerance = 0.002 * (top - middle)
    at_top = x >= top - tolerance
    starts, ends = runs(at_top).T
    lengths = ends - starts
    if np.max(lengths) <= TUNING.min_run:
        return None
    crossings = np.count_nonzero(np.diff(x > middle))
    period = 2.0 * x.size / max(float(crossings), 1.0)
    steps = np.diff(np.unique(x))
    # Steps of a marker that is drawn in whole pixels are uneven: the one below the limit counts, too.
    below = float(np.min(x[at_top])) - float(np.max(x[~at_top], initial=middle))
    resolution = max(below, float(np.min(steps[steps > least_step], initial=top - middle)))
    stay = period * np.sqrt(2.0 * (tolerance + resolution) / (top - middle)) / np.pi
    long = lengths > max(TUNING.min_run, TUNING.clipped_factor * stay)
    # Peaks: the signal leaves the limit between them, unlike noise on a level that it has stepped to.
    peaks = np.flatnonzero(long)
    left = [np.min(x[ends[a] : starts[b]]) < 0.5 * (top + middle) for a, b in pairwise(peaks)]
    if not any(left):
        return None
    # Later and shorter runs at the same limit are clipped too.
    return int(good[ends[lengths >= 2][-1] - 1])


@dataclass(frozen=True)
class Projection:
    """Components that stand for many channels.

    Attributes
    ----------
    data : FitData
        Samples of the k channels; weight 0 at outliers of single channels.
    to_channels : array, shape (k, r)
        Values of the channels for unit components.
    from_channels : array, shape (r, k)
        Components of the values of all channels at an instant at which they have their usual noise.
    """

    data: FitData
    to_channels: FloatArray
    from_channels: FloatArray

    def rows(self, selection: slice) -> Projection:
        """The same for these rows."""
        return Projection(self.data.rows(selection), self.to_channels, self.from_channels)

    def of_components(self, mask: BoolArray) -> Projection:
        """The same with some of the components."""
        return Projection(self.data, self.to_channels[:, mask], self.from_channels[mask])


@dataclass(frozen=True)
class Prepared:
    """Samples of the usable channels from the first usable row to the last, with the indices of both in the series.

    ``repeated`` masks those of these rows that repeat the row before them: their weight is 0. ``stated_sd``, shape
    (k,), is the sd stated for samples with weight 1, NaN where none is. With a ``projection``, ``data`` are components
    of the channels.
    """

    data: FitData
    channels: NDArray[np.intp]
    first_row: int
    notes: tuple[str, ...]
    repeated: BoolArray
    stated_sd: FloatArray
    projection: Projection | None = None

    def in_series(self, values: NDArray[Any], count: int) -> NDArray[Any]:
        """Values of the usable channels, in the last axis, as those of all `count` channels, NaN in the others."""
        nan = complex(np.nan, np.nan) if np.iscomplexobj(values) else np.nan
        found = np.full((*values.shape[:-1], count), nan)
        found[..., self.channels] = values
        return found


def prepare(series: DisplacementSeries) -> Prepared | Refusal:
    """Usable channels and rows, or the reason why there is nothing to fit."""
    n = series.time_s.size
    if n < MIN_SAMPLES:
        return Reason.FEW_SAMPLES(found=n, least=MIN_SAMPLES)
    finite = np.isfinite(series.values)
    kept, notes = _usable_channels(series, finite)
    if not kept.size:
        return Reason.NO_CHANNEL(notes=" ".join(notes))
    first_row = 0
    for longest in (longest_without_pause, longest_at_one_rate):
        stretch = longest(series.time_s[first_row:n])
        if stretch is not None:
            first_row, n, note = first_row + stretch[0], first_row + stretch[1], stretch[2]
            notes.append(note)
    if n - first_row < MIN_SAMPLES:
        return Reason.FEW_AT_ONE_RATE(found=n - first_row, least=MIN_SAMPLES, notes=" ".join(notes))
    stated_sd = _stated_sd(series, kept)
    saturated = last_saturated_row(series.values[first_row:n, kept], TUNING.rounding * stated_sd)
    if saturated is not None:
        saturated += first_row
        first_row = saturated + 1
        notes.append(Note.CLIPPED_UNTIL(until_s=series.time_s[saturated]))
        if n - first_row < MIN_SAMPLES:
            return Reason.CLIPPED()
    rows = slice(first_row, n)
    repeated = repeated_rows(series.values[rows, kept])
    distinct = repeated.size - int(np.count_nonzero(repeated))
    if distinct < MIN_SAMPLES:
        return Reason.FEW_DISTINCT(found=distinct, count=n - first_row, least=MIN_SAMPLES)
    if np.any(repeated):
        seen = np.any(finite[rows, kept], axis=1)
        notes.append(_repeated_note(repeated[seen], series.time_s[rows][seen]))
    data = _fit_data(series, kept, rows, stated_sd)
    data.weights[repeated] = 0.0
    return Prepared(data, kept, first_row, tuple(notes), repeated, stated_sd)


def _usable_channels(series: DisplacementSeries, finite: BoolArray) -> tuple[NDArray[np.intp], list[str]]:
    """Indices of the channels to fit, and a sentence for each that is left out."""
    n = series.time_s.size
    channels, notes = [], []
    misleading, for_reason = dict(series.misleading), dict[str, list[str]]()
    stated_sd = _stated_sd(series, np.arange(len(series.channels)))
    for index, name in enumerate(series.channels):
        good = series.values[finite[:, index], index]
        if name in misleading:
            for_reason.setdefault(misleading[name], []).append(name)
        elif good.size < max(MIN_SAMPLES, TUNING.min_finite * n):
            notes.append(Note.CHANNEL(names=name, why=Note.FEW_VALUES(found=good.size, count=n)))
        elif np.ptp(good) == 0.0:
            notes.append(Note.CHANNEL(names=name, why=Note.NEVER_CHANGES(value=good[0], unit=series.unit)))
        elif np.ptp(good) < TUNING.rounding * stated_sd[index]:
            for_reason.setdefault(Note.AT_REST(percent=100.0 * TUNING.rounding), []).append(name)
        else:
            channels.append(index)
    left_out = [
        (Note.CHANNELS if len(names) > 1 else Note.CHANNEL)(names=listed(names), why=why)
        for why, names in for_reason.items()
    ]
    return np.array(channels, dtype=np.intp), [*left_out, *notes]


def listed(names: list[str]) -> str:
    """Names of channels for a sentence, the first of many."""
    more = len(names) - TUNING.most_names
    text = ", ".join(names[: TUNING.most_names])
    return Note.MORE_NAMES(names=text, count=more) if more > 0 else text


def _repeated_note(repeated: BoolArray, time_s: FloatArray) -> str:
    count = int(np.count_nonzero(repeated))
    at_end = int(np.argmin(repeated[::-1])) if not repeated.all() else repeated.size
    places = [Note.FIRST_AT(first_s=time_s[np.argmax(repeated)])] if at_end < count else []
    places += [Note.LAST_ROWS(count=at_end)] if at_end > 0 else []
    return (Note.REPEATED if count > 1 else Note.ONE_REPEATED)(count=count, places=", and ".join(places))


def _stated_sd(series: DisplacementSeries, channels: NDArray[np.intp]) -> FloatArray:
    """Lower quartile of the sd stated for the samples of each channel; NaN where none is stated.

    Not the smallest: a single sample with a very small stated sd cannot dominate the fit.
    """
    sd = series.sd[:, channels]
    known = np.isfinite(sd) & (sd > 0.0)
    return np.array(
        [
            np.quantile(s[good], 0.25) if np.any(good) else np.nan
            for s, good in zip(sd.T, known.T, strict=True)
        ]
    )


def _fit_data(
    series: DisplacementSeries, channels: NDArray[np.intp], rows: slice, stated_sd: FloatArray
) -> FitData:
    values, sd = series.values[rows, channels], series.sd[rows, channels]
    finite, known = np.isfinite(values), np.isfinite(sd) & (sd > 0.0)
    # Inverse variance relative to the stated sd, at most 1; 1 where none is stated.
    weights = np.where(known, np.minimum(1.0, (stated_sd / np.where(known, sd, 1.0)) ** 2), 1.0)
    time = series.time_s[rows]
    return FitData(time - time[0], np.where(finite, values, 0.0), np.where(finite, weights, 0.0))


def with_base(data: FitData, series: DisplacementSeries, first_row: int) -> tuple[FitData, BoolArray]:
    """Samples with the tracked motion of the base appended as a channel, and a mask of that channel.

    Without a usable base the samples are returned unchanged, with a mask that is False everywhere.
    """
    base = np.zeros(data.values.shape[1], dtype=bool)
    if series.base is None:
        return data, base
    motion = series.base[first_row : first_row + data.time_s.size]
    seen = np.isfinite(motion)
    if np.count_nonzero(seen) < MIN_SAMPLES or np.ptp(motion[seen]) == 0.0:
        return data, base
    values = np.column_stack([data.values, np.where(seen, motion, 0.0)])
    weights = np.column_stack([data.weights, seen.astype(float)])
    known = None if data.noise_variance is None else np.append(data.noise_variance, np.nan)
    return FitData(data.time_s, values, weights, known), np.append(base, True)

"""Usable channels and rows of a displacement series, with reasons for what is left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.data.long_gap import longest_without_pause
from modal_id.data.one_rate import longest_at_one_rate
from modal_id.data.repeats import repeated_rows
from modal_id.data.samples import FitData
from modal_id.data.saturation import last_saturated_row
from tracker import BoolArray, DisplacementSeries, FloatArray

MIN_SAMPLES = 12


@dataclass(frozen=True)
class Tuning:
    """Which channels can be used."""

    #: [1] share of finite samples below which a channel is left out
    min_finite: float = 0.3
    #: [1] range of a channel over the stated sd below which it is rounding
    #: physics: The range of noise with this sd is above three times the sd.
    rounding: float = 0.01
    #: [1] largest number of channels named in a note
    most_names: int = 8


TUNING = Tuning()
_ROUNDING = TUNING.rounding

_AT_REST = f"no motion (the values change by less than {100.0 * _ROUNDING:g} % of their standard deviation)"
_CLIPPED = (
    "the signal is clipped until the end of the record: too many samples share its largest or smallest value; reduce "
    "the amplitude or use a larger range; draw the markers of a synthetic film at fractions of a px, with gray edges"
)


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


def prepare(series: DisplacementSeries) -> Prepared | str:
    """Usable channels and rows, or a sentence with the reason why there is nothing to fit."""
    n = series.time_s.size
    if n < MIN_SAMPLES:
        return (
            f"the series has {n} samples, but at least {MIN_SAMPLES} are needed; "
            "record longer or at a higher frame rate"
        )
    finite = np.isfinite(series.values)
    kept, notes = _usable_channels(series, finite)
    if not kept.size:
        return (
            f"no channel has a usable signal: {' '.join(notes)} Check the sensor, the markers or the columns."
        )
    first_row = 0
    for longest in (longest_without_pause, longest_at_one_rate):
        stretch = longest(series.time_s[first_row:n])
        if stretch is not None:
            first_row, n, note = first_row + stretch[0], first_row + stretch[1], stretch[2]
            notes.append(note)
    if n - first_row < MIN_SAMPLES:
        return (
            f"only {n - first_row} of the samples follow each other without a pause and at one rate, but at least "
            f"{MIN_SAMPLES} are needed. {' '.join(notes)}"
        )
    stated_sd = _stated_sd(series, kept)
    saturated = last_saturated_row(series.values[first_row:n, kept], _ROUNDING * stated_sd)
    if saturated is not None:
        saturated += first_row
        first_row = saturated + 1
        notes.append(
            f"The signal is clipped (many samples at its extreme value) until {series.time_s[saturated]:.4g} s; "
            "only the samples after it were used."
        )
        if n - first_row < MIN_SAMPLES:
            return _CLIPPED
    rows = slice(first_row, n)
    repeated = repeated_rows(series.values[rows, kept])
    distinct = repeated.size - int(np.count_nonzero(repeated))
    if distinct < MIN_SAMPLES:
        return (
            f"only {distinct} of {n - first_row} samples differ from the one before, but at least {MIN_SAMPLES} are "
            "needed: frames are frozen or duplicated; check the camera or the file"
        )
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
            notes.append(f"Channel {name} was left out: only {good.size} of {n} samples have a value.")
        elif np.ptp(good) == 0.0:
            notes.append(f"Channel {name} was left out: it never changes (always {good[0]:g} {series.unit}).")
        elif np.ptp(good) < _ROUNDING * stated_sd[index]:
            for_reason.setdefault(_AT_REST, []).append(name)
        else:
            channels.append(index)
    left_out = [
        f"Channel{'s' if len(names) > 1 else ''} {listed(names)} {'were' if len(names) > 1 else 'was'} left out: {why}."
        for why, names in for_reason.items()
    ]
    return np.array(channels, dtype=np.intp), [*left_out, *notes]


def listed(names: list[str]) -> str:
    """Names of channels for a sentence, the first of many."""
    more = len(names) - TUNING.most_names
    return ", ".join(names[: TUNING.most_names]) + (f" and {more} more" if more > 0 else "")


def _repeated_note(repeated: BoolArray, time_s: FloatArray) -> str:
    count = int(np.count_nonzero(repeated))
    at_end = int(np.argmin(repeated[::-1])) if not repeated.all() else repeated.size
    places = (
        f"the last {at_end} of the record"
        if at_end == count
        else f"first at {time_s[np.argmax(repeated)]:.4g} s"
    )
    if 0 < at_end < count:
        places += f", and the last {at_end} of the record"
    return (
        f"{count} sample{'s' if count > 1 else ''} repeat{'' if count > 1 else 's'} the one before ({places}): frozen "
        f"or duplicated frames. {'They were' if count > 1 else 'It was'} left out."
    )


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

"""Rows that repeat the row before them, exact or as a video codec reproduces them, and series that hold each sample.

The rows between held samples carry nothing, so that all aliases up to half the rate of the rows fit the samples equally
well. Without these rows, half the rate of the samples is the limit, and the lowest alias the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.special import ndtri

from modal_id.data.samples import MIN_SAMPLES, interpolation, runs, spikes
from tracker import BoolArray, DisplacementSeries, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Samples repeated by the recorder, or held by a slower clock."""

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

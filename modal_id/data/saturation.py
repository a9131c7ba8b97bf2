"""Clipped signals: the last sample at the limit of a sensor."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from modal_id.data.samples import runs
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Clipped runs."""

    #: [samples] shortest clipped run
    min_run: int = 4
    #: [1] fewest clipped runs
    min_runs: int = 2
    #: [1] length of a clipped run over that of a sine within one step of its peak
    factor: float = 4.0


TUNING = Tuning()


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
    long = lengths > max(TUNING.min_run, TUNING.factor * stay)
    # Peaks: the signal leaves the limit between them, unlike noise on a level that it has stepped to.
    peaks = np.flatnonzero(long)
    left = [np.min(x[ends[a] : starts[b]]) < 0.5 * (top + middle) for a, b in pairwise(peaks)]
    if not peaks.size or np.count_nonzero(left) + 1 < TUNING.min_runs:
        return None
    # Later and shorter runs at the same limit are clipped too.
    return int(good[ends[lengths >= 2][-1] - 1])

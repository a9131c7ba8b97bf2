"""Clicks within a free decay: outliers that lie together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.data import reject_outliers, runs
from modal_id.fit import ModalFit, refit
from modal_id.record import Segment
from modal_id.sentences import Note
from modal_id.solve import frequency_hz
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Which outliers lie together, and until when they disturb the motion."""

    #: [samples] most samples between two rejected ones that belong together
    gap: int = 4
    #: [1] probability, over the whole record, that as many single outliers lie together by chance
    #: statistics: One record in a thousand.
    false_alarm: float = 1e-3
    #: [1] number of parts of the record in which the rate of outliers is counted
    parts: int = 40
    #: [samples] fewest samples over which the residual before a click is averaged
    least: int = 32
    #: [1] mean square of the residual over the noise below which it is quiet
    #: statistics: By chance above at four standard deviations.
    quiet: float = 2.0


TUNING = Tuning()


def without_clicks(model: ModalFit, weights: FloatArray) -> tuple[ModalFit, BoolArray]:
    """Leave out the stretches in which rejected samples cluster, until the disturbance has faded, and fit again.

    `weights`, shape (n, k), are those before any rejection. Returns the fit and the mask of these rows, shape (n,): of
    those in which at least half of the channels are rejected, since a fault of one channel is no click.
    """
    linear, used = model.fit.linear, weights > 0.0
    rejected = used & (model.data.weights == 0.0)
    count = np.count_nonzero(used, axis=1)
    bad = (count > 0) & (2 * np.count_nonzero(rejected, axis=1) >= count)
    square = np.sum(weights * linear.residual**2 / linear.noise_variance, axis=1) / np.maximum(count, 1)
    # Outliers are not part of the residual that is to fade.
    square[bad] = 1.0
    cycle = 1.0 / (float(np.min(frequency_hz(model.fit.poles))) * model.data.step_s)
    window = int(max(TUNING.least, cycle))
    rows = np.zeros(bad.size, dtype=bool)
    for first, last in _clusters(bad):
        before, end = square[max(first - window, 0) : first], _faded(square, last, window)
        if end + window < bad.size and before.size and np.mean(before) < TUNING.quiet:
            rows[first : end + 1] = True
    if not np.any(rows):
        return model, rows
    # A click distorts the fit, so that samples are rejected that are no outliers without it: they are found anew.
    left = np.where(rows[:, None], 0.0, weights)
    data = replace(model.data, weights=left)
    return refit(model, model.fit.poles, reject_outliers(data, left, linear.residual)), rows


def _clusters(bad: BoolArray) -> list[tuple[int, int]]:
    """First and last row of each group of marked rows that cluster more than by chance."""
    places = np.flatnonzero(bad)
    if not places.size:
        return []
    groups = np.split(places, np.flatnonzero(np.diff(places) > TUNING.gap + 1) + 1)
    # Single outliers are independent: `follows` is the probability that the next one follows within the gap. Where they
    # are many, they cluster by chance, but then in most parts of the record; clicks fill few parts.
    parts = np.array_split(bad, min(TUNING.parts, bad.size))
    alone = sum(group.size == 1 for group in groups) / bad.size
    single = max(alone, float(np.median([np.mean(part) for part in parts])))
    follows = -np.expm1((TUNING.gap + 1) * np.log1p(-min(max(single, 1.0 / bad.size), 0.5)))
    return [
        (int(group[0]), int(group[-1]))
        for group in groups
        if (group.size - 1) * np.log(follows) + np.log(places.size) < np.log(TUNING.false_alarm)
    ]


def _faded(square: FloatArray, last: int, window: int) -> int:
    """First row from `last` on after which the residuals are quiet; the number of rows where they never are."""
    sums = np.cumsum(np.concatenate([[0.0], square]))
    ends = np.arange(last, square.size - window)
    quiet = (
        sums[ends + 1 + window] - sums[ends + 1] < TUNING.quiet * window
        if ends.size
        else np.zeros(0, dtype=bool)
    )
    return int(ends[np.argmax(quiet)]) if np.any(quiet) else square.size


def click_segments(time_s: FloatArray, rows: BoolArray) -> tuple[Segment, ...]:
    """A segment for each run of the mask `rows`; both arrays have shape (n,)."""
    return tuple(
        Segment("disturbed", float(time_s[first]), float(time_s[last - 1]), Note.CLICK())
        for first, last in runs(rows)
    )

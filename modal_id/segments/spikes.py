"""Single samples far from the motion about them, which would look like events, and clicks within a free decay."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.data import FitData, reject_outliers, runs
from modal_id.fit import ModalFit, refit
from modal_id.record import Segment
from modal_id.sentences import Note
from modal_id.solve import frequency_hz
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Spikes within windows; clicks: outliers that lie together."""

    #: [cycles] length of a window
    #: convention: Two separate the motion from an offset.
    cycles: float = 2.0
    #: [samples] fewest samples of a window
    min_samples: int = 10
    #: [1] span of a window over the usual one, above which the window contains a gap
    longest: float = 1.5
    #: [1] mean square residual over that of the quiet windows from which samples are examined
    #: statistics: Three standard deviations.
    large: float = 9.0
    #: [1] share of the windows that set the quiet level
    #: convention: Most windows may hold a spike.
    quiet: float = 0.25
    #: [1] share of a window's samples that may be removed
    most: float = 0.1
    #: [1] fewest degrees of freedom that must be left
    least_freedom: int = 3
    #: [1] share of the windows about a sample that its removal must explain
    agreed: float = 0.75
    #: [samples] most samples between two rejected ones that belong together
    click_gap: int = 4
    #: [1] probability, over the whole record, that as many single outliers lie together by chance
    #: statistics: One record in a thousand.
    false_alarm: float = 1e-3
    #: [1] number of parts of the record in which the rate of outliers is counted
    click_parts: int = 40
    #: [samples] fewest samples over which the residual before a click is averaged
    click_least: int = 32
    #: [1] mean square of the residual over the noise below which it is quiet
    #: statistics: By chance above at four standard deviations.
    click_quiet: float = 2.0


TUNING = Tuning()


# Windows overlap by three quarters.
_HOPS = 4
# Windows at a time: the columns of all would take two hundred bytes for each sample.
_BLOCK = 4096


@dataclass(frozen=True)
class _Windows:
    """Windows of two cycles of a record, each a quarter of their length later.

    ``first``, shape (m,), are the rows of their first samples, ``samples`` the number of samples in each; ``whole``
    marks windows without a gap, shape (m,).
    """

    time_s: FloatArray
    frequency_hz: float
    first: NDArray[np.intp]
    samples: int
    centre_s: FloatArray
    half_s: float
    whole: BoolArray

    def blocks(self, which: BoolArray | None = None) -> Iterator[NDArray[np.intp]]:
        """Indices of all windows, or of those in the mask, some at a time."""
        chosen = np.arange(self.first.size) if which is None else np.flatnonzero(which)
        yield from (chosen[begin : begin + _BLOCK] for begin in range(0, chosen.size, _BLOCK))

    def rows(self, some: NDArray[np.intp]) -> NDArray[np.intp]:
        """Rows of the samples of some windows; shape (w, l)."""
        return self.first[some, None] + np.arange(self.samples)

    def columns(self, some: NDArray[np.intp]) -> FloatArray:
        """Offset, cosine and sine, and these times the time from the centre, -1 to 1; shape (w, l, 6)."""
        times = self.time_s[self.rows(some)]
        since = (times - self.centre_s[some, None]) / self.half_s
        phase = 2.0 * np.pi * self.frequency_hz * times
        wave = np.stack([np.ones_like(phase), np.cos(phase), -np.sin(phase)], axis=2)
        return np.concatenate([wave, since[:, :, None] * wave], axis=2)


def _windows(data: FitData, frequency_hz: float) -> _Windows | None:
    """Windows at a frequency; None where the record is too short for three."""
    step = data.step_s
    length = max(round(TUNING.cycles / (frequency_hz * step)), TUNING.min_samples)
    length += -length % _HOPS
    if data.time_s.size < 3 * length:
        return None
    first = np.arange(0, data.time_s.size - length + 1, length // _HOPS)
    begin, end = data.time_s[first], data.time_s[first + length - 1]
    whole = end - begin < TUNING.longest * length * step
    return _Windows(data.time_s, frequency_hz, first, length, 0.5 * (begin + end), 0.5 * length * step, whole)


def without_spikes(data: FitData, frequency_hz: float) -> FitData:
    """The data with single samples at weight 0 whose removal explains the windows about them.

    The motion in a window is an offset, an amplitude and their slopes. A pluck, a stop or a step
    within a window disturbs more samples than may be removed; at its edge, the next window shows it.
    """
    found = _windows(data, frequency_hz)
    if found is None:
        return data
    weights = data.weights.copy()
    for channel in range(weights.shape[1]):
        weights[_spikes(found, data, channel), channel] = 0.0
    return replace(data, weights=weights)


def _spikes(found: _Windows, data: FitData, channel: int) -> BoolArray:
    """Mask of the samples of one channel; shape (n,)."""
    y, w = data.values[:, channel], data.weights[:, channel]
    most = max(1, int(TUNING.most * found.samples))
    square, whole = np.empty(found.first.size), found.whole.copy()
    for some in found.blocks():
        rows = found.rows(some)
        residual, freedom = _residual(found.columns(some), y[rows], w[rows])
        whole[some] &= freedom >= TUNING.least_freedom + most
        square[some] = np.sum(w[rows] * residual**2, axis=1) / np.maximum(freedom, 1)
    if not np.any(whole):
        return np.zeros(data.time_s.size, dtype=bool)
    limit = TUNING.large * float(np.quantile(square[whole], TUNING.quiet))
    votes, of = np.zeros(data.time_s.size), np.zeros(data.time_s.size)
    for some in found.blocks(whole):
        np.add.at(of, found.rows(some), 1.0)
    for some in found.blocks(whole & (square > limit)):
        rows = found.rows(some)
        np.add.at(votes, rows[_removed(found.columns(some), y[rows], w[rows], most, limit)], 1.0)
    return np.asarray((votes >= 1.0) & (votes >= TUNING.agreed * of))


def _removed(columns: FloatArray, y: FloatArray, w: FloatArray, most: int, limit: float) -> BoolArray:
    """Mask of the samples, at most `most` in each window, without which the rest is within the limit; shape (m, l)."""
    left = w.copy()
    for _ in range(most):
        gain = _gain(columns, y, left)
        open_ = np.flatnonzero(_square(columns, y, left) > limit)
        left[open_, np.argmax(gain[open_], axis=1)] = 0.0
    explained = _square(columns, y, left) <= limit
    return np.asarray((left != w) & explained[:, None])


def _residual(columns: FloatArray, y: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residual (m, l) of the weighted fit of each window, and its degrees of freedom (m,)."""
    beta = np.linalg.solve(_gram(columns, w), np.einsum("mlc,ml,ml->mc", columns, w, y)[..., None])[..., 0]
    freedom = np.count_nonzero(w > 0.0, axis=1) - columns.shape[2]
    return y - np.einsum("mlc,mc->ml", columns, beta), freedom


def _square(columns: FloatArray, y: FloatArray, w: FloatArray) -> FloatArray:
    """Mean square residual of each window per degree of freedom."""
    residual, freedom = _residual(columns, y, w)
    return np.asarray(np.sum(w * residual**2, axis=1) / np.maximum(freedom, 1))


def _gain(columns: FloatArray, y: FloatArray, w: FloatArray) -> FloatArray:
    """Decrease of the sum of squares of each window by the removal of each sample; shape (m, l)."""
    residual, _ = _residual(columns, y, w)
    leverage = w * np.einsum(
        "mlc,mcl->ml", columns, np.linalg.solve(_gram(columns, w), np.swapaxes(columns, 1, 2))
    )
    return np.asarray(w * residual**2 / np.maximum(1.0 - leverage, 1e-6))


def _gram(columns: FloatArray, w: FloatArray) -> FloatArray:
    gram = np.swapaxes(columns * w[..., None], 1, 2) @ columns
    ridge = 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300
    return np.asarray(gram + ridge * np.eye(columns.shape[2]))


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
    window = int(max(TUNING.click_least, cycle))
    rows = np.zeros(bad.size, dtype=bool)
    for first, last in _clusters(bad):
        before, end = square[max(first - window, 0) : first], _faded(square, last, window)
        if end + window < bad.size and before.size and np.mean(before) < TUNING.click_quiet:
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
    groups = np.split(places, np.flatnonzero(np.diff(places) > TUNING.click_gap + 1) + 1)
    # Single outliers are independent: `follows` is the probability that the next one follows within the gap. Where they
    # are many, they cluster by chance, but then in most parts of the record; clicks fill few parts.
    parts = np.array_split(bad, min(TUNING.click_parts, bad.size))
    alone = sum(group.size == 1 for group in groups) / bad.size
    single = max(alone, float(np.median([np.mean(part) for part in parts])))
    follows = -np.expm1((TUNING.click_gap + 1) * np.log1p(-min(max(single, 1.0 / bad.size), 0.5)))
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
        sums[ends + 1 + window] - sums[ends + 1] < TUNING.click_quiet * window
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

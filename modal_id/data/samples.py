"""Times, values and weights of the samples that a fit uses, and outliers among them.

Outliers are detected in the residual of the fitted model and never by filtering the raw data.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.sparse import csr_array

from tracker import MAD_TO_SD, BoolArray, FloatArray, robust_sd

# A record, a channel or a part of either with fewer samples tells nothing.
MIN_SAMPLES = 12
# Samples at a time, where each needs several values: a few megabytes.
AT_ONCE = 65_536


@dataclass(frozen=True)
class FitData:
    """Samples of the channels to be fitted.

    Attributes
    ----------
    time_s : array, shape (n,)
        From the start of the fit.
    values : array, shape (n, k)
        0 where missing; the weight is 0 there too.
    weights : array, shape (n, k)
        Inverse variance relative to the channel's best samples: 0 to 1, for averages their sum; 0 where a sample is not
        used.
    noise_variance : array, shape (k,), or None
        Of a sample with weight 1, where it is known; NaN in other channels.
    """

    time_s: FloatArray
    values: FloatArray
    weights: FloatArray
    noise_variance: FloatArray | None = None

    @cached_property
    def groups(self) -> tuple[tuple[NDArray[np.intp], FloatArray], ...]:
        """(channels, weights) of each set of channels with equal weights: they share their normal equations."""
        found: dict[bytes, list[int]] = {}
        for channel in range(self.values.shape[1]):
            found.setdefault(self.weights[:, channel].tobytes(), []).append(channel)
        return tuple((np.array(cs), self.weights[:, cs[0]]) for cs in found.values())

    @cached_property
    def counts(self) -> FloatArray:
        """Number of used samples of each channel; shape (k,)."""
        return np.asarray(np.count_nonzero(self.weights > 0.0, axis=0).astype(float))

    @property
    def span_s(self) -> float:
        """From the first to the last time."""
        return float(self.time_s[-1] - self.time_s[0])

    @cached_property
    def step_s(self) -> float:
        """Median time step."""
        return float(np.median(np.diff(self.time_s)))

    def rows(self, selection: slice | BoolArray | NDArray[np.intp]) -> FitData:
        """Samples of these rows."""
        return self._of(self.time_s[selection], self.values[selection], self.weights[selection])

    def channels(self, selection: BoolArray | NDArray[np.intp]) -> FitData:
        """Samples of these channels."""
        known = None if self.noise_variance is None else self.noise_variance[selection]
        if selection.dtype == bool and np.all(selection):
            return self
        return FitData(self.time_s, self.values[:, selection], self.weights[:, selection], known)

    def averaged(self, factor: int) -> FitData:
        """Weighted means of each `factor` neighbouring samples."""
        total, count = neighbour_sums(self.time_s.size, factor)
        weights = total @ self.weights
        values = (total @ (self.weights * self.values)) / np.maximum(weights, 1e-300)
        # Around missing samples, the mean of a motion belongs to the mean time of the others.
        used = np.count_nonzero(self.weights > 0.0, axis=1).astype(float)
        used[np.repeat(total @ used == 0.0, count)] = 1.0
        return self._of((total @ (used * self.time_s)) / (total @ used), values, weights)

    def inside(self, start_s: float, end_s: float) -> BoolArray:
        """Mask of the samples from `start_s` to `end_s`; shape (n,)."""
        return np.asarray((self.time_s >= start_s - 1e-12) & (self.time_s <= end_s + 1e-12))

    def between(self, start_s: float, end_s: float) -> FitData:
        """Samples from `start_s` to `end_s`, with times counted from `start_s`."""
        return self._part(start_s, float(np.nextafter(end_s + 1e-12, np.inf)))

    def from_time(self, time_s: float) -> FitData:
        """Samples from `time_s` on, with times counted from it."""
        return self._part(time_s, np.inf)

    def _part(self, start_s: float, before_s: float) -> FitData:
        """Samples from `start_s` to before `before_s`, values and weights not copied; times from the former."""
        rows = slice(*np.searchsorted(self.time_s, (start_s - 1e-12, before_s)))
        return self._of(self.time_s[rows] - start_s, self.values[rows], self.weights[rows])

    def _of(self, time_s: FloatArray, values: FloatArray, weights: FloatArray) -> FitData:
        """Other samples of the same channels."""
        return replace(self, time_s=time_s, values=values, weights=weights)


def rough_variance(data: FitData) -> FloatArray:
    """Noise variance of each channel, known or from what its samples do not tell of each other.

    By `interpolation`, or by second differences where that is less or the samples are few: an upper bound for these
    where fast modes are present.
    """
    result = np.ones(data.values.shape[1])
    for channel in range(result.size):
        good = data.values[data.weights[:, channel] > 0.0, channel]
        if good.size > 4:
            second = robust_sd(np.diff(good, 2)) / np.sqrt(6.0)
            result[channel] = min(second, interpolation(good)[2]) ** 2
    if data.noise_variance is not None:
        result = np.where(np.isfinite(data.noise_variance), data.noise_variance, result)
    floor = 1e-12 * max(float(np.var(data.values)), 1e-300)
    return np.maximum(result, floor)


def without_spikes(data: FitData) -> FitData:
    """The data with the samples at weight 0 that `spikes` finds."""
    values = np.where(data.weights > 0.0, data.values, np.nan)
    found = np.stack([spikes(column) for column in values.T], axis=1)
    return replace(data, weights=np.where(found, 0.0, data.weights)) if np.any(found) else data


def spikes(values: FloatArray) -> BoolArray:
    """Mask of single samples of a channel that leave the motion about them; shape (n,), as `values`, NaN where missing.

    A spike differs from its interpolation by more than most samples of the record and nearby; and without it, or
    without it and another one nearby, the samples about it are interpolated well. At a step, a release and in a longer
    click they are not.
    """
    found, side = np.zeros(values.size, dtype=bool), TUNING.side
    # as many samples tell how well the motion is interpolated nearby as interpolate one
    near = 2 * side
    for _ in range(TUNING.passes):
        rows = np.flatnonzero(np.isfinite(values) & ~found)
        if rows.size <= max(2 * (near + side), 4 * side):
            break
        # about its ends, a record goes on with the same slope
        beyond = 4 * side
        error, weights, _ = interpolation(np.pad(values[rows], beyond, mode="reflect", reflect_type="odd"))
        around = np.median(sliding_window_view(np.abs(error), near), axis=1)
        # samples whose interpolation does not contain this one, on the side without another spike
        nearby = np.full(error.size, np.inf)
        nearby[near + side :] = around[: -side - 1]
        nearby[: -near - side] = np.minimum(nearby[: -near - side], around[side + 1 :])
        limit = TUNING.spike * np.maximum(nearby, np.median(np.abs(error)))
        own = _alone_or_two(error, weights, limit) - beyond
        own = own[(own >= 0) & (own < rows.size)]
        if not own.size:
            break
        found[rows[own]] = True
    if not np.any(found):
        return found
    # several in a row are a click, of which each round removes some
    crowded = np.convolve(found, np.ones(2 * side + 1), "same") > TUNING.most_spikes
    return np.asarray(found & ~crowded)


def _alone_or_two(error: FloatArray, weights: FloatArray, limit: FloatArray) -> NDArray[np.intp]:
    """Rows where one error above its limit, or two, explain all errors of interpolation about them."""
    side = TUNING.side
    # errors of interpolation about a sample that is off by 1
    pattern = np.insert(-weights[::-1], side, 1.0)
    places = np.flatnonzero(np.abs(error) > limit)
    places = places[(places >= 2 * side) & (places < error.size - 3 * side - 1)]
    found = []
    for apart in range(2 * side + 1):
        columns = np.zeros((2 * side + 1 + apart, 1 + (apart > 0)))
        columns[: 2 * side + 1, 0] = pattern
        columns[apart:, -1] = pattern
        around = error[places[:, None] + np.arange(-side, side + 1 + apart)]
        size = around @ np.linalg.pinv(columns).T
        left = np.max(np.abs(around - size @ columns.T), axis=1)
        least = np.min(np.abs(size), axis=1)
        explained = left < np.maximum(TUNING.cured * least, TUNING.cured_limit * limit[places])
        own = places[explained & (least > limit[places])]
        found += [own, own + apart]
    return np.unique(np.concatenate(found))


def interpolation(values: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Error of the best interpolation of each sample from its neighbours, its weights, and the noise of a sample.

    As linear prediction does, it separates noise from motion without a known frequency, at any number of samples a
    cycle. `values`, shape (n,), have no NaN; the errors of the first and last samples are 0, the noise is infinite
    where the samples do not determine the weights, shape (2 side,).
    """
    side = TUNING.side
    error, weights = np.zeros(values.size), np.zeros(2 * side)
    noise_sd = float("inf")
    if values.size <= 2 * side:
        return error, weights, noise_sd
    windows = sliding_window_view(values - np.median(values), 2 * side + 1)
    some = windows[:: 1 + windows.shape[0] // TUNING.most_windows]
    while some.shape[0] > TUNING.windows_each * 2 * side:
        gram = some.T @ some
        others = np.delete(np.delete(gram, side, 0), side, 1)
        ridge = 1e-12 * np.trace(others) + 1e-300
        weights = np.linalg.solve(others + ridge * np.eye(2 * side), np.delete(gram[:, side], side))
        own = some @ np.insert(-weights, side, 1.0)
        spread = robust_sd(own)
        noise_sd = spread / float(np.sqrt(1.0 + weights @ weights))
        kept = np.abs(own) <= TUNING.unexplained * spread
        if np.all(kept):
            break
        some = some[kept]
    if np.isfinite(noise_sd):
        error[side:-side] = windows @ np.insert(-weights, side, 1.0)
    return error, weights, noise_sd


def detrended(data: FitData) -> FloatArray:
    """Values less the mean of each channel, 0 where missing."""
    total = np.maximum(np.sum(data.weights, axis=0), 1e-300)
    mean = np.sum(data.weights * data.values, axis=0) / total
    return np.where(data.weights > 0.0, data.values - mean, 0.0)


def neighbour_sums(n: int, factor: int) -> tuple[csr_array, NDArray[np.intp]]:
    """Matrix, shape (m, n), that sums each `factor` neighbouring rows, and the number of rows in each sum."""
    # Half the memory of the indices that SciPy would take.
    starts = np.append(np.arange(0, n, factor, dtype=np.int32), np.int32(n))
    sums = csr_array((np.ones(n), np.arange(n, dtype=np.int32), starts), shape=(starts.size - 1, n))
    return sums, np.diff(starts)


def row_blocks(count: int, size: int = AT_ONCE) -> Iterator[slice]:
    """Slices of `size` rows, the last perhaps of fewer, that cover `count` rows."""
    yield from (slice(first, min(first + size, count)) for first in range(0, count, size))


def runs(mask: BoolArray) -> NDArray[np.intp]:
    """First row, and row after the last, of each run of True in a mask; shape (runs, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return edges.reshape(-1, 2)


@dataclass(frozen=True)
class Tuning:
    """Rejection of outliers."""

    #: [sd] deviation that is not due to chance: of a sample from the model, of the number of such samples from that
    #: expected
    #: statistics: One good sample in two million.
    limit: float = 5.0
    #: [sd] difference between two values that their errors do not explain
    #: statistics: 0.3 % exceed it.
    beyond: float = 3.0
    #: [1] share of a channel's samples that may be rejected wherever they lie; more show that the model lacks something
    few: float = 0.03
    #: [1] share that may be rejected where the samples are spread at random
    #: physics: The median absolute deviation itself is then a third too large.
    most: float = 0.25
    #: [samples] marked samples at the beginning from which they are misfit of the model
    least_misfit: int = 12
    #: [1] share of the marked samples that lie there
    mostly: float = 0.8
    #: [1] share of the record that counts as its beginning
    beginning: float = 0.1
    #: [samples] on either side, from which one is interpolated
    #: physics: Four sinusoids of any frequency are interpolated exactly.
    side: int = 4
    #: [1] error of interpolation of a spike over the median error of all samples, and of those nearby
    #: statistics: Six standard deviations of noise.
    spike: float = 9.0
    #: [1] largest number of spikes among a sample and those that interpolate it
    #: convention: More are a click.
    most_spikes: int = 3
    #: [1] largest error of interpolation about a spike that it does not explain, over its size
    #: physics: At a step of slow motion it is .2, and .14 of the smaller of two.
    cured: float = 0.1
    #: [1] the same over the least error of a spike
    #: statistics: Five standard deviations of noise.
    cured_limit: float = 0.33
    #: [1] windows that determine one weight of the interpolation, at least
    #: convention: Fewer would be fitted, and the noise be found too small.
    windows_each: int = 4
    #: [sd] error of the interpolation from which a window is left out
    #: statistics: Noise alone reaches it in one window of 16 000.
    unexplained: float = 4.0
    #: [samples] largest number of samples that determine the weights, evenly spread
    #: statistics: They determine the noise to within 1 %.
    most_windows: int = 50_000
    #: [1] largest number of searches
    #: convention: Spikes near others are found when these are gone; most_spikes of them in each neighbourhood.
    passes: int = 8


TUNING = Tuning()
OUTLIER_SD, BEYOND_SD = TUNING.limit, TUNING.beyond


def beyond_limit(weights: FloatArray, residual: FloatArray) -> BoolArray:
    """Samples more than five robust standard deviations from the model; shape (n, k), as weights and residual.

    The standard deviation of each channel is estimated from the median absolute residual; the weights are those before
    any rejection.
    """
    return np.asarray((weights > 0.0) & (np.abs(residual) > _limit(weights, residual)))


def outlier_share(weights: FloatArray, residual: FloatArray) -> float:
    """Largest share, over channels, of the used samples beyond the limit of `beyond_limit`."""
    bad = np.count_nonzero(beyond_limit(weights, residual), axis=0)
    used = np.count_nonzero(weights > 0.0, axis=0)
    return float(np.max(bad / np.maximum(used, 1), initial=0.0))


def are_many(outliers: float) -> bool:
    """Whether this share of outliers shows that the model does not explain a channel."""
    return outliers > TUNING.few


def limited(weights: FloatArray, residual: FloatArray) -> FloatArray:
    """The residual clipped at the limit of `beyond_limit`, to search for motion that a few large samples would hide."""
    limit = _limit(weights, residual)
    return np.clip(residual, -limit, limit)


def _limit(weights: FloatArray, residual: FloatArray) -> FloatArray:
    """Five robust standard deviations of each sample, shape (n, k); infinite where that is unknown."""
    root = np.sqrt(weights)
    used = weights > 0.0
    columns = zip(residual.T, root.T, used.T, strict=True)
    spread = np.array([np.median(np.abs(r[u]) * s[u]) if np.any(u) else 0.0 for r, s, u in columns])
    known = used & (spread > 0.0)
    limit = np.divide(OUTLIER_SD * MAD_TO_SD * spread, root, out=root, where=known)
    limit[~known] = np.inf
    return np.asarray(limit)


def reject_outliers(data: FitData, original_weights: FloatArray, residual: FloatArray) -> FitData:
    """The data with outliers at weight 0.

    A median filter on raw data would clip the peaks of the vibration; the residual has no such peaks. Many large
    residuals in one stretch are motion that is not (yet) modelled, not outliers, and are kept. `original_weights` are
    those before any rejection: a sample rejected earlier may be used again.
    """
    weights = original_weights.copy()
    bad = beyond_limit(original_weights, residual)
    for channel in range(weights.shape[1]):
        if _are_scattered(bad[original_weights[:, channel] > 0.0, channel]):
            weights[bad[:, channel], channel] = 0.0
    return replace(data, weights=weights)


def _are_scattered(bad: BoolArray) -> bool:
    """Whether the marked samples are few, or no more clustered than random ones.

    A dozen or more that lie almost all in the beginning, where a decay is largest, are motion that the model lacks.
    """
    n, count = bad.size, int(np.count_nonzero(bad))
    if count <= TUNING.few * n:
        early = int(np.count_nonzero(bad[: int(TUNING.beginning * n)]))
        return count < TUNING.least_misfit or early < TUNING.mostly * count
    if count > TUNING.most * n:
        return False
    fraction = count / n
    neighbours = int(np.count_nonzero(bad[1:] & bad[:-1]))
    expected = n * fraction**2
    tenths = np.array([np.count_nonzero(part) for part in np.array_split(bad, 10)])
    spread = np.sqrt(0.1 * n * fraction * (1.0 - fraction))
    even = np.max(np.abs(tenths - 0.1 * count)) < OUTLIER_SD * spread
    return bool(even and neighbours < expected + OUTLIER_SD * np.sqrt(expected) + OUTLIER_SD)

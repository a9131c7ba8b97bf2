"""Spectrum of a residual, the level of the noise in it, and candidate modes: lines that exceed that level.

The spectrum provides starting values only: the fit itself uses every sample at its own time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, next_fast_len, rfft
from scipy.special import gammaincinv

from modal_id.data import FitData
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Levels of the noise, and windows in which modes are looked for."""

    #: [steps] largest distance of a sample from its place on an even grid
    #: physics: One step is half a cycle at most: the power there changes by (0.01 pi)^2 = 0.1 %.
    even: float = 0.01
    #: [bins] width of the wide window for the noise level
    wide_bins: int = 61
    #: [bins] width of the narrow window for the noise level
    narrow_bins: int = 15
    #: [1] ratio to a mode's frequency beyond which the misfit of a change of its motion is small
    aside: float = 1.25
    #: [half-widths] outer edge of the bins outside a band
    outside: float = 4.0
    #: [samples] shortest beginning of a record that is searched
    #: convention: In fewer the level of the noise is too uncertain.
    min_window_samples: int = 64
    #: [1] relative distance of frequencies within which lines are one
    same: float = 0.01
    #: [1] factor on p log(n) of the information criterion for a line or a pair
    #: convention: 25 % more, because the level around a line is an estimate and several windows or starts are tried.
    caution: float = 1.25


TUNING = Tuning()
EVEN_STEPS, SAME_LINE, LEAST_WINDOW = TUNING.even, TUNING.same, TUNING.min_window_samples
CAUTION = TUNING.caution


_WIDE_BINS = TUNING.wide_bins

# Degrees of freedom of the level in a channel: it is the median of twice as many bins, of which half are independent.
LEVEL_BINS = _WIDE_BINS
# Bins of a block of `least_level`.
_BLOCK = 20


@dataclass(frozen=True)
class ResidualSpectrum:
    """Spectrum of a residual: frequencies in Hz and power of each bin, as in `power_spectrum`."""

    frequency_hz: FloatArray
    power: FloatArray
    threshold: float
    channels: int

    def level(self, frequency_hz: float) -> float:
        """Noise level around a frequency."""
        nearest = np.argmin(np.abs(self.frequency_hz - frequency_hz), keepdims=True)
        return float(local_level(self.power, self.channels, nearest)[0])

    def level_aside(self, frequency_hz: float) -> float:
        """Noise at a frequency relative to white noise, from a fifth to an octave below and above it; 1 where unknown.

        A mode whose motion changes within a few cycles leaves a line too wide for `level`. The geometric mean of both
        sides is exact for a power law.
        """
        ratio = self.frequency_hz / frequency_hz
        sides = [
            self.power[(one > TUNING.aside) & (one < 2.0)] for one in (ratio, 1.0 / np.maximum(ratio, 1e-300))
        ]
        if min(side.size for side in sides) < TUNING.narrow_bins:
            return 1.0
        level = float(np.exp(np.mean([np.log(max(float(np.median(side)), 1e-300)) for side in sides])))
        return level * mean_per_median(self.channels) / self.channels

    def misfit_score(self, centre_hz: float, half_width_hz: float) -> float:
        """Score, as in `Candidate`, of the strongest bin within a band; 0 where no bin lies in it.

        Relative to the level outside the band, since the misfit of a pair by one mode fills the band.
        """
        distance = np.abs(self.frequency_hz - centre_hz)
        near = distance < half_width_hz
        outside = ~near & (distance < max(TUNING.outside * half_width_hz, _WIDE_BINS * self.frequency_hz[1]))
        if not np.any(near) or not np.any(outside):
            return 0.0
        level = float(np.median(self.power[outside])) * mean_per_median(self.channels)
        return float(np.max(self.power[near])) * self.channels / max(level, 1e-300) / self.threshold


def residual_spectrum(data: FitData, residual: FloatArray, variance: FloatArray) -> ResidualSpectrum:
    """Spectrum of a residual, shape (n, k), with its level."""
    k = residual.shape[1]
    frequency, power = power_spectrum(data.time_s, residual, data.weights, variance)
    return ResidualSpectrum(frequency, power, line_threshold(k, data.time_s.size), k)


def nyquist_hz(time_s: FloatArray) -> float:
    """Half the sampling rate, from the median step."""
    return float(0.5 / np.median(np.diff(time_s)))


def power_spectrum(
    time_s: FloatArray, values: FloatArray, weights: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Frequencies and periodogram summed over channels; its expectation is 1 per channel for white noise of `variance`.

    Samples at uneven times are spread linearly over a grid of half the median step: accurate enough to detect lines
    below the Nyquist frequency, not to fit them. Even times need half the grid. There are twice as many bins as
    independent ones.
    """
    step = float(np.median(np.diff(time_s)))
    highest_hz = 0.5 / step
    grids, length, step = _grids(time_s, values, weights, variance, step)
    power = _summed_power(grids, length)
    frequency = np.arange(power.size) / (length * step)
    count = int(np.searchsorted(frequency, highest_hz, side="right"))
    return frequency[:count], power[:count]


def _grids(
    time_s: FloatArray, values: FloatArray, weights: FloatArray, variance: FloatArray, step: float
) -> tuple[list[FloatArray], int, float]:
    """Normalised values of each channel on a grid, the length to which they are padded, and the grid's step."""
    position = (time_s - time_s[0]) / step
    cell = np.rint(position)
    is_even = bool(np.max(np.abs(position - cell), initial=0.0) < EVEN_STEPS)
    if not is_even:
        step *= 0.5
        position *= 2.0
        cell = np.floor(position)
    length = next_fast_len(2 * (int(cell[-1]) + 2), real=True)
    is_complete = is_even and np.array_equal(cell, np.arange(cell.size))
    lower = cell.astype(np.intp)
    upper_part = np.zeros(0) if is_even else position - cell
    grids: list[FloatArray] = []
    for channel in range(values.shape[1]):
        weight = weights[:, channel]
        norm = variance[channel] * np.sum(weight**2)
        if norm <= 0.0:
            continue
        weighted = weight * values[:, channel] / np.sqrt(norm)
        if is_even:
            grid = weighted if is_complete else np.bincount(lower, weighted)
        else:
            grid = np.bincount(lower, weighted * (1.0 - upper_part), minlength=length)
            grid += np.bincount(lower + 1, weighted * upper_part, minlength=length)
        grids.append(np.asarray(grid[:length], dtype=np.float64))
    return grids, length, step


def _summed_power(grids: list[FloatArray], length: int) -> FloatArray:
    """Sum of the powers of the transforms of real series, padded to `length`; shape (length // 2 + 1,)."""
    power = np.zeros(length // 2 + 1)
    for one, other in zip(grids[::2], grids[1::2], strict=False):
        # A complex series holds two real ones: the power at f and -f is twice the sum of theirs.
        transform = fft(one + 1j * other, length)
        both = transform.real**2 + transform.imag**2
        power += 0.5 * (both[: power.size] + np.roll(both[::-1], 1)[: power.size])
    if len(grids) % 2:
        transform = rfft(grids[-1], length)
        power += transform.real**2
        power += transform.imag**2
    return power


@cache
def mean_per_median(channels: int) -> float:
    """Ratio of mean and median of the power of white noise, summed over channels."""
    return channels / float(gammaincinv(channels, 0.5))


def local_level(power: FloatArray, channels: int, bins: NDArray[np.intp]) -> FloatArray:
    """Noise level around these bins: the mean implied by the median, the larger of a wide and a narrow window."""
    level = np.zeros(bins.size)
    for half in (_WIDE_BINS, TUNING.narrow_bins):
        size = min(2 * half, power.size)
        rows = bins[:, None] + np.arange(-(size // 2), size - size // 2)
        # Reflected at both ends.
        rows = np.where(rows < 0, -1 - rows, np.where(rows < power.size, rows, 2 * power.size - 1 - rows))
        level = np.maximum(level, np.partition(power[rows], size // 2, axis=1)[:, size // 2])
    return np.asarray(level * mean_per_median(channels))


def least_level(power: FloatArray, channels: int) -> FloatArray:
    """Lower bound of `local_level` at every bin, which takes a fraction of its time; 0 at both ends.

    The wide window of a bin holds the bin's own block, two blocks on each side, and 22 further bins. Of these 122
    values, at most 5 x 7 + 22 = 57 are below the smallest of the five blocks' eighth values: less than half.
    """
    least = np.zeros(power.size)
    if power.size >= 2 * _WIDE_BINS:
        blocks = power[: power.size // _BLOCK * _BLOCK].reshape(-1, _BLOCK)
        eighth = np.partition(blocks, 7, axis=1)[:, 7]
        smallest = np.min(np.lib.stride_tricks.sliding_window_view(eighth, 5), axis=1)
        least[2 * _BLOCK : (2 + smallest.size) * _BLOCK] = np.repeat(smallest, _BLOCK)
    return least * mean_per_median(channels)


def line_threshold(channels: int, samples: int) -> float:
    """Smallest significant drop of half the sum of squares, in units of the noise, for one more mode."""
    # Twice the power is the drop of the sum of squares; the criterion asks for p log(n), p = 2 + 2 k parameters.
    return CAUTION * 0.5 * (2.0 + 2.0 * channels) * float(np.log(samples * channels)) + channels


# A mode that decays early is detectable in the beginning of a record only.
_WINDOW_FRACTIONS = (1.0, 0.25, 0.0625, 0.0156, 0.0039)


# Bins whose level is computed at one time.
_AT_ONCE = 64


@dataclass(frozen=True)
class Band:
    """Frequencies excluded from the search."""

    centre_hz: float
    half_width_hz: float


@dataclass(frozen=True)
class Candidate:
    """A line of the spectrum.

    ``score`` is the drop of the weighted residual sum of squares, in units of the local noise, over twice
    the penalty of the Bayesian information criterion for a mode: significant above 1.
    """

    frequency_hz: float
    decay_per_s: float
    score: float

    @property
    def band(self) -> Band:
        """Frequencies that are those of this line."""
        return Band(self.frequency_hz, SAME_LINE * self.frequency_hz)


def candidates(
    data: FitData,
    residual: FloatArray,
    variance: FloatArray,
    lowest_hz: float,
    excluded: tuple[Band, ...],
    spectrum: ResidualSpectrum | None = None,
) -> list[Candidate]:
    """Strongest line of each window, best first; lines below `lowest_hz` belong to the baseline.

    `residual` has shape (n, k); `variance`, shape (k,), is the noise variance and weights the channels; `spectrum` is
    that of the whole residual, where it is known.
    """
    windows = _windows(data, residual, variance, spectrum)
    found = [_strongest(seen, span, lowest_hz, excluded) for seen, span in windows]
    return sorted((c for c in found if c is not None), key=lambda c: -c.score)


def highest_near(data: FitData, residual: FloatArray, variance: FloatArray, band: Band) -> list[Candidate]:
    """Highest bin of each window within a band, or within a bin of its centre, above noise or not; scores are 0."""
    found = []
    for seen, span in _windows(data, residual, variance):
        reach = max(band.half_width_hz, 1.0 / span)
        look = np.flatnonzero(np.abs(seen.frequency_hz - band.centre_hz) < reach)
        look = look[(look > 0) & (look < seen.frequency_hz.size - 1)]
        if look.size:
            peak = int(look[np.argmax(seen.power[look])])
            found.append(Candidate(_between_bins(seen, peak), 1.0 / span, 0.0))
    return found


def _windows(
    data: FitData, residual: FloatArray, variance: FloatArray, spectrum: ResidualSpectrum | None = None
) -> Iterator[tuple[ResidualSpectrum, float]]:
    """Spectrum of the whole residual and of its beginnings, each with its duration in s."""
    for fraction in _WINDOW_FRACTIONS:
        count = _window(data, fraction)
        if count < min(LEAST_WINDOW, data.time_s.size):
            continue
        seen = spectrum if fraction == 1.0 else None
        if seen is None:
            seen = residual_spectrum(data.rows(slice(0, count)), residual[:count], variance)
        yield seen, float(data.time_s[count - 1] - data.time_s[0])


def _window(data: FitData, fraction: float) -> int:
    return int(np.searchsorted(data.time_s, data.time_s[0] + fraction * data.span_s, side="right"))


def _strongest(
    spectrum: ResidualSpectrum, span: float, lowest_hz: float, excluded: tuple[Band, ...]
) -> Candidate | None:
    frequency = spectrum.frequency_hz
    look = (frequency >= max(lowest_hz, 2.0 / span)) & (frequency < frequency[-1] - 4.0 / span)
    for band in excluded:
        look &= np.abs(frequency - band.centre_hz) > max(band.half_width_hz, 2.5 / span)
    if not np.any(look):
        return None
    peak, score = largest_significant(spectrum, look)
    if peak is None:
        return None
    return Candidate(_between_bins(spectrum, peak), 1.0 / span, score)


def _between_bins(spectrum: ResidualSpectrum, peak: int) -> float:
    """Frequency of the parabola's top through a bin and its neighbours, at most half a bin away.

    Beside a band that is left out, a bin may be below its neighbour, and the top of the parabola anywhere.
    """
    frequency, around = spectrum.frequency_hz, spectrum.power[max(peak - 1, 0) : peak + 2]
    shift = 0.0
    if around.size == 3 and around[0] - 2.0 * around[1] + around[2] < 0.0:
        top = 0.5 * (around[0] - around[2]) / (around[0] - 2.0 * around[1] + around[2])
        shift = min(max(top, -0.5), 0.5)
    return float(frequency[peak] + shift * (frequency[1] - frequency[0]))


def largest_significant(spectrum: ResidualSpectrum, look: BoolArray) -> tuple[int | None, float]:
    """Bin of the mask with the largest power among those that exceed the threshold, None without one, and its score.

    The level is computed only for bins that exceed its lower bound, in order of their power.
    """
    power, channels, threshold = spectrum.power, spectrum.channels, spectrum.threshold
    least = least_level(power, channels)
    bins = np.flatnonzero(look & (power * channels > threshold * least))
    bins = bins[np.argsort(-power[bins], kind="stable")]
    for first in range(0, bins.size, _AT_ONCE):
        own = bins[first : first + _AT_ONCE]
        excess = power[own] / np.maximum(local_level(power, channels, own), 1e-300) * channels
        best = int(np.argmax(excess > threshold))
        if excess[best] > threshold:
            return int(own[best]), float(excess[best] / threshold)
    return None, 0.0

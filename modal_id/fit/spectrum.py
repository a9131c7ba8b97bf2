"""Candidate modes: lines of the residual spectrum that exceed the noise around them.

The spectrum provides starting values only: the fit itself uses every sample at its own time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import median_filter
from scipy.stats import gamma

from modal_id.data.samples import FitData
from tracker.arrays import FloatArray

# A mode that decays early is detectable in the beginning of a record only.
_WINDOW_FRACTIONS = (1.0, 0.25, 0.0625, 0.0156, 0.0039)
# In a beginning of fewer samples the level of the noise is too uncertain.
_MIN_WINDOW_SAMPLES = 64
# Largest distance of an even sample from its place, in steps.
_EVEN = 1e-3
_WIDE_BINS = 61
_NARROW_BINS = 15
# Outer edge of the bins outside a band, in half-widths of the band.
_OUTSIDE = 4.0


@dataclass(frozen=True)
class Candidate:
    """A line of the spectrum.

    ``score`` is the drop of the weighted residual sum of squares, in units of the local noise, over twice
    the penalty of the Bayesian information criterion for a mode: significant above 1.
    """

    frequency_hz: float
    decay_per_s: float
    score: float


@dataclass(frozen=True)
class Band:
    """Frequencies excluded from the search."""

    centre_hz: float
    half_width_hz: float


@dataclass(frozen=True)
class ResidualSpectrum:
    """Spectrum of a residual: frequencies in Hz, power and local level of each bin, as in `power_spectrum`."""

    frequency_hz: FloatArray
    power: FloatArray
    level: FloatArray
    threshold: float
    channels: int

    def misfit_score(self, centre_hz: float, half_width_hz: float) -> float:
        """Score, as in `Candidate`, of the strongest bin within a band; 0 where no bin lies in it.

        Relative to the level outside the band, since the misfit of a pair by one mode fills the band.
        """
        distance = np.abs(self.frequency_hz - centre_hz)
        near = distance < half_width_hz
        outside = ~near & (distance < max(_OUTSIDE * half_width_hz, _WIDE_BINS * self.frequency_hz[1]))
        if not np.any(near) or not np.any(outside):
            return 0.0
        level = float(np.median(self.power[outside])) * mean_per_median(self.channels)
        return float(np.max(self.power[near])) * self.channels / max(level, 1e-300) / self.threshold


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
    found = []
    for fraction in _WINDOW_FRACTIONS:
        count = _window(data, fraction)
        if count < min(_MIN_WINDOW_SAMPLES, data.time_s.size):
            continue
        seen = spectrum if fraction == 1.0 else None
        if seen is None:
            seen = residual_spectrum(data.rows(slice(0, count)), residual[:count], variance)
        found.append(_strongest(seen, float(data.time_s[count - 1] - data.time_s[0]), lowest_hz, excluded))
    return sorted((c for c in found if c is not None), key=lambda c: -c.score)


def residual_spectrum(data: FitData, residual: FloatArray, variance: FloatArray) -> ResidualSpectrum:
    """Spectrum of a residual, shape (n, k), with its level."""
    k = residual.shape[1]
    frequency, power = power_spectrum(data.time_s, residual, data.weights, variance)
    return ResidualSpectrum(frequency, power, local_level(power, k), line_threshold(k, data.time_s.size), k)


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
    position = (time_s - time_s[0]) / step
    cell = np.rint(position)
    is_even = bool(np.max(np.abs(position - cell), initial=0.0) < _EVEN)
    if not is_even:
        step *= 0.5
        position *= 2.0
        cell = np.floor(position)
    length = next_fast_len(2 * (int(cell[-1]) + 2), real=True)
    lower = cell.astype(np.intp)
    upper_part = np.zeros(0) if is_even else position - cell
    power = np.zeros(length // 2 + 1)
    for channel in range(values.shape[1]):
        weight = weights[:, channel]
        norm = variance[channel] * np.sum(weight**2)
        if norm <= 0.0:
            continue
        weighted = weight * values[:, channel]
        if is_even:
            grid = np.bincount(lower, weighted, minlength=length)
        else:
            grid = np.bincount(lower, weighted * (1.0 - upper_part), minlength=length)
            grid += np.bincount(lower + 1, weighted * upper_part, minlength=length)
        transform = rfft(grid[:length])
        power += (transform.real**2 + transform.imag**2) / norm
    frequency = np.arange(power.size) / (length * step)
    keep = frequency <= highest_hz
    return frequency[keep], power[keep]


@cache
def mean_per_median(channels: int) -> float:
    """Ratio of mean and median of the power of white noise, summed over channels."""
    return channels / float(gamma.median(channels))


def local_level(power: FloatArray, channels: int) -> FloatArray:
    """Noise level around each bin: the mean implied by the running median, the larger of a wide and a narrow window."""
    wide = median_filter(power, min(_WIDE_BINS * 2, power.size), mode="reflect")
    narrow = median_filter(power, min(_NARROW_BINS * 2, power.size), mode="reflect")
    return np.asarray(np.maximum(wide, narrow) * mean_per_median(channels))


def _window(data: FitData, fraction: float) -> int:
    return int(np.searchsorted(data.time_s, data.time_s[0] + fraction * data.span_s, side="right"))


def _strongest(
    spectrum: ResidualSpectrum, span: float, lowest_hz: float, excluded: tuple[Band, ...]
) -> Candidate | None:
    frequency, power = spectrum.frequency_hz, spectrum.power
    look = (frequency >= max(lowest_hz, 2.0 / span)) & (frequency < frequency[-1] - 4.0 / span)
    for band in excluded:
        look &= np.abs(frequency - band.centre_hz) > max(band.half_width_hz, 2.5 / span)
    if not np.any(look):
        return None
    excess = np.where(look, power / np.maximum(spectrum.level, 1e-300) * spectrum.channels, 0.0)
    ranking = np.where(excess > 0.0, power, 0.0) * (excess > spectrum.threshold)
    if not np.any(ranking > 0.0):
        return None
    peak = int(np.argmax(ranking))
    around = power[max(peak - 1, 0) : peak + 2]
    shift = 0.0
    if around.size == 3 and around[0] - 2.0 * around[1] + around[2] < 0.0:
        shift = 0.5 * (around[0] - around[2]) / (around[0] - 2.0 * around[1] + around[2])
    step = frequency[1] - frequency[0]
    score = excess[peak] / spectrum.threshold
    return Candidate(float(frequency[peak] + shift * step), 1.0 / span, float(score))


def line_threshold(channels: int, samples: int) -> float:
    """Smallest significant drop of half the sum of squares, in units of the noise, for one more mode."""
    # Twice the power is the drop of the sum of squares; the criterion asks for p log(n), p = 2 + 2 k parameters.
    # 25 % more, because the level around the line is an estimate and several windows are searched.
    return 1.25 * 0.5 * (2.0 + 2.0 * channels) * float(np.log(samples * channels)) + channels

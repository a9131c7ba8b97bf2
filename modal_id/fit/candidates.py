"""Candidate modes: lines of the residual spectrum that exceed the noise around them.

The spectrum provides starting values only: the fit itself uses every sample at its own time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData
from modal_id.fit.spectrum import ResidualSpectrum, least_level, local_level, residual_spectrum
from tracker import BoolArray, FloatArray

# A mode that decays early is detectable in the beginning of a record only.
_WINDOW_FRACTIONS = (1.0, 0.25, 0.0625, 0.0156, 0.0039)


@dataclass(frozen=True)
class Tuning:
    """Windows in which modes are looked for."""

    #: [samples] shortest beginning of a record that is searched
    #: convention: In fewer the level of the noise is too uncertain.
    min_window_samples: int = 64


TUNING = Tuning()

# Bins whose level is computed at one time.
_AT_ONCE = 64


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
        if count < min(TUNING.min_window_samples, data.time_s.size):
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

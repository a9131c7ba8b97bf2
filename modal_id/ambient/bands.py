"""Bands of a spectrum that may hold modes: peaks of the largest singular value at several resolutions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import find_peaks

from modal_id.ambient.model import MOST_MODES, BandData
from modal_id.ambient.spectrum import REACH, Spectrum, transfer
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Peaks and bands."""

    #: [bins] frequencies averaged at the finest resolution
    #: physics: The peak of a mode whose damping ratio has a relative sd of 0.3 is this wide.
    finest: int = 4
    #: [sd] prominence of a peak of the logarithm from which the band is examined
    #: statistics: Averages of 4 to 64 bins of noise reach 7.5 to 6 once in 10^5; the evidence decides what is a mode.
    prominence_sd: float = 7.5
    #: [1] half-width of a peak over the average, above which the average resolves it
    #: physics: The average of a line has half of its own width.
    resolved: float = 0.75
    #: [1] largest reach of a band, and widest average, over the frequency
    #: physics: The force and the noise are taken as flat, and as a power law, in a band.
    relative_reach: float = 0.3
    #: [1] factor on the reach of the bands in which modes are first looked for
    #: measurement: The second of two modes 3 % apart lay outside a band of 6 half-widths of the first, and moved it by
    #: 4 sd (seed 1116 of benchmarks.ambient).
    first_reach: float = 2.0
    #: [bins] smallest reach
    least_reach: float = 24.0
    #: [1] width of a sum of neighbouring frequencies over the distance from the nearest peak
    #: physics: The spectrum of a mode is nearly straight over it: the mean and the middle differ by 0.3 %.
    merged: float = 0.1
    #: [peaks] most peaks that are examined
    #: convention: Limits the computing time.
    most_candidates: int = 24


TUNING = Tuning()


class Peak(NamedTuple):
    """Frequency and half-width at half power in Hz, and prominence in sd."""

    frequency_hz: float
    half_width_hz: float
    strength: float


class Band(NamedTuple):
    """Limits in Hz and the peaks within them."""

    low_hz: float
    high_hz: float
    peaks: tuple[Peak, ...]


class Tail(NamedTuple):
    """Frequency in Hz, damping ratio and shape, shape (k,), times the root of the force's density, of a mode."""

    frequency_hz: float
    damping_ratio: float
    shape: FloatArray


class SingularValues(NamedTuple):
    """Singular values of the averaged spectral density matrix over frequency, shapes (b,) and (b, k)."""

    frequency_hz: FloatArray
    values: FloatArray


def singular_values(spectrum: Spectrum, bins: int) -> SingularValues:
    """Averages of `bins` frequencies that overlap by half, largest singular value first."""
    return _of_averages(spectrum.frequency_hz, _products(spectrum, bins // 2), bins // 2)


def _products(spectrum: Spectrum, bins: int) -> ComplexArray:
    """Means of F F* over successive groups of frequencies, shape (b, k, k)."""
    k = spectrum.values.shape[1]
    count = spectrum.values.shape[0] // bins
    grouped = spectrum.values[: count * bins].reshape(count, bins, k)
    return np.asarray(np.einsum("gbi,gbj->gij", grouped, np.conj(grouped)) / bins)


def _of_averages(frequency_hz: FloatArray, products: ComplexArray, bins: int) -> SingularValues:
    averaged = 0.5 * (products[1:] + products[:-1])
    centres = frequency_hz[bins - 1 :: bins][: averaged.shape[0]]
    # The matrices are Hermitian: their eigenvalues are their singular values.
    return SingularValues(centres, np.asarray(np.linalg.eigvalsh(averaged)[:, ::-1], dtype=np.float64))


def find_peaks_of(spectrum: Spectrum) -> list[Peak]:
    """Peaks at all resolutions that are not coarser than the peak, most prominent first; of those that overlap, one.

    Two modes that are close may share a peak: how many there are is not asked here.
    """
    resolved: list[Peak] = []
    narrow: list[Peak] = []
    bins = TUNING.finest // 2
    products = _products(spectrum, bins)
    while products.shape[0] > 8:
        width_hz = 2.0 * bins / spectrum.span_s
        for peak in _peaks_at(_of_averages(spectrum.frequency_hz, products, bins), 2 * bins):
            (resolved if peak.half_width_hz > TUNING.resolved * width_hz else narrow).append(peak)
        even = products[: 2 * (products.shape[0] // 2)]
        products, bins = 0.5 * (even[::2] + even[1::2]), 2 * bins
    resolved.sort(key=lambda peak: -peak.strength)
    kept: list[Peak] = []
    for peak in resolved + narrow:
        if all(
            abs(peak.frequency_hz - one.frequency_hz) > 1.5 * max(peak.half_width_hz, one.half_width_hz)
            for one in kept
        ):
            kept.append(peak)
    kept.sort(key=lambda peak: -peak.strength)
    return kept[: TUNING.most_candidates]


def _peaks_at(curve: SingularValues, bins: int) -> list[Peak]:
    log_power = np.log(np.maximum(curve.values[:, 0], 1e-300))
    at, properties = find_peaks(log_power, prominence=TUNING.prominence_sd / np.sqrt(bins))
    step_hz = curve.frequency_hz[1] - curve.frequency_hz[0]
    peaks = []
    for index, prominence in zip(at, properties["prominences"], strict=True):
        hz = float(curve.frequency_hz[index])
        level = log_power[index] - np.log(2.0)
        ends = [_crossing(log_power[index::-1], level), _crossing(log_power[index:], level)]
        # The mean of both sides: noise cuts one of them short; a neighbouring peak lengthens one.
        half_width = max(0.5 * (min(ends) + min(max(ends), 3.0 * min(ends))), 0.5) * step_hz
        if 2.0 * step_hz < TUNING.relative_reach * hz:
            peaks.append(Peak(hz, float(half_width), float(prominence * np.sqrt(bins))))
    return sorted(peaks, key=lambda peak: -peak.strength)


def _crossing(curve: FloatArray, level: float) -> float:
    """Distance in steps from the first value, above the level, to where a curve falls below it."""
    below = int(np.argmax(curve < level))
    if curve[below] >= level:
        return float(curve.size)
    return float(below - (level - curve[below]) / (curve[below - 1] - curve[below]))


def bands_of(spectrum: Spectrum, peaks: list[Peak], factor: float = 1.0) -> list[Band]:
    """Bands in order of frequency: peaks whose responses overlap share one, others are divided where both are weak.

    `factor` is on the reach of each peak.
    """
    ordered = sorted(peaks)
    groups: list[list[Peak]] = []
    for peak in ordered:
        last = groups[-1][-1] if groups else None
        near = last is not None and peak.frequency_hz - last.frequency_hz < REACH * (
            peak.half_width_hz + last.half_width_hz
        )
        if near and len(groups[-1]) < MOST_MODES:
            groups[-1].append(peak)
        else:
            groups.append([peak])
    step_hz = 1.0 / spectrum.span_s
    bands = []
    for group in groups:
        reaches = [
            np.clip(
                factor * REACH * peak.half_width_hz,
                factor * TUNING.least_reach * step_hz,
                TUNING.relative_reach * peak.frequency_hz,
            )
            for peak in group
        ]
        low = min(peak.frequency_hz - reach for peak, reach in zip(group, reaches, strict=True))
        high = max(peak.frequency_hz + reach for peak, reach in zip(group, reaches, strict=True))
        bands.append(
            Band(
                float(max(low, spectrum.frequency_hz[0])),
                float(min(high, spectrum.frequency_hz[-1])),
                tuple(group),
            )
        )
    for index in range(len(bands) - 1):
        first, second = bands[index], bands[index + 1]
        if first.high_hz > second.low_hz:
            a, b = first.peaks[-1], second.peaks[0]
            # Equal distances in half-widths, as far as a valley can be told without a fit.
            share = a.half_width_hz / (a.half_width_hz + b.half_width_hz)
            middle = a.frequency_hz + share * (b.frequency_hz - a.frequency_hz)
            bands[index] = first._replace(high_hz=middle)
            bands[index + 1] = second._replace(low_hz=middle)
    return bands


def band_data(
    spectrum: Spectrum, band: Band, modes: list[tuple[float, float]], tails: Sequence[Tail]
) -> BandData:
    """Sums of the periodogram of a band.

    `modes` are (frequency, half-width) in Hz of those known so far: near them, no frequencies are summed. `tails` are
    modes beside the band.
    """
    inside = (spectrum.frequency_hz >= band.low_hz) & (spectrum.frequency_hz <= band.high_hz)
    frequency_hz, values = spectrum.frequency_hz[inside], spectrum.values[inside]
    starts = _starts(frequency_hz, modes)
    bins = np.diff(np.append(starts, frequency_hz.size)).astype(float)
    total = np.sum(np.abs(values) ** 2, axis=1)
    directions = _directions(values, np.add.reduceat(total, starts), starts)
    seen = values @ directions
    products = seen[:, :, None] * np.conj(seen[:, None, :])
    mean_hz = np.add.reduceat(frequency_hz, starts) / bins
    record = spectrum.samples, spectrum.step_s
    responses = [transfer(mean_hz, one.frequency_hz, one.damping_ratio, *record) for one in tails]
    return BandData(
        mean_hz,
        bins,
        np.add.reduceat(products, starts, axis=0),
        spectrum.samples,
        spectrum.step_s,
        directions,
        directions.T @ np.array([tail.shape for tail in tails]).reshape(len(tails), directions.shape[0]).T,
        np.array(responses, dtype=complex).reshape(len(tails), bins.size).T,
    )


def _starts(frequency_hz: FloatArray, modes: list[tuple[float, float]]) -> np.ndarray:
    """First frequency of each sum."""
    distance = np.min([np.hypot(frequency_hz - hz, half) for hz, half in modes], axis=0)
    step_hz = frequency_hz[1] - frequency_hz[0]
    passed = np.cumsum(step_hz / np.maximum(TUNING.merged * distance, step_hz))
    return np.flatnonzero(np.diff(np.floor(passed + 1e-9), prepend=-1.0) > 0.0)


def _directions(values: ComplexArray, power: FloatArray, starts: np.ndarray) -> FloatArray:
    """Main directions of the motion of a band, as many as modes, shape (k, r): each sum counts by its bins."""
    k = values.shape[1]
    if k <= MOST_MODES:
        return np.eye(k)
    bins = np.diff(np.append(starts, values.shape[0]))
    weights = np.repeat(bins / np.maximum(power, 1e-300), bins)
    mean = np.real(np.conj(values.T * weights) @ values)
    return np.linalg.eigh(mean)[1][:, : -MOST_MODES - 1 : -1]

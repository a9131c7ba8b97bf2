"""Periodogram of even samples, missing ones filled, drift removed, channels scaled to equal noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.linalg import solve_toeplitz, solveh_banded

from modal_id.data import FitData, baseline_splines
from tracker import BoolArray, ComplexArray, Failure, FloatArray


@dataclass(frozen=True)
class Tuning:
    """What counts as even, and what is filled."""

    #: [steps] largest distance of a time from an even grid
    #: physics: A twentieth of a step is a phase error of 0.08 rad at a quarter of the sampling rate: 0.6 % of the power
    #: there becomes noise.
    jitter: float = 0.05
    #: [1] largest share of missing samples of a channel
    #: physics: A filled sample has at most the power of the motion: the density changes by up to twice the share, the
    #: same for all frequencies of a mode; frequency and damping ratio do not.
    missing: float = 0.1
    #: [samples] longest run of missing samples that is filled
    longest_gap: int = 16
    #: [samples] order of the autoregressive model that fills
    order: int = 32
    #: [1] bandwidth of the drift that is removed, in cycles per record
    #: physics: A mode needs tens of cycles to be identified; slower drift leaks into all frequencies.
    drift_cycles: float = 3.0
    #: [bins] half-width of what is left out about a line
    #: physics: Without a taper, 0.03 of the power of a line lies further away.
    line_bins: float = 3.5
    #: [1] number of bands, equal in log frequency, in which the noise of a channel is measured
    noise_bands: int = 16


TUNING = Tuning()


@dataclass(frozen=True)
class Spectrum:
    """One-sided periodogram vectors ``sqrt(2 dt / n) sum y exp(-i w t)`` of channels with equal noise.

    Attributes
    ----------
    frequency_hz : array, shape (f,)
        Above the drift, below half the sampling rate.
    values : complex array, shape (f, k)
    noise_sd : array, shape (k,)
        By which the channels were divided.
    samples, step_s : int, float
    motion : array, shape (n, k)
        Even samples without drift, divided by `noise_sd`.
    filled : bool array, shape (n, k)
        Samples that were missing.
    """

    frequency_hz: FloatArray
    values: ComplexArray
    noise_sd: FloatArray
    samples: int
    step_s: float
    motion: FloatArray
    filled: BoolArray

    @property
    def span_s(self) -> float:
        """Length of the record."""
        return self.samples * self.step_s

    def without(self, lines_hz: list[float]) -> Spectrum:
        """The spectrum without the frequencies within a few bins of lines."""
        kept = np.ones(self.frequency_hz.size, dtype=bool)
        for hz in lines_hz:
            kept &= np.abs(self.frequency_hz - hz) > TUNING.line_bins / self.span_s
        return replace(self, frequency_hz=self.frequency_hz[kept], values=self.values[kept])


def spectrum_of(data: FitData) -> Spectrum | Failure:
    """Spectrum of the samples, or why there is none."""
    even = _on_grid(data)
    if isinstance(even, Failure):
        return even
    values, seen, step_s = even
    problem = _too_much_missing(seen, step_s)
    if problem is not None:
        return problem
    n = values.shape[0]
    motion = np.column_stack(
        [_filled(one, mask) for one, mask in zip((values - _mean(values, seen)).T, seen.T, strict=True)]
    )
    motion -= _drift(motion, step_s)
    transformed = rfft(motion, axis=0) * np.sqrt(2.0 * step_s / n)
    # Frequencies within the drift and the last, whose value is real, are left out.
    rows = slice(int(2.0 * TUNING.drift_cycles) + 1, (n - 1) // 2 + 1)
    frequency_hz = np.arange(n // 2 + 1)[rows] / (n * step_s)
    transformed = transformed[rows]
    noise_sd = _noise_sd(transformed)
    return Spectrum(frequency_hz, transformed / noise_sd, noise_sd, n, step_s, motion / noise_sd, ~seen)


def _on_grid(data: FitData) -> tuple[FloatArray, BoolArray, float] | Failure:
    """Values on an even grid, which of them are seen, and the step."""
    place = np.rint(data.time_s / data.step_s)
    # The median step of rounded times is off by their rounding: the grid is that of the whole record.
    for _ in range(2):
        step_s, start_s = np.polyfit(place, data.time_s, 1)
        place = np.rint((data.time_s - start_s) / step_s)
    off = np.abs(data.time_s - start_s - step_s * place) / step_s
    if float(np.max(off)) > TUNING.jitter or np.any(np.diff(place) < 1.0):
        return Failure(
            f"ambient identification needs an even sampling rate: times differ from an even grid by up to "
            f"{float(np.max(off)):.2g} of a step, and at most {TUNING.jitter:g} is allowed",
            next_step="record at a constant frame rate, or identify a free decay, which may have uneven times",
        )
    rows = (place - place[0]).astype(np.intp)
    values = np.zeros((rows[-1] + 1, data.values.shape[1]))
    seen = np.zeros(values.shape, dtype=bool)
    values[rows], seen[rows] = data.values, data.weights > 0.0
    return values, seen, float(step_s)


def _too_much_missing(seen: BoolArray, step_s: float) -> Failure | None:
    share = 1.0 - float(np.min(np.mean(seen, axis=0)))
    edges = np.diff(np.pad(~seen, ((1, 1), (0, 0))).astype(np.int8), axis=0)
    lengths = np.nonzero(edges.T == -1)[1] - np.nonzero(edges.T == 1)[1]
    longest = int(np.max(lengths, initial=0))
    if share <= TUNING.missing and longest <= TUNING.longest_gap:
        return None
    return Failure(
        f"ambient identification fills single missing samples: up to {100.0 * TUNING.missing:g} % of a channel and "
        f"{TUNING.longest_gap} in a row; {100.0 * share:.2g} % of a channel are missing, and {longest} in a row "
        f"({longest * step_s:.2g} s)",
        next_step="cut the record with onset_s and end_s to a part without long gaps, or leave the channel out",
    )


def _mean(values: FloatArray, seen: BoolArray) -> FloatArray:
    return np.asarray(np.sum(values, axis=0) / np.maximum(np.count_nonzero(seen, axis=0), 1))


def _filled(values: FloatArray, seen: BoolArray) -> FloatArray:
    """Values with the missing ones as an autoregressive model of the channel predicts them from both sides.

    Least squares of the model's residual: Janssen, Veldhuis & Vries (1986), doi:10.1109/TASSP.1986.1164824.
    """
    missing = np.flatnonzero(~seen)
    if not missing.size:
        return values
    values = np.where(seen, values, 0.0)
    straight = np.interp(missing, np.flatnonzero(seen), values[seen])
    values[missing] = straight
    order = min(TUNING.order, values.size // 8)
    length = next_fast_len(values.size + order, real=True)
    power = np.abs(rfft(values, length)) ** 2
    lags = np.fft.irfft(power, length)[: order + 1]
    lags[0] *= 1.0 + 1e-9
    if lags[0] <= 0.0:
        return values
    model = np.append(1.0, -solve_toeplitz(lags[:order], lags[1:]))
    products = np.correlate(model, model, "full")[order:]
    values[missing] = 0.0
    # The normal equations of the missing samples are banded: those further apart than the order do not meet.
    right = -np.convolve(values, np.concatenate([products[:0:-1], products]), "same")[missing]
    bands = np.zeros((order + 1, missing.size))
    for shift in range(min(order, missing.size - 1) + 1):
        apart = missing[shift:] - missing[: missing.size - shift]
        bands[shift, : missing.size - shift] = np.where(
            apart <= order, products[np.minimum(apart, order)], 0.0
        )
    values[missing] = solveh_banded(bands, right, lower=True)
    return values


def _drift(values: FloatArray, step_s: float) -> FloatArray:
    """Least-squares splines through the channels."""
    time_s = step_s * np.arange(values.shape[0], dtype=np.float64)
    splines = baseline_splines(time_s, TUNING.drift_cycles / (values.shape[0] * step_s))[:]
    normal = (splines.T @ splines).toarray()
    return np.asarray(splines @ np.linalg.solve(normal, splines.T @ values))


def _noise_sd(transformed: ComplexArray) -> FloatArray:
    """Square root of the lowest level of each channel's spectrum, shape (k,).

    Medians over bands: the power of noise in a bin is exponential, with a median of ln 2 of the mean.
    """
    count = min(TUNING.noise_bands, max(transformed.shape[0] // 64, 1))
    edges = np.unique(np.geomspace(32, transformed.shape[0], count + 1).astype(np.intp))
    edges[0] = 0
    power = np.abs(transformed) ** 2
    levels = [np.median(power[a:b], axis=0) / np.log(2.0) for a, b in pairwise(edges.tolist())]
    largest = float(np.max(power))
    return np.asarray(
        np.sqrt(np.maximum(np.min(levels, axis=0), max(1e-14 * largest, 1e-300))), dtype=np.float64
    )

"""Spectrum of stationary motion: periodogram of a record, its expectation for one mode, whether it is stationary."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.linalg import solve_toeplitz, solveh_banded
from scipy.special import fdtrc, gammainccinv

from modal_id.data import FitData, baseline_splines
from modal_id.modes import RARE
from modal_id.response import MOST_MISSING
from modal_id.sentences import Reason, Refusal
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """What counts as even, what is filled, and the power of blocks."""

    #: [steps] largest distance of a time from an even grid
    #: physics: A twentieth of a step is a phase error of 0.08 rad at a quarter of the sampling rate: 0.6 % of the power
    #: there becomes noise.
    jitter: float = 0.05
    #: [samples] order of the autoregressive model that fills gaps of half as many samples
    order: int = 32
    #: [1] bandwidth of the drift that is removed, in cycles per record
    #: physics: A mode needs tens of cycles to be identified; slower drift leaks into all frequencies.
    drift_cycles: float = 3.0
    #: [bins] half-width of what is left out about a line
    #: physics: Without a taper, 0.03 of the power of a line lies further away.
    line_bins: float = 3.5
    #: [1] number of bands, equal in log frequency, in which the noise of a channel is measured
    noise_bands: int = 16
    #: [1] independent values of the power in a block, at least
    #: statistics: The largest of 50 blocks is then below six times the mean.
    least_values: float = 4.0
    #: [blocks] most blocks
    most_blocks: int = 50
    #: [blocks] fewest blocks
    least_blocks: int = 6
    #: [half-widths] reach of a band on both sides of a mode
    #: measurement: 0.58 of the information on zeta lies within 6 half-widths, 0.76 within 12; with 12, the skirts of
    #: other modes moved frequencies far above the noise by 1.5 sd rms.
    reach: float = 6.0
    #: [1] share of the power in blocks above the limit from which the record is refused
    #: convention: Below it, the stationary part determines the spectrum.
    share: float = 0.3


TUNING = Tuning()
REACH = TUNING.reach
_LONGEST_GAP = TUNING.order // 2


def transfer(
    frequency_hz: FloatArray, natural_hz: float, zeta: float, samples: int, step_s: float
) -> ComplexArray:
    """Receptance of a mode, 1 at rest, with the modulus that leakage and aliasing leave; shape of `frequency_hz`.

    Parameters
    ----------
    frequency_hz : array, shape (g,)
        Frequencies of the periodogram, 0 to half the sampling rate.
    natural_hz, zeta : float
        Undamped natural frequency and damping ratio, 0 < zeta < 1.
    samples, step_s : int, float
        Length of the record and its time step.

    Notes
    -----
    The squared modulus is the expected periodogram of the displacement of
    ``x'' + 2 zeta w x' + w^2 x = w^2 p``, p white with one-sided spectral density 1: the transform of its
    autocovariance under the triangular window of a record without taper,
    ``2 dt [R(0) + 2 sum_m (1 - m / n) R(m dt) cos(2 pi f m dt)]``, summed in closed form, as
    ``R(t) = (pi f / 4 zeta) Re[(1 - i zeta / sqrt(1 - zeta^2)) exp(lambda |t|)]``. With the receptance itself,
    ``1 / ((1 - b^2)^2 + (2 zeta b)^2)``, zeta would be too large by 1 / (w T): leakage widens a peak of the half-width
    zeta w to zeta w + 1 / T. The idea is that of the debiased Whittle likelihood: Sykulski et al. (2019),
    doi:10.1093/biomet/asy071. The phase is that of the receptance.
    """
    omega = 2.0 * np.pi * natural_hz
    root = np.sqrt(1.0 - zeta**2)
    factor = complex(1.0, -zeta / root)
    pole = omega * complex(-zeta, root)
    turn = 2.0 * np.pi * frequency_hz * step_s
    total = np.ones(frequency_hz.size)
    for sign in (-1.0, 1.0):
        log_q = pole * step_s + sign * 1j * turn
        # 1 - q without cancellation where the step is short
        rest = -np.expm1(log_q)
        q = np.exp(log_q)
        total += np.real(factor * (q / rest + q * np.expm1(samples * log_q) / (samples * rest**2)))
    power = (np.pi * natural_hz / (4.0 * zeta)) * 2.0 * step_s * np.maximum(total, 1e-300)
    ratio = frequency_hz / natural_hz
    angle = -np.arctan2(2.0 * zeta * ratio, 1.0 - ratio**2)
    return np.asarray(np.sqrt(power) * np.exp(1j * angle))


def variance(natural_hz: float, zeta: float) -> float:
    """Variance of the motion for one-sided spectral density 1 of the force: ``pi f / (4 zeta)``."""
    return np.pi * natural_hz / (4.0 * zeta)


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


def spectrum_of(data: FitData) -> Spectrum | Refusal:
    """Spectrum of the samples, or why there is none."""
    even = _on_grid(data)
    if isinstance(even, Refusal):
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


def _on_grid(data: FitData) -> tuple[FloatArray, BoolArray, float] | Refusal:
    """Values on an even grid, which of them are seen, and the step."""
    place = np.rint(data.time_s / data.step_s)
    # The median step of rounded times is off by their rounding: the grid is that of the whole record.
    for _ in range(2):
        step_s, start_s = np.polyfit(place, data.time_s, 1)
        place = np.rint((data.time_s - start_s) / step_s)
    off = np.abs(data.time_s - start_s - step_s * place) / step_s
    if float(np.max(off)) > TUNING.jitter or np.any(np.diff(place) < 1.0):
        return Reason.UNEVEN(off=float(np.max(off)), most=TUNING.jitter)
    rows = (place - place[0]).astype(np.intp)
    values = np.zeros((rows[-1] + 1, data.values.shape[1]))
    seen = np.zeros(values.shape, dtype=bool)
    values[rows], seen[rows] = data.values, data.weights > 0.0
    return values, seen, float(step_s)


def _too_much_missing(seen: BoolArray, step_s: float) -> Refusal | None:
    share = 1.0 - float(np.min(np.mean(seen, axis=0)))
    edges = np.diff(np.pad(~seen, ((1, 1), (0, 0))).astype(np.int8), axis=0)
    lengths = np.nonzero(edges.T == -1)[1] - np.nonzero(edges.T == 1)[1]
    longest = int(np.max(lengths, initial=0))
    if share <= MOST_MISSING and longest <= _LONGEST_GAP:
        return None
    most_percent, percent = 100.0 * MOST_MISSING, 100.0 * share
    longest_s, most = longest * step_s, _LONGEST_GAP
    return Reason.MISSING(
        most_percent=most_percent, most=most, percent=percent, longest=longest, longest_s=longest_s
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


def not_stationary(found: Spectrum, frequency_hz: float, damping_ratio: float) -> Refusal | None:
    """Why the record is not one of stationary motion; None where it may be.

    The power of a mode in a block of T seconds under a white force has the gamma distribution with about
    ``zeta w T`` independent values, relative to its mean. The mean is that of the record without the strongest blocks.
    """
    rate = 2.0 * np.pi * damping_ratio * frequency_hz
    blocks = int(min(TUNING.most_blocks, found.span_s * rate / TUNING.least_values))
    half = max(REACH * damping_ratio * frequency_hz, 4.0 / found.span_s)
    inside = np.abs(found.frequency_hz - frequency_hz) < half
    # Amplitude in the band, sampled evenly: the transform back of its frequencies alone.
    band = found.values[inside]
    length = max(band.shape[0], 4 * blocks)
    power = np.sum(np.abs(np.fft.ifft(band, length, axis=0)) ** 2, axis=1)
    if blocks < TUNING.least_blocks:
        return _decays(power, 0.5 * found.span_s * rate, frequency_hz)
    of_block = np.array([np.sum(one) for one in np.array_split(power, blocks)])
    values = found.span_s * rate / blocks
    usual = float(np.median(of_block))
    limit = float(gammainccinv(values, RARE / blocks)) / values * usual * (1.0 + 1.0 / (3.0 * values))
    loud = of_block > limit
    share = float(np.sum(of_block[loud]) / np.sum(of_block))
    if share < TUNING.share:
        return None
    where_s = found.span_s * float(np.argmax(of_block)) / blocks
    percent, loud_percent = 100.0 * share, 100.0 * float(np.mean(loud))
    return Reason.STROKE(hz=frequency_hz, percent=percent, loud_percent=loud_percent, from_s=where_s)


def _decays(power: FloatArray, values: float, frequency_hz: float) -> Refusal | None:
    """Why a record of few blocks is not stationary: the powers of its halves, of `values` independent ones, differ.

    Their ratio has the F distribution with twice as many degrees of freedom.
    """
    first, second = (float(np.sum(one)) for one in np.array_split(power, 2))
    if fdtrc(2.0 * values, 2.0 * values, first / second) > RARE:
        return None
    return Reason.DECAYS(hz=frequency_hz, ratio=first / second)
